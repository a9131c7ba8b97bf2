"""Amplitudes of identified modes corrected for the exposure time, where it is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from modal_id.results import Identification, IdentifiedMode
from tracker.geometry.shutter import LARGEST_PRODUCT, exposure_attenuation

# Below this share of the amplitude the correction is not worth a sentence, unless it exceeds the sd.
WORTH_A_NOTE = 1e-3


def correct_amplitudes(found: Identification, exposure_s: float | None) -> Identification:
    """Divide each mode's amplitude by what the exposure left of it.

    `IdentifiedMode.amplitude` is corrected and a note says by how much where that exceeds the amplitude's standard
    deviation or 0.1 %. The series, the fit and `IdentifiedMode.shape` stay as filmed, since they are compared with
    the footage; the factor is common to all channels, so that mode shapes do not change.
    """
    if exposure_s is None or exposure_s <= 0.0:
        return found
    return replace(found, modes=tuple(_corrected(mode, exposure_s) for mode in found.modes))


def _corrected(mode: IdentifiedMode, exposure_s: float) -> IdentifiedMode:
    product = mode.frequency_hz * exposure_s
    if product > LARGEST_PRODUCT:
        note = (
            f"The exposure of {1e3 * exposure_s:g} ms lasts {product:.2g} periods of this mode: most of its motion is "
            "averaged away, and its amplitude is not that of the beam. Film with a shorter exposure."
        )
        return replace(mode, notes=(*mode.notes, note))
    factor = 1.0 / exposure_attenuation(mode.frequency_hz, exposure_s)
    lost = factor - 1.0
    corrected = replace(mode, amplitude=factor * mode.amplitude)
    if lost < WORTH_A_NOTE and lost * mode.amplitude <= _amplitude_sd(mode):
        return corrected
    note = (
        f"Each frame averages {1e3 * exposure_s:g} ms of the motion: the amplitude is stated {100.0 * lost:.2g} % "
        f"larger than it is seen ({mode.amplitude:.5g} {mode.amplitude_unit}). Curves show it as seen."
    )
    return replace(corrected, notes=(*corrected.notes, note))


def _amplitude_sd(mode: IdentifiedMode) -> float:
    largest = int(np.argmax(np.abs(mode.shape)))
    return float(mode.shape_sd[largest])

"""Correction of the amplitudes of identified modes for a known exposure time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from modal_id.results import Identification, IdentifiedMode
from tracker.geometry.shutter import LARGEST_PRODUCT, exposure_attenuation

# A correction below this share of the amplitude gets no note, unless it exceeds the standard deviation.
WORTH_A_NOTE = 1e-3


def correct_amplitudes(found: Identification, exposure_s: float | None) -> Identification:
    """Divide each mode's amplitude by the attenuation due to the exposure time.

    `IdentifiedMode.amplitude` is corrected; a note states the correction if it exceeds the amplitude's standard
    deviation or 0.1 %. The series, the fit and `IdentifiedMode.shape` stay uncorrected, since they are compared with
    the footage; the factor is the same for all channels, so mode shapes do not change.
    """
    if exposure_s is None or exposure_s <= 0.0:
        return found
    return replace(found, modes=tuple(_corrected(mode, exposure_s) for mode in found.modes))


def _corrected(mode: IdentifiedMode, exposure_s: float) -> IdentifiedMode:
    product = mode.frequency_hz * exposure_s
    if product > LARGEST_PRODUCT:
        note = (
            f"The exposure of {1e3 * exposure_s:g} ms lasts {product:.2g} periods of this mode: most of its motion is "
            "averaged out, so its amplitude is not that of the beam. Use a shorter exposure."
        )
        return replace(mode, notes=(*mode.notes, note))
    factor = 1.0 / exposure_attenuation(mode.frequency_hz, exposure_s)
    lost = factor - 1.0
    corrected = replace(mode, amplitude=factor * mode.amplitude)
    if lost < WORTH_A_NOTE and lost * mode.amplitude <= _amplitude_sd(mode):
        return corrected
    note = (
        f"Each frame averages {1e3 * exposure_s:g} ms of the motion: the amplitude was corrected by "
        f"{100.0 * lost:.2g} % (uncorrected {mode.amplitude:.5g} {mode.amplitude_unit}). Curves are uncorrected."
    )
    return replace(corrected, notes=(*corrected.notes, note))


def _amplitude_sd(mode: IdentifiedMode) -> float:
    largest = int(np.argmax(np.abs(mode.shape)))
    return float(mode.shape_sd[largest])

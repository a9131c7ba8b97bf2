"""The beam's modes as measured over all recordings: one frequency and one damping ratio per mode number."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from modal_id.results import Identification, IdentifiedMode
from modalcam.run_result import RecordingResult

# A mode that merely rings along in a recording counts when its shape leaves no doubt about its number.
_MIN_MAC = 0.95


@dataclass(frozen=True)
class MeasuredMode:
    """One mode of the beam, combined over the recordings that show it.

    Attributes
    ----------
    number : int
    frequency_hz, frequency_sd_hz, damping_ratio, damping_ratio_sd : float
        Weighted by the inverse variance. Where recordings disagree by more than their standard deviations allow,
        the standard deviation is that of the disagreement.
    recordings : tuple of str
    """

    number: int
    frequency_hz: float
    frequency_sd_hz: float
    damping_ratio: float
    damping_ratio_sd: float
    recordings: tuple[str, ...]


def measured_modes(recordings: Iterable[RecordingResult]) -> tuple[MeasuredMode, ...]:
    """Measured modes in order of number.

    A mode is taken from the recordings made for it; only where there is none, from others that show it with a MAC
    of at least 0.95 against theory.
    """
    seen: dict[int, list[tuple[str, IdentifiedMode]]] = {}
    for recording in recordings:
        if isinstance(recording.identification, Identification):
            for mode in recording.identification.modes:
                if mode.number is not None:
                    seen.setdefault(mode.number, []).append((recording.name, mode))
    combined = []
    for number, found in sorted(seen.items()):
        targets = [item for item in found if item[1].target]
        usable = targets or [item for item in found if item[1].mac >= _MIN_MAC]
        if usable:
            combined.append(_combine(number, usable))
    return tuple(combined)


def _combine(number: int, found: list[tuple[str, IdentifiedMode]]) -> MeasuredMode:
    modes = [mode for _, mode in found]
    frequency, frequency_sd = _weighted(
        [mode.frequency_hz for mode in modes], [mode.frequency_sd_hz for mode in modes]
    )
    damping, damping_sd = _weighted(
        [mode.damping_ratio for mode in modes], [mode.damping_ratio_sd for mode in modes]
    )
    return MeasuredMode(number, frequency, frequency_sd, damping, damping_sd, tuple(n for n, _ in found))


def _weighted(values: list[float], sds: list[float]) -> tuple[float, float]:
    x, weight = np.array(values), 1.0 / np.square(sds)
    mean = float(np.sum(weight * x) / np.sum(weight))
    variance = 1.0 / float(np.sum(weight))
    if x.size > 1:
        # Birge's ratio: scatter beyond the stated deviations widens the result, never narrows it.
        variance *= max(1.0, float(np.sum(weight * (x - mean) ** 2)) / (x.size - 1))
    return mean, variance**0.5

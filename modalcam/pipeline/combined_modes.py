"""The beam's modes as measured over all recordings: one frequency and one damping ratio per mode number."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from modal_id import Identification, IdentifiedMode
from modal_id.modes import Combined, combine, mac
from modalcam.pipeline.results import RecordingResult
from sim.comparison import BAND_DRAWS, draw_indices
from sim.updating import MeasuredShape

# A mode that is only also excited in a recording counts if its shape determines its number beyond doubt.
_MIN_MAC = 0.95
# With fewer markers a shape holds no information beyond its scale.
_MIN_MARKERS = 3


@dataclass(frozen=True)
class MeasuredMode:
    """One mode of the beam, combined over the recordings in which it was identified.

    Frequency and damping ratio are means weighted by the inverse variance; the standard deviations include the scatter
    between recordings beyond their own. A frequency that depends on the amplitude is that at small amplitude.
    `frequency` and `damping` hold the values of the recordings and how they agree. Draws are of the posterior of the
    recording with the smallest standard deviation, spread evenly over its chains, shifted and scaled to the combined
    value and standard deviation.

    The error of the frame rate is common to recordings of one camera: `rate_sd` is its relative standard deviation, the
    largest of the recordings. `frequency` does not include it, `frequency_sd_hz` and the draws do.

    `shape` is that of the recording with the smallest relative standard deviation, among those with known marker
    positions; `least_mac` is the smallest modal assurance criterion between two recordings with the same marker
    positions, NaN if there are no two.
    """

    number: int
    frequency_hz: float
    frequency_sd_hz: float
    damping_ratio: float
    damping_ratio_sd: float
    shape: MeasuredShape | None
    recordings: tuple[str, ...]
    frequency: Combined
    damping: Combined
    frequency_draws_hz: tuple[float, ...]
    damping_draws: tuple[float, ...]
    least_mac: float = float("nan")
    rate_sd: float = 0.0


def measured_modes(recordings: Iterable[RecordingResult]) -> tuple[MeasuredMode, ...]:
    """Measured modes in order of number.

    A mode is taken from the recordings in which it was excited; only if there is none, from others in which it has a
    MAC of at least 0.95 with the theoretical shape.
    """
    by_number: dict[int, list[_Identified]] = {}
    for recording in recordings:
        if isinstance(recording.identification, Identification):
            for mode in recording.identification.modes:
                if mode.number is not None:
                    one = _Identified(recording.name, mode, _shape(recording.identification, mode))
                    by_number.setdefault(mode.number, []).append(one)
    combined = []
    for number, found in sorted(by_number.items()):
        targets = [one for one in found if one.mode.target]
        usable = targets or [one for one in found if one.mode.mac >= _MIN_MAC]
        if usable:
            combined.append(_combine(number, usable))
    return tuple(combined)


@dataclass(frozen=True)
class _Identified:
    recording: str
    mode: IdentifiedMode
    shape: MeasuredShape | None


def _combine(number: int, found: list[_Identified]) -> MeasuredMode:
    small_hz = [one.mode.small_amplitude_frequency[0] for one in found]
    frequency = combine(small_hz, [_own_sd_hz(one.mode) for one in found])
    rate_sd = 1e-6 * max(one.mode.posterior.rate_sd_ppm for one in found)
    frequency_sd_hz = float(np.hypot(frequency.sd, rate_sd * frequency.value))
    damping = combine([one.mode.damping_ratio for one in found], [one.mode.damping_ratio_sd for one in found])

    def relative_sd(shape: MeasuredShape) -> float:
        return float(np.linalg.norm(shape.sd) / np.linalg.norm(shape.amplitude))

    shapes = [one.shape for one in found if one.shape is not None]
    most_precise = min(found, key=lambda one: one.mode.damping_ratio_sd).mode.posterior
    return MeasuredMode(
        number=number,
        frequency_hz=frequency.value,
        frequency_sd_hz=frequency_sd_hz,
        damping_ratio=damping.value,
        damping_ratio_sd=damping.sd,
        shape=min(shapes, key=relative_sd, default=None),
        recordings=tuple(one.recording for one in found),
        frequency=frequency,
        damping=damping,
        frequency_draws_hz=_drawn(frequency.value, frequency_sd_hz, most_precise.frequency_hz),
        damping_draws=tuple(
            max(zeta, 0.0) for zeta in _drawn(damping.value, damping.sd, most_precise.damping_ratio)
        ),
        least_mac=_least_mac(shapes),
        rate_sd=rate_sd,
    )


def _own_sd_hz(mode: IdentifiedMode) -> float:
    """Standard deviation of the frequency at small amplitude without the error of the frame rate."""
    frequency_hz, sd_hz = mode.small_amplitude_frequency
    if frequency_hz == mode.frequency_hz:
        return float(np.std(mode.posterior.frequency_in_record_hz))
    rate_sd_hz = 1e-6 * mode.posterior.rate_sd_ppm * frequency_hz
    return float(np.sqrt(max(sd_hz**2 - rate_sd_hz**2, 0.0)))


def _drawn(value: float, sd: float, posterior: NDArray[np.float64]) -> tuple[float, ...]:
    draws = posterior.ravel()
    chosen = draws[draw_indices(draws.size, BAND_DRAWS)]
    spread = float(np.std(draws))
    scores = (chosen - np.median(draws)) / spread if spread > 0.0 else np.zeros(BAND_DRAWS)
    return tuple(float(value + sd * score) for score in scores)


def _least_mac(shapes: list[MeasuredShape]) -> float:
    same = [
        mac(a.amplitude, b.amplitude)
        for a, b in combinations(shapes, 2)
        if a.positions_m.shape == b.positions_m.shape and np.allclose(a.positions_m, b.positions_m, atol=5e-4)
    ]
    return min(same, default=float("nan"))


def _shape(found: Identification, mode: IdentifiedMode) -> MeasuredShape | None:
    """In-phase part of the complex shape at the markers with known positions."""
    positions = found.series.positions_mm
    known = found.channels_used & np.isfinite(positions) & np.isfinite(mode.shape)
    if mode.number is None or np.count_nonzero(known) < _MIN_MARKERS:
        return None
    shape = mode.shape[known]
    # The phase that minimises the out-of-phase part: half of that of the sum of squares.
    phase = 0.5 * np.angle(np.sum(shape**2))
    amplitude = np.asarray(np.real(shape * np.exp(-1j * phase)), dtype=np.float64)
    return MeasuredShape(mode.number, 1e-3 * positions[known], amplitude, mode.shape_sd[known])

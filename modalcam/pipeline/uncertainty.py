"""The standard deviation of each mode by its sources, as the GUM asks for."""

from __future__ import annotations

import math
from dataclasses import dataclass

from modal_id import IdentifiedMode
from modalcam.pipeline.results import RecordingResult


@dataclass(frozen=True)
class Budget:
    """Standard uncertainties of one mode, frequencies in Hz; their squares add up to that of the total.

    Attributes
    ----------
    recording : str
    mode : int or None
        Number of the mode.
    total_hz, total_damping : float
        Standard deviations of the posterior.
    noise_hz, noise_damping : float
        Noise of the samples at its level near the frequency of the mode, by Laplace's approximation. Errors of the
        template and of the light that vary from frame to frame are part of it.
    clock_hz : float
        Frame rate. A damping ratio does not depend on it.
    model_hz, model_damping : float
        Dependence on the amplitude, detected or beyond what the record can show.
    rest_hz, rest_damping : float
        What the draws contain beyond these: shape of the posterior and error of the sampler. 0 where the parts explain
        the total.
    """

    recording: str
    mode: int | None
    frequency_hz: float
    total_hz: float
    noise_hz: float
    clock_hz: float
    model_hz: float
    rest_hz: float
    damping_ratio: float
    total_damping: float
    noise_damping: float
    model_damping: float
    rest_damping: float


def budget(recording: str, mode: IdentifiedMode) -> Budget:
    """Sources of the standard deviations of one mode."""
    draws = mode.posterior
    noise_hz, noise_damping = (draws.noise_factor * sd for sd in draws.laplace_sd)
    clock_hz = 1e-6 * draws.rate_sd_ppm * mode.frequency_hz
    in_hz = (noise_hz, clock_hz, draws.systematic_frequency_hz)
    of_damping = (noise_damping, draws.systematic_damping_ratio)
    return Budget(
        recording,
        mode.number,
        mode.frequency_hz,
        mode.frequency_sd_hz,
        *in_hz,
        _rest(mode.frequency_sd_hz, in_hz),
        mode.damping_ratio,
        mode.damping_ratio_sd,
        *of_damping,
        _rest(mode.damping_ratio_sd, of_damping),
    )


def budgets(recordings: tuple[RecordingResult, ...]) -> list[Budget]:
    """Of every mode, in the order of the recordings."""
    return [
        budget(recording.name, mode)
        for recording in recordings
        if recording.identified is not None
        for mode in recording.identified.modes
    ]


def _rest(total: float, parts: tuple[float, ...]) -> float:
    return math.sqrt(max(total**2 - math.fsum(part**2 for part in parts), 0.0))

"""Simulated decays as the report needs them: one model, one channel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modalcam.report.style.palette import ALERT
from sim.comparison import DecayComparison
from sim.damping import DAMPING_MODELS
from tracker.arrays import FloatArray

# of the farthest marker's distance from the clamp
_LARGE_SWING = 0.01


def model_name(model: str) -> str:
    """Name of a damping model in the middle of a sentence."""
    entry = DAMPING_MODELS.get(model)
    return f"{model} damping" if entry is None else entry.name


def model_label(model: str) -> str:
    """Name of a damping model at the start of a line."""
    name = model_name(model)
    return name[0].upper() + name[1:]


def model_colour(model: str) -> str:
    """Colour of a damping model in every figure."""
    entry = DAMPING_MODELS.get(model)
    return ALERT if entry is None else entry.colour


def model_marker(model: str) -> str:
    """Marker of a damping model in every figure."""
    entry = DAMPING_MODELS.get(model)
    return "D" if entry is None else entry.marker


def model_line_style(model: str) -> str:
    """Line style of a damping model in a figure of several."""
    entry = DAMPING_MODELS.get(model)
    return ":" if entry is None else entry.line_style


def is_variant(model: str) -> bool:
    """Whether a damping model differs from another one at large amplitude only."""
    entry = DAMPING_MODELS.get(model)
    return entry is not None and entry.variant_of is not None


@dataclass(frozen=True)
class ModelDecay:
    """One model's decay in the channel shown.

    Attributes
    ----------
    model : str
        "generic", "rayleigh", ...
    time_s, measured, simulated : array, shape (n,)
    low, high : array or None, shape (n,)
        90 % band of the curve.
    sample_low, sample_high : array, shape (n,)
        90 % band of the samples.
    frequency_hz, damping_ratio : float
        Identified from the simulated decay.
    nrmse, envelope_error, phase_error_rad, coverage : float
        Over all channels.
    note : str
    """

    model: str
    time_s: FloatArray
    measured: FloatArray
    simulated: FloatArray
    low: FloatArray | None
    high: FloatArray | None
    sample_low: FloatArray
    sample_high: FloatArray
    frequency_hz: float
    damping_ratio: float
    nrmse: float
    envelope_error: float
    phase_error_rad: float
    coverage: float
    note: str


def model_decays(comparison: DecayComparison, channel: str) -> tuple[ModelDecay, ...]:
    """Every model's decay in one channel of the comparison, the one that moves most where it has no such channel."""
    if channel in comparison.channels:
        k = comparison.channels.index(channel)
    else:
        k = int(np.argmax(np.std(np.nan_to_num(comparison.measured), axis=0)))
    measured = np.where(comparison.used[:, k], comparison.measured[:, k], np.nan)
    return tuple(
        ModelDecay(
            model=decay.model,
            time_s=comparison.time_s,
            measured=measured,
            simulated=decay.simulated[:, k],
            low=None if decay.band_low is None else decay.band_low[:, k],
            high=None if decay.band_high is None else decay.band_high[:, k],
            frequency_hz=decay.frequency_hz,
            damping_ratio=decay.damping_ratio,
            sample_low=decay.predictive_band[0][:, k],
            sample_high=decay.predictive_band[1][:, k],
            nrmse=decay.nrmse,
            envelope_error=decay.envelope_error,
            phase_error_rad=decay.phase_error_rad,
            coverage=decay.coverage,
            note=decay.note,
        )
        for decay in comparison.models
    )


def drawn_decays(comparison: DecayComparison, channel: str) -> tuple[ModelDecay, ...]:
    """Decays for the figure: a variant only where the amplitude is large enough to show how it differs."""
    large = comparison.tip_amplitude_mm > _LARGE_SWING * float(np.max(comparison.positions_mm))
    return tuple(decay for decay in model_decays(comparison, channel) if large or not is_variant(decay.model))

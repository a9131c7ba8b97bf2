"""Simulated decays of a comparison: by damping model, and those that are drawn."""

from __future__ import annotations

import numpy as np

from modalcam.report.style.damping_models import is_variant
from sim.comparison import DecayComparison, ModelDecay

# Amplitude beyond which variants of a model differ visibly, relative to the last marker's distance from the clamp.
_LARGE_AMPLITUDE = 0.01


def decay_of(comparison: DecayComparison, model: str) -> ModelDecay | None:
    """The decay simulated with one model; None where there is none."""
    return next((decay for decay in comparison.models if decay.model == model), None)


def drawn_decays(comparison: DecayComparison) -> tuple[ModelDecay, ...]:
    """Decays for the figure: a variant only where the amplitude is large enough to show how it differs."""
    large = comparison.tip_amplitude_mm > _LARGE_AMPLITUDE * float(np.max(comparison.positions_mm))
    return tuple(decay for decay in comparison.models if large or not is_variant(decay.model))


def channel_index(comparison: DecayComparison, channel: str) -> int:
    """Index of the channel, or of the one that moves most where the comparison lacks it."""
    if channel in comparison.channels:
        return comparison.channels.index(channel)
    return int(np.argmax(np.std(np.nan_to_num(comparison.measured), axis=0)))

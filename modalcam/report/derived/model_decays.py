"""Damping models in the report: their names, colours and symbols, and which simulated decays are drawn."""

from __future__ import annotations

import numpy as np

from modalcam.report.style.palette import ALERT
from sim.comparison import DecayComparison, ModelDecay
from sim.damping import DAMPING_MODELS

# Amplitude beyond which variants of a model differ visibly, relative to the last marker's distance from the clamp.
_LARGE_AMPLITUDE = 0.01


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

"""Simulated decays against the measured ones: what they show of each damping model."""

from __future__ import annotations

from dataclasses import dataclass
from operator import attrgetter, itemgetter
from typing import Any, NamedTuple

import numpy as np

from modalcam.pipeline import ModelScore, RunResult, compared, model_scores
from modalcam.report.signals import decay_of, shown_mode
from sim.comparison import DecayComparison, DragFit, DragLimit, ModelDecay, ScoreSum
from sim.damping import DAMPING_MODELS


@dataclass(frozen=True)
class Tuning:
    """When a damping model fails."""

    #: [1] relative error of the damping ratio beyond which a model fails
    #: convention: The figure of the damping ratios writes the factor at the point from there on.
    fails: float = 0.05


TUNING = Tuning()


class Worst(NamedTuple):
    """A damping model and its simulated over measured damping ratio where it is farthest from 1."""

    model: str
    ratio: float
    number: int | None

    @property
    def accurate(self) -> bool:
        """Whether the model reproduces every measured damping ratio."""
        return abs(self.ratio - 1.0) < TUNING.fails


class ModelContrast(NamedTuple):
    """Two damping models by their scores; `failures` are the worse one's modes with its ratio of damping.

    `gain` is the difference of their log densities, summed over `recordings`.
    """

    good: ModelScore
    bad: ModelScore
    gain: ScoreSum
    recordings: tuple[str, ...]
    failures: list[tuple[int, float]]


class VariantContrast(NamedTuple):
    """A variant of a damping model in the recording where their damping ratios differ most."""

    comparison: DecayComparison
    variant: ModelDecay
    base: ModelDecay

    @property
    def difference(self) -> float:
        """Absolute relative difference of the damping ratios."""
        return abs(self.variant.damping_ratio / self.base.damping_ratio - 1.0)


def worst_ratios(result: RunResult) -> list[Worst]:
    """Largest deviation of each model's damping ratio from the measured one, over all modes; variants are left out."""
    ratios: dict[str, list[Worst]] = {}
    for recording in result.recordings:
        found, comparison = recording.identified, recording.comparison
        mode = None if found is None else shown_mode(found)
        if mode is None or mode.damping_ratio <= 0.0 or not isinstance(comparison, DecayComparison):
            continue
        for decay in comparison.models:
            if np.isfinite(decay.damping_ratio) and DAMPING_MODELS[decay.model].variant_of is None:
                worst = Worst(decay.model, decay.damping_ratio / mode.damping_ratio, mode.number)
                ratios.setdefault(decay.model, []).append(worst)
    return [max(found, key=lambda w: abs(np.log(max(w.ratio, 1e-12)))) for found in ratios.values()]


def findings(result: RunResult) -> dict[str, Any] | None:
    """Which model predicts, where the others fail, and aerodynamic drag; None without scores.

    ``drag_limit`` is the tightest upper limit, with its comparison, where no recording shows drag.
    """
    comparisons = [comparison for _, comparison in compared(result.recordings)]
    scores = model_scores(result.recordings)
    if not scores:
        return None
    others = [score for score in scores[1:] if DAMPING_MODELS[score.model].variant_of is None]
    fits = [(c, c.drag) for c in comparisons if isinstance(c.drag, DragFit)]
    limits = [(c, c.drag.drag_coefficient_q95) for c in comparisons if isinstance(c.drag, DragLimit)]
    limits = [] if fits else [limit for limit in limits if np.isfinite(limit[1])]
    return {
        "unit": comparisons[0].unit,
        "models": [_contrast(scores[0], other, comparisons) for other in others],
        "variants": _variants(comparisons),
        "drag": fits,
        "drag_limit": min(limits, key=itemgetter(1), default=None),
    }


def _contrast(first: ModelScore, other: ModelScore, comparisons: list[DecayComparison]) -> ModelContrast:
    good, bad = (first, other) if other.log_density_gain.total > 0.0 else (other, first)
    failures = []
    for comparison in comparisons:
        decay = decay_of(comparison, bad.model)
        ratio = np.nan if decay is None else decay.damping_ratio / comparison.damping_ratio
        if abs(ratio - 1.0) > TUNING.fails:
            failures.append((comparison.mode_number, ratio))
    return ModelContrast(good, bad, other.log_density_gain, other.recordings, failures)


def _variants(comparisons: list[DecayComparison]) -> list[VariantContrast]:
    """Each variant of a model where it differs most, if it differs at all."""
    out = []
    for entry in DAMPING_MODELS.values():
        pairs = [
            pair
            for c in comparisons
            if entry.variant_of is not None
            and (variant := decay_of(c, entry.key)) is not None
            and (base := decay_of(c, entry.variant_of)) is not None
            and (pair := VariantContrast(c, variant, base)).difference >= TUNING.fails
        ]
        if pairs:
            out.append(max(pairs, key=attrgetter("difference")))
    return out

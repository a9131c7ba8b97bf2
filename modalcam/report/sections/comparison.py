"""Simulated decays against the measured ones: the table, the scores, and what they show of each damping model."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from modal_id.results import Identification, IdentifiedMode
from modalcam.pipeline.results import RunResult
from modalcam.pipeline.scoreboard import ModelScore, compared, model_scores
from modalcam.report.derived.signals import decay_of, nrmse_of_fit, shown_mode
from modalcam.report.sections.alerts import anchor_of
from modalcam.report.style.damping_models import is_variant
from sim.comparison import DecayComparison, DragFit, DragLimit, ModelDecay
from sim.damping import DAMPING_MODELS

# Standard errors beyond which a difference of scores is significant.
_SIGNIFICANT = 3.0
# Relative error of the damping ratio beyond which a model fails.
_FAILS = 0.05


class ComparisonRow(NamedTuple):
    """One damping model in one recording; `floor` is the normalised rms error of the fit of Eq. 1 itself."""

    anchor: str
    recording: str
    mode: IdentifiedMode
    decay: ModelDecay
    floor: float

    @property
    def ratio(self) -> float:
        """Simulated over measured damping ratio."""
        return self.decay.damping_ratio / self.mode.damping_ratio if self.mode.damping_ratio > 0.0 else np.nan


class Worst(NamedTuple):
    """A damping model and its simulated over measured damping ratio where it is farthest from 1."""

    model: str
    ratio: float
    number: int | None

    @property
    def accurate(self) -> bool:
        """Whether the model reproduces every measured damping ratio."""
        return abs(self.ratio - 1.0) < _FAILS


class ModelContrast(NamedTuple):
    """Two damping models by their scores; `failures` are the worse one's modes with its ratio of damping."""

    good: ModelScore
    bad: ModelScore
    gain: float
    gain_se: float
    samples: int
    failures: tuple[tuple[int, float], ...]

    @property
    def significant(self) -> bool:
        """Whether the scores differ by more than chance."""
        return abs(self.gain) > _SIGNIFICANT * self.gain_se


class VariantContrast(NamedTuple):
    """A variant of a damping model in the recording where their damping ratios differ most."""

    comparison: DecayComparison
    variant: ModelDecay
    base: ModelDecay


class Findings(NamedTuple):
    """What the comparisons show; `drag_limit` is the tightest upper limit where no recording shows drag."""

    unit: str
    models: tuple[ModelContrast, ...]
    variants: tuple[VariantContrast, ...]
    drag: tuple[tuple[DecayComparison, DragFit], ...]
    drag_limit: tuple[DecayComparison, float] | None


class ShiftRow(NamedTuple):
    """Measured and simulated relative change of a frequency by the amplitude at the start of the decay."""

    recording: str
    comparison: DecayComparison
    simulated: float


def comparison_rows(result: RunResult) -> tuple[ComparisonRow, ...]:
    """A row for each recording and damping model."""
    rows = []
    for index, recording in enumerate(result.recordings):
        found, comparison = recording.identification, recording.comparison
        mode = shown_mode(found) if isinstance(found, Identification) else None
        if isinstance(found, Identification) and mode is not None and isinstance(comparison, DecayComparison):
            floor = nrmse_of_fit(found)
            rows += [
                ComparisonRow(anchor_of(index), recording.name, mode, decay, floor)
                for decay in comparison.models
            ]
    return tuple(rows)


def worst_ratios(rows: tuple[ComparisonRow, ...]) -> tuple[Worst, ...]:
    """How far each model's damping lies from the measured one, at its worst mode."""
    worst: dict[str, Worst] = {}
    for row in rows:
        if np.isfinite(row.ratio):
            new = Worst(row.decay.model, row.ratio, row.mode.number)
            worst[new.model] = max(
                worst.get(new.model, new), new, key=lambda w: abs(np.log(max(w.ratio, 1e-12)))
            )
    return tuple(worst.values())


def findings(result: RunResult) -> Findings | None:
    """Which model predicts, where the others fail, and aerodynamic drag; None without scores."""
    comparisons = [comparison for _, comparison in compared(result.recordings)]
    scores = model_scores(result.recordings)
    if not comparisons or not scores:
        return None
    others = [score for score in scores[1:] if not is_variant(score.model)]
    fits = tuple((c, c.drag) for c in comparisons if isinstance(c.drag, DragFit))
    limits = [(c, c.drag.drag_coefficient_q95) for c in comparisons if isinstance(c.drag, DragLimit)]
    limits = [] if fits else [limit for limit in limits if np.isfinite(limit[1])]
    return Findings(
        unit=comparisons[0].unit,
        models=tuple(_contrast(scores[0], other, comparisons) for other in others),
        variants=tuple(_variants(comparisons)),
        drag=fits,
        drag_limit=min(limits, key=lambda limit: limit[1], default=None),
    )


def shift_rows(result: RunResult) -> tuple[ShiftRow, ...]:
    """A row for each recording whose frequency shift was measured."""
    rows = []
    for name, comparison in compared(result.recordings):
        if np.isfinite(comparison.frequency_shift):
            # Of no other model: a stiffness matrix that damps large rotation lowers the frequency as well.
            generic = decay_of(comparison, "generic")
            rows.append(ShiftRow(name, comparison, np.nan if generic is None else generic.frequency_shift))
    return tuple(rows)


def _contrast(first: ModelScore, other: ModelScore, comparisons: list[DecayComparison]) -> ModelContrast:
    gain = other.log_density_gain
    good, bad = (first, other) if gain.total > 0.0 else (other, first)
    failures = []
    for comparison in comparisons:
        decay = decay_of(comparison, bad.model)
        ratio = np.nan if decay is None else decay.damping_ratio / comparison.damping_ratio
        if abs(ratio - 1.0) > _FAILS:
            failures.append((comparison.mode_number, ratio))
    return ModelContrast(good, bad, gain.total, gain.se, gain.samples, tuple(failures))


def _variants(comparisons: list[DecayComparison]) -> list[VariantContrast]:
    """Each variant of a model where it differs most, if it differs at all."""
    out = []
    for entry in DAMPING_MODELS.values():
        pairs = [
            VariantContrast(c, variant, base)
            for c in comparisons
            if entry.variant_of is not None
            and (variant := decay_of(c, entry.key)) is not None
            and (base := decay_of(c, entry.variant_of)) is not None
            and abs(variant.damping_ratio / base.damping_ratio - 1.0) >= _FAILS
        ]
        if pairs:
            out.append(max(pairs, key=lambda pair: pair.variant.damping_ratio / pair.base.damping_ratio))
    return out

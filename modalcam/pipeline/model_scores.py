"""Scores of each damping model summed over all recordings."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from modalcam.pipeline.results import RecordingResult
from sim.comparison import DecayComparison, ModelDecay, ScoreSum


@dataclass(frozen=True)
class ModelScore:
    """Scores of one damping model over the recordings with which it was compared.

    `log_density` and `crps` are sums over all samples, the CRPS in the unit of the comparisons; their gains say by how
    much the first model scores better on the same recordings. `coverage` is the share of the samples inside the 90 %
    predictive band.
    """

    model: str
    recordings: tuple[str, ...]
    log_density: ScoreSum
    crps: ScoreSum
    log_density_gain: ScoreSum
    crps_gain: ScoreSum
    coverage: float


def compared(recordings: Iterable[RecordingResult]) -> tuple[tuple[str, DecayComparison], ...]:
    """Comparisons with the names of their recordings."""
    return tuple((r.name, r.comparison) for r in recordings if isinstance(r.comparison, DecayComparison))


def model_scores(recordings: Iterable[RecordingResult]) -> tuple[ModelScore, ...]:
    """Scores of every model; the others are compared with the first."""
    decays: dict[str, list[tuple[str, ModelDecay]]] = {}
    for name, comparison in compared(recordings):
        for decay in comparison.models:
            decays.setdefault(decay.model, []).append((name, decay))
    return tuple(_score(model, found) for model, found in decays.items())


def _score(model: str, found: list[tuple[str, ModelDecay]]) -> ModelScore:
    only = [decay for _, decay in found]
    samples = np.array([decay.log_density.samples for decay in only], dtype=np.float64)
    inside = float(np.array([decay.coverage for decay in only]) @ samples)
    nothing = ScoreSum(0.0, 0.0, 0)
    return ModelScore(
        model=model,
        recordings=tuple(name for name, _ in found),
        log_density=sum((d.log_density for d in only), nothing),
        crps=sum((d.crps for d in only), nothing),
        log_density_gain=sum((d.log_density_gain for d in only), nothing),
        crps_gain=sum((d.crps_gain for d in only), nothing),
        coverage=inside / float(samples.sum()) if samples.sum() else float("nan"),
    )

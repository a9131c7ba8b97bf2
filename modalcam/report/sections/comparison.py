"""The beam as configured and updated (Table 3 of the paper), and what its simulated decays show of each model."""

from __future__ import annotations

from dataclasses import dataclass
from operator import attrgetter, itemgetter
from typing import Any, NamedTuple

import numpy as np

from modalcam.pipeline import BeamResult, ModelScore, RunResult, compared, model_scores
from modalcam.report.signals import best_modes, decay_of, shown_mode
from modalcam.report.style import significant, superscript
from sim.comparison import DecayComparison, DragFit, DragLimit, ModelDecay, ScoreSum
from sim.damping import DAMPING_MODELS
from sim.updating import Updating, variable_names
from tracker import INTERVAL_ENDS, FloatArray

_UNIFORM = ("width", "thickness", "density", "modulus")
# Exponents below this are zero.
_NO_EXPONENT = 0.05


def updating_rows(result: RunResult) -> list[dict[str, Any]]:
    """Frequencies of each mode in Hz: measured with sd, as configured, and where the beam was updated in three ways.

    Modes of the posterior, measured or not; the first five of the beam where nothing was updated.
    """
    if result.beam is None:
        return []
    standard, updated = result.beam.standard_modes.frequency_hz, result.beam.updated
    if updated is not None:
        last = min(updated.bayesian.predicted_hz.shape[1], standard.size)
        rows = [_updated_row(n, updated) for n in range(1, last + 1)]
    else:
        measured = {
            n: {"measured": mode.frequency_hz, "measured_sd": mode.frequency_sd_hz}
            for n, (_, mode) in best_modes(result).items()
        }
        nothing = {"measured": np.nan, "measured_sd": np.nan}
        rows = [measured.get(n, nothing) for n in range(1, min(max([*measured, 5]), standard.size) + 1)]
    return [{"number": n, "standard": float(standard[n - 1])} | row for n, row in enumerate(rows, 1)]


def _updated_row(number: int, updated: Updating) -> dict[str, Any]:
    draws = updated.predicted_hz[:, number - 1]
    at = updated.mode_numbers == number
    columns = {
        "measured": updated.measured_hz,
        "measured_sd": updated.measured_sd_hz,
        "paper": updated.paper.updated_hz,
        "uniform": updated.uniform.updated_hz,
    }
    low, median, high = np.quantile(draws, (INTERVAL_ENDS[0], 0.5, INTERVAL_ENDS[1]))
    values = {name: values[at][0] if at.any() else np.nan for name, values in columns.items()}
    return values | {"low": low, "posterior": median, "high": high, "posterior_sd": np.std(draws)}


def updating_numbers(beam: BeamResult) -> dict[str, Any]:
    """Numbers of the paragraphs on updating; empty where nothing was updated."""
    updated = beam.updated
    if updated is None:
        return {}
    paper, uniform, posterior = updated.paper, updated.uniform, updated.bayesian
    ratio, elements = posterior.variance_ratio, posterior.properties.elements
    density, modulus = posterior.properties.density_kg_m3, posterior.properties.elastic_modulus_pa
    centre = np.array([[density], [modulus]]) / np.exp(posterior.log_factor[-2:, np.newaxis])
    strain = np.abs(posterior.log_factor) / posterior.prior.sd
    strained = int(np.argmax(strain))
    median_hz = np.median(posterior.predicted_hz, axis=0)
    spreads = np.array(
        [np.std(posterior.predicted_hz, axis=0), np.std(updated.predicted_hz, axis=0), posterior.prior_sd_hz]
    )
    unmeasured = [n for n in range(1, median_hz.size + 1) if n not in updated.mode_numbers]
    return {
        "paper_error": np.max(np.abs(paper.updated_hz / updated.measured_hz - 1.0)),
        "start_spread": np.sqrt(np.mean(paper.start_spread**2)),
        "uniform_errors": 100.0 * (uniform.updated_hz / updated.measured_hz - 1.0),
        "combinations": [combination(row) for row in uniform.combinations[: uniform.known]],
        "width": ratio[:elements],
        "thickness": ratio[elements : 2 * elements],
        "material": posterior.factor_interval()[-2:] * centre,
        "strain": strain[strained],
        "strained": variable_names(elements)[strained],
        "strained_change": 100.0 * (np.exp(posterior.log_factor[strained]) - 1.0),
        "unmeasured": [(n, *(spreads / median_hz)[:, n - 1]) for n in unmeasured],
        "laplace_error": max(abs(model.laplace_error) for model in updated.evidence.models),
    }


def combination(exponents: FloatArray) -> str:
    """Product of powers of the uniform properties, scaled to a smallest exponent of 1."""
    scale = np.min(np.abs(exponents[np.abs(exponents) > _NO_EXPONENT]))
    above: list[str] = []
    below: list[str] = []
    for name, power in zip(_UNIFORM, exponents / scale, strict=True):
        if abs(power) > _NO_EXPONENT:
            text = significant(abs(float(power)), 2).removesuffix(".0")
            (above if power > 0.0 else below).append(name if text == "1" else name + superscript(text))
    return " · ".join(above or ["1"]) + "".join(f" / {name}" for name in below)


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

"""Which damping model predicts the recordings, where the others fail, and by how much."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from modalcam.pipeline.results import RunResult
from modalcam.pipeline.scoreboard import ModelScore, compared, model_scores
from modalcam.report.derived.model_decays import is_variant, model_label, model_name
from modalcam.report.style.format import MISSING, count, fixed, percent, significant, with_sd
from sim.comparison import DecayComparison, DragFit, DragLimit, ModelDecay

# key of the model whose failure at large amplitude the verdict explains
_CONSTANT_STIFFNESS = "rayleigh_constant_k"
# A difference of scores is one beyond so many of its standard errors ...
_SURE = 3.0
# ... and a failure where the damping is off by more than this, too.
_OFF = 0.05


@dataclass(frozen=True)
class ScoreRow:
    """One model over all recordings."""

    model: str
    name: str
    recordings: str
    log_density: str
    behind: str
    standard_errors: str
    crps: str
    coverage: str
    log_density_full: float
    behind_full: float
    crps_full: float
    coverage_full: float


@dataclass(frozen=True)
class ShiftRow:
    """How the frequency of one recording's mode changes with the amplitude."""

    recording: str
    mode: str
    tip: str
    measured: str
    simulated: str


def score_rows(result: RunResult) -> tuple[ScoreRow, ...]:
    """Scores of every model."""
    return tuple(_row(score) for score in model_scores(result.recordings))


def _row(score: ModelScore) -> ScoreRow:
    gain, n = score.log_density_gain, score.log_density.samples
    first = gain.total == 0.0 and gain.se == 0.0
    return ScoreRow(
        model=score.model,
        name=model_label(score.model),
        recordings=str(len(score.recordings)),
        log_density=significant(score.log_density.mean, 4),
        behind=MISSING if first else with_sd(gain.total, gain.se),
        standard_errors=MISSING if first else significant(gain.standard_errors, 2),
        crps=significant(score.crps.mean, 3),
        coverage=percent(score.coverage, 2),
        log_density_full=score.log_density.mean,
        behind_full=gain.total,
        crps_full=score.crps.mean,
        coverage_full=score.coverage if n else float("nan"),
    )


def verdict(result: RunResult) -> tuple[str, ...]:
    """Sentences: which model predicts, where each other one fails and by how much, and what the air does."""
    decays = [comparison for _, comparison in compared(result.recordings)]
    scores = model_scores(result.recordings)
    if not decays or not scores:
        return ()
    sentences = [_against(scores[0], score, decays) for score in scores[1:] if not is_variant(score.model)]
    return (*sentences, *_constant_stiffness(decays), *_air(decays))


def _against(first: ModelScore, other: ModelScore, decays: Sequence[DecayComparison]) -> str:
    gain = other.log_density_gain
    over = f"over {count(len(other.recordings), 'recording')} ({gain.samples} samples)"
    if abs(gain.total) <= _SURE * gain.se:
        return (
            f"{model_label(first.model)} and {model_name(other.model)} predict equally well {over}: their log "
            f"predictive densities differ by {with_sd(gain.total, gain.se)} nats."
        )
    good, bad = (first, other) if gain.total > 0.0 else (other, first)
    se = significant(abs(gain.standard_errors), 2)
    text = (
        f"{model_label(good.model)} predicts better than {model_name(bad.model)}: {over} its log predictive density "
        f"is higher by {with_sd(abs(gain.total), gain.se)} nats ({se} standard errors)"
    )
    if len(good.recordings) == len(bad.recordings):
        unit = decays[0].unit
        text += f", its CRPS {significant(good.crps.mean, 2)} {unit} against {significant(bad.crps.mean, 2)} {unit}"
    return f"{text}. {_failures(bad.model, decays)}".rstrip()


def _failures(model: str, decays: Sequence[DecayComparison]) -> str:
    """Where a model's damping is off, and by what factor."""
    off = []
    for comparison in decays:
        decay = _of(comparison, model)
        ratio = float("nan") if decay is None else decay.damping_ratio / comparison.damping_ratio
        if decay is not None and abs(ratio - 1.0) > _OFF:
            off.append((f"mode {comparison.mode_number}", fixed(ratio, 2)))
    if not off:
        return ""
    modes, ratios = _listed([mode for mode, _ in off]), _listed([ratio for _, ratio in off])
    return f"{model_label(model)} fails at {modes}: {ratios} times the measured damping."


def _constant_stiffness(decays: Sequence[DecayComparison]) -> tuple[str, ...]:
    found = [(c, d) for c in decays if (d := _of(c, _CONSTANT_STIFFNESS)) is not None]
    found = [(c, d) for c, d in found if np.isfinite(d.damping_ratio)]
    if not found:
        return ()
    c, d = max(found, key=lambda pair: _excess(*pair))
    beside = _of(c, "rayleigh")
    # From the amplitude at the start: at small amplitude the two are one.
    if beside is None or abs(d.damping_ratio / beside.damping_ratio - 1.0) < _OFF:
        return ()
    text = (
        "Rayleigh damping with a constant K, the stiffness matrix of the undeformed beam, is a trap: large rotation "
        "looks like axial stretch to that matrix, and βK damps it as if the beam were being pulled. With "
        f"{significant(c.tip_amplitude_mm, 2)} mm at the tip mode {c.mode_number} then decays at "
        f"{percent(d.damping_ratio, 3)} instead of {percent(beside.damping_ratio, 3)}, which the same α and β give "
        "with the current stiffness K(q)."
    )
    return (text,)


def _excess(comparison: DecayComparison, decay: ModelDecay) -> float:
    beside = _of(comparison, "rayleigh")
    return -1.0 if beside is None else decay.damping_ratio / beside.damping_ratio


def _air(decays: Sequence[DecayComparison]) -> tuple[str, ...]:
    fits = [(c, c.drag) for c in decays if isinstance(c.drag, DragFit)]
    limits = [(c, c.drag) for c in decays if isinstance(c.drag, DragLimit)]
    sentences = []
    for c, fit in fits:
        if fit.drag_coefficient_sd > 0.0:
            value = (
                f"its drag coefficient is {with_sd(fit.drag_coefficient, fit.drag_coefficient_sd)} (90 %: "
                f"{significant(fit.drag_coefficient_q05, 3)} to {significant(fit.drag_coefficient_q95, 3)})"
            )
        else:
            value = f"its drag coefficient was given as {significant(fit.drag_coefficient, 3)}"
        zeta = with_sd(100.0 * fit.damping_ratio, 100.0 * fit.damping_ratio_sd)
        sentences.append(
            f"The air brakes mode {c.mode_number} in {c.recording}: {value}, and the damping ratio at small amplitude "
            f"is {zeta} %; over the whole decay a constant ratio comes to {percent(c.damping_ratio, 3)}."
        )
    known = [
        (limit.drag_coefficient_q95, c) for c, limit in limits if np.isfinite(limit.drag_coefficient_q95)
    ]
    if known and not fits:
        least, c = min(known, key=lambda pair: pair[0])
        sentences.append(
            f"No recording shows quadratic drag of the air: its coefficient is below {significant(least, 2)} "
            f"(95 %, from {c.recording})."
        )
    return tuple(sentences)


def shift_rows(result: RunResult) -> tuple[ShiftRow, ...]:
    """Measured and simulated change of the frequency by the amplitude at the start of each decay."""
    rows = []
    for name, comparison in compared(result.recordings):
        if not np.isfinite(comparison.frequency_shift):
            continue
        # not that of any other model: a stiffness matrix that damps large rotation lowers the frequency as well
        generic = _of(comparison, "generic")
        simulated = float("nan") if generic is None else generic.frequency_shift
        rows.append(
            ShiftRow(
                recording=name,
                mode=str(comparison.mode_number),
                tip=significant(comparison.tip_amplitude_mm, 3),
                measured=with_sd(100.0 * comparison.frequency_shift, 100.0 * comparison.frequency_shift_sd),
                simulated=significant(100.0 * simulated, 2) if np.isfinite(simulated) else "–",
            )
        )
    return tuple(rows)


def _of(comparison: DecayComparison, model: str) -> ModelDecay | None:
    return next((decay for decay in comparison.models if decay.model == model), None)


def _listed(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"

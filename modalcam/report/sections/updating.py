"""The beam as configured and as updated in three ways, in words and as tables (Table 3 of the paper)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modal_id.results import Identification, IdentifiedMode
from modalcam.pipeline.results import BeamResult, RunResult
from modalcam.report.sections.updating_words import updating_words
from modalcam.report.style.format import MISSING, count, fixed, interval, percent, significant, with_sd
from modalcam.report.style.text import sentence
from sim.updating import ModelEvidence, Updating

_MODEL_WORDS = {
    "uniform": "uniform properties",
    "taper": "linear taper of width and thickness",
    "smooth": "smooth widths and thicknesses",
}


@dataclass(frozen=True)
class UpdatingRow:
    """One mode before and after updating; `full` are measured, standard, paper's, uniform and posterior Hz."""

    number: str
    measured: str
    standard: str
    standard_error: str
    paper: str
    paper_error: str
    uniform: str
    uniform_error: str
    updated: str
    updated_error: str
    full: tuple[float, float, float, float, float]


@dataclass(frozen=True)
class EvidenceRow:
    """One kind of beam and how much the measured modes speak for it; `full` is the logarithm of the odds."""

    model: str
    gravity: str
    parameters: str
    odds: str
    discrepancy: str
    error: str
    full: float


def measured_by_number(result: RunResult) -> dict[int, IdentifiedMode]:
    """The measured mode of each number: the target of its recording before one that rang along."""
    best: dict[int, IdentifiedMode] = {}
    for recording in result.recordings:
        if isinstance(recording.identification, Identification):
            for mode in recording.identification.modes:
                if mode.number is None:
                    continue
                held = best.get(mode.number)
                if held is None or (mode.target, -mode.frequency_sd_hz) > (
                    held.target,
                    -held.frequency_sd_hz,
                ):
                    best[mode.number] = mode
    return best


def updating_rows(beam: BeamResult, measured: dict[int, IdentifiedMode]) -> tuple[UpdatingRow, ...]:
    """Modes of the posterior, measured or not, or the first five of the beam where nothing was updated."""
    standard = beam.standard_modes.frequency_hz
    if beam.updated is None:
        last = min(max([*measured, 5]), standard.size)
        rows = []
        for n in range(1, last + 1):
            mode = measured.get(n)
            f, sd = (float("nan"),) * 2 if mode is None else (mode.frequency_hz, mode.frequency_sd_hz)
            rows.append(_updating_row(n, f, sd, float(standard[n - 1])))
        return tuple(rows)
    return tuple(
        _mode_row(n, beam.updated, float(standard[n - 1]))
        for n in range(1, min(beam.updated.bayesian.predicted_hz.shape[1], standard.size) + 1)
    )


def _mode_row(number: int, updated: Updating, standard: float) -> UpdatingRow:
    at = np.flatnonzero(updated.mode_numbers == number)
    one = int(at[0]) if at.size else None
    nan = float("nan")
    draws = updated.predicted_hz[:, number - 1]
    low, high = np.quantile(draws, [0.05, 0.95])
    return _updating_row(
        number,
        nan if one is None else float(updated.measured_hz[one]),
        nan if one is None else float(updated.measured_sd_hz[one]),
        standard,
        paper=nan if one is None else float(updated.paper.updated_hz[one]),
        uniform=nan if one is None else float(updated.uniform.updated_hz[one]),
        updated=float(np.median(draws)),
        updated_interval=(float(low), float(high), float(np.std(draws))),
    )


def _updating_row(
    number: int,
    measured: float,
    sd: float,
    standard: float,
    *,
    paper: float = float("nan"),
    uniform: float = float("nan"),
    updated: float = float("nan"),
    updated_interval: tuple[float, float, float] = (float("nan"),) * 3,
) -> UpdatingRow:
    return UpdatingRow(
        number=str(number),
        measured=with_sd(measured, sd),
        standard=significant(standard, 5),
        standard_error=_error(standard, measured),
        paper=significant(paper, 5),
        paper_error=_error(paper, measured),
        uniform=significant(uniform, 5),
        uniform_error=_error(uniform, measured),
        updated=interval(*updated_interval),
        updated_error=_error(updated, measured),
        full=(measured, standard, paper, uniform, updated),
    )


def _error(value: float, reference: float) -> str:
    relative = round(100.0 * (value / reference - 1.0), 2)
    return MISSING if np.isnan(relative) else f"{'+' if relative > 0.0 else ''}{fixed(relative, 2)} %"


def evidence_rows(beam: BeamResult) -> tuple[EvidenceRow, ...]:
    """Kinds of beam, the most probable first; empty where nothing was updated."""
    if beam.updated is None:
        return ()
    best = beam.updated.evidence.models[0].log_evidence
    return tuple(_evidence_row(model, best - model.log_evidence) for model in beam.updated.evidence.models)


def _evidence_row(model: ModelEvidence, behind: float) -> EvidenceRow:
    kind, _, gravity = model.name.partition("+")
    return EvidenceRow(
        model=_MODEL_WORDS[kind],
        gravity="yes" if gravity else "no",
        parameters=str(model.parameters),
        odds=MISSING if behind == 0.0 else _odds(behind),
        discrepancy=percent(model.likely_discrepancy, 1),
        error=percent(model.largest_error),
        full=behind,
    )


def _odds(behind: float) -> str:
    """Odds of the best model against another, from the difference of the logarithms of their evidence."""
    if behind < np.log(1e4):
        return f"{significant(float(np.exp(behind)), 2)} : 1"
    return f"10{str(round(behind / np.log(10.0))).translate(str.maketrans('0123456789', '⁰¹²³⁴⁵⁶⁷⁸⁹'))} : 1"


def beam_facts(beam: BeamResult) -> tuple[tuple[str, str], ...]:
    """The beam as configured and what updating made of it, as label and value."""
    p = beam.standard
    facts = [
        ("Length", f"{significant(1e3 * p.length_m, 5)} mm, {p.elements} elements, {p.orientation}"),
        ("Section", f"{_spread(1e3 * p.width_m)} × {_spread(1e3 * p.thickness_m)} mm"),
        (
            "Material",
            f"ρ = {significant(p.density_kg_m3, 5)} kg/m³, E = {significant(1e-9 * p.elastic_modulus_pa, 5)} GPa",
        ),
    ]
    if np.isfinite(beam.rayleigh_alpha_1_s) and np.isfinite(beam.rayleigh_beta_s):
        facts.append(
            (
                "Rayleigh",
                f"α = {significant(beam.rayleigh_alpha_1_s, 4)} 1/s, β = {significant(beam.rayleigh_beta_s, 4)} s",
            )
        )
    if beam.updated is not None:
        facts += _updated_facts(beam.updated)
    return tuple(facts)


def _updated_facts(updated: Updating) -> list[tuple[str, str]]:
    posterior, paper = updated.bayesian, updated.paper
    q = posterior.properties
    rho = q.density_kg_m3 / np.exp(posterior.log_factor[-2])
    modulus = 1e-9 * q.elastic_modulus_pa / np.exp(posterior.log_factor[-1])
    (rho_low, rho_high), (e_low, e_high) = posterior.factor_interval()[-2:] * np.array([[rho], [modulus]])
    density = f"ρ = {significant(rho_low, 3)} … {significant(rho_high, 3)} kg/m³"
    stiffness = f"E = {significant(e_low, 3)} … {significant(e_high, 3)} GPa"
    at_bound = count(len(paper.at_bound), "variable")
    return [
        ("Posterior of the material (90 %)", f"{density}, {stiffness}"),
        ("As the paper", f"within {percent(paper.bound)}, {at_bound} at the bound"),
    ]


def beam_notes(beam: BeamResult) -> tuple[str, ...]:
    """What to know about the beam, each a full sentence."""
    words = () if beam.updated is None else updating_words(beam.updated)
    return tuple(sentence(note) for note in (beam.note, *words) if note)


def _spread(values: NDArray[np.float64]) -> str:
    low, high = float(values.min()), float(values.max())
    return (
        significant(low, 4)
        if high - low < 1e-9 * high
        else f"{significant(low, 4)} to {significant(high, 4)}"
    )

"""The beam as configured and as updated, in words and as a table (Table 3 of the paper)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modal_id.results import Identification, IdentifiedMode
from modalcam.report.format import MISSING, count, fixed, percent, significant, with_sd
from modalcam.report.text import sentence
from modalcam.run_result import BeamResult, RunResult


@dataclass(frozen=True)
class UpdatingRow:
    """One mode before and after updating."""

    number: str
    measured: str
    standard: str
    standard_error: str
    uniform: str
    uniform_error: str
    updated: str
    updated_error: str
    full: tuple[float, float, float]


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
    """Modes that were measured, or the first five of the beam where nothing was updated."""
    updated = beam.updated
    if updated is None:
        standard = beam.standard_modes.frequency_hz
        last = min(max([*measured, 5]), standard.size)
        return tuple(_updating_row(n, measured.get(n), float(standard[n - 1])) for n in range(1, last + 1))
    return tuple(
        _updating_row(int(n), measured.get(int(n)), *(float(v) for v in values))
        for n, *values in zip(
            updated.mode_numbers,
            updated.standard_hz,
            updated.uniform_hz,
            updated.updated_hz,
            updated.measured_hz,
            updated.measured_sd_hz,
            strict=True,
        )
    )


def _updating_row(
    number: int,
    mode: IdentifiedMode | None,
    standard: float,
    uniform: float = float("nan"),
    updated: float = float("nan"),
    measured: float = float("nan"),
    sd: float = float("nan"),
) -> UpdatingRow:
    if np.isnan(measured) and mode is not None:
        measured, sd = mode.frequency_hz, mode.frequency_sd_hz
    return UpdatingRow(
        number=str(number),
        measured=with_sd(measured, sd),
        standard=significant(standard, 5),
        standard_error=_error(standard, measured),
        uniform=significant(uniform, 5),
        uniform_error=_error(uniform, measured),
        updated=significant(updated, 5),
        updated_error=_error(updated, measured),
        full=(measured, standard, updated),
    )


def _error(value: float, reference: float) -> str:
    relative = round(100.0 * (value / reference - 1.0), 2)
    return MISSING if np.isnan(relative) else f"{'+' if relative > 0.0 else ''}{fixed(relative, 2)} %"


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
        q = beam.updated
        facts.append(
            (
                "Updated material",
                (
                    f"ρ = {significant(p.density_kg_m3 * q.density_factor, 5)} kg/m³, "
                    f"E = {significant(1e-9 * p.elastic_modulus_pa * q.elastic_modulus_factor, 5)} GPa"
                ),
            )
        )
        facts.append(("Bound of each change", f"{percent(q.bound)}, {count(q.at_bound, 'variable')} at it"))
    return tuple(facts)


def beam_notes(beam: BeamResult) -> tuple[str, ...]:
    """What to know about the beam, each a full sentence."""
    updated = () if beam.updated is None else beam.updated.notes
    return tuple(sentence(note) for note in (beam.note, *updated) if note)


def _spread(values: NDArray[np.float64]) -> str:
    low, high = float(values.min()), float(values.max())
    return (
        significant(low, 4)
        if high - low < 1e-9 * high
        else f"{significant(low, 4)} to {significant(high, 4)}"
    )

"""Comparison over all modes, and the updating of the beam."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modal_id.results import Identification, IdentifiedMode
from modalcam.report.compared import ModelDecay, model_decays, model_label
from modalcam.report.figures.damping import DampingPoint, damping_figure
from modalcam.report.figures.updating import fields_figure
from modalcam.report.format import MISSING, count, fixed, interval, percent, significant, with_sd
from modalcam.report.modes_view import anchor_of
from modalcam.report.signals import nrmse_of_fit, shown_channel, shown_mode
from modalcam.report.svg import FigureView
from modalcam.report.text import sentence
from modalcam.run_result import BeamResult, RecordingResult, RunResult
from sim.comparison import DecayComparison


@dataclass(frozen=True)
class ComparisonRow:
    """One model in one recording."""

    anchor: str
    recording: str
    number: str
    model: str
    name: str
    damping_measured: str
    damping_interval: str
    damping_simulated: str
    ratio: str
    frequency_measured: str
    frequency_simulated: str
    nrmse: str
    nrmse_of_fit: str
    damping_ratio_measured: float
    damping_ratio_simulated: float
    frequency_simulated_hz: float
    nrmse_full: float


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


@dataclass(frozen=True)
class BeamView:
    """The part of the page on simulation; `notes` say what to know."""

    figure: FigureView | None
    comparison: tuple[ComparisonRow, ...]
    finding: str
    updating: tuple[UpdatingRow, ...]
    fields: FigureView | None
    facts: tuple[tuple[str, str], ...]
    notes: tuple[str, ...]


def beam_view(result: RunResult) -> BeamView:
    """Gather what was simulated over all recordings."""
    beam = result.beam
    rows: list[ComparisonRow] = []
    simulated: dict[str, list[DampingPoint]] = {}
    measured: list[DampingPoint] = []
    for index, recording in enumerate(result.recordings):
        found = recording.identification
        mode = shown_mode(found) if isinstance(found, Identification) else None
        if mode is None or not isinstance(found, Identification):
            continue
        measured.append(_measured_point(mode))
        if not isinstance(recording.comparison, DecayComparison):
            continue
        for model in model_decays(recording.comparison, found.series.channels[shown_channel(found)]):
            rows.append(_comparison_row(index, recording, mode, model, nrmse_of_fit(found)))
            if np.isfinite(model.damping_ratio) and np.isfinite(model.frequency_hz):
                simulated.setdefault(model.model, []).append(
                    DampingPoint(model.frequency_hz, model.damping_ratio)
                )
    nan = float("nan")
    figure = damping_figure(
        "all-damping",
        measured,
        simulated,
        alpha_1_s=nan if beam is None else beam.rayleigh_alpha_1_s,
        beta_s=nan if beam is None else beam.rayleigh_beta_s,
    )
    return BeamView(
        figure=figure,
        comparison=tuple(rows),
        finding=_finding(rows),
        updating=() if beam is None else _updating_rows(beam, _by_number(result)),
        facts=() if beam is None else _facts(beam),
        fields=None if beam is None or beam.updated is None else fields_figure("all-fields", beam.updated),
        notes=() if beam is None else _notes(beam),
    )


def _measured_point(mode: IdentifiedMode) -> DampingPoint:
    return DampingPoint(
        mode.frequency_hz,
        mode.damping_ratio,
        mode.damping_ratio_q05,
        mode.damping_ratio_q95,
        "" if mode.number is None else f"mode {mode.number}",
    )


def _comparison_row(
    index: int, recording: RecordingResult, mode: IdentifiedMode, model: ModelDecay, of_fit: float
) -> ComparisonRow:
    z, z_sd = 100.0 * mode.damping_ratio, 100.0 * mode.damping_ratio_sd
    return ComparisonRow(
        anchor=anchor_of(index),
        recording=recording.name,
        number="" if mode.number is None else str(mode.number),
        model=model.model,
        name=model_label(model.model),
        damping_measured=with_sd(z, z_sd),
        damping_interval=interval(100.0 * mode.damping_ratio_q05, 100.0 * mode.damping_ratio_q95, z_sd),
        damping_simulated=significant(100.0 * model.damping_ratio, 3),
        ratio=fixed(model.damping_ratio / mode.damping_ratio, 2) if mode.damping_ratio > 0.0 else MISSING,
        frequency_measured=with_sd(mode.frequency_hz, mode.frequency_sd_hz),
        frequency_simulated=significant(model.frequency_hz, 5),
        nrmse=percent(model.nrmse),
        damping_ratio_measured=mode.damping_ratio,
        damping_ratio_simulated=model.damping_ratio,
        frequency_simulated_hz=model.frequency_hz,
        nrmse_of_fit=percent(of_fit),
        nrmse_full=model.nrmse,
    )


def _finding(rows: list[ComparisonRow]) -> str:
    """How far each model's damping lies from the measured one at its worst mode."""
    parts = []
    for name in dict.fromkeys(row.model for row in rows):
        label = model_label(name)
        off = [
            (row.damping_ratio_simulated / row.damping_ratio_measured, row.number)
            for row in rows
            if row.model == name
            and row.damping_ratio_measured > 0.0
            and np.isfinite(row.damping_ratio_simulated)
        ]
        if not off:
            continue
        ratio, number = max(off, key=lambda pair: abs(np.log(max(pair[0], 1e-12))))
        where = f" of mode {number}" if number else ""
        if abs(ratio - 1.0) < 0.05:
            within = percent(max(abs(ratio - 1.0), 0.001), 1)
            parts.append(f"{label} gives back the measured damping of every mode within {within}")
        else:
            parts.append(f"{label} gives {significant(ratio, 2)} times the measured damping{where}")
    return "; ".join(parts) + "." if parts else ""


def _by_number(result: RunResult) -> dict[int, IdentifiedMode]:
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


def _updating_rows(beam: BeamResult, measured: dict[int, IdentifiedMode]) -> tuple[UpdatingRow, ...]:
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


def _facts(beam: BeamResult) -> tuple[tuple[str, str], ...]:
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


def _notes(beam: BeamResult) -> tuple[str, ...]:
    updated = () if beam.updated is None else beam.updated.notes
    return tuple(sentence(note) for note in (beam.note, *updated) if note)


def _spread(values: NDArray[np.float64]) -> str:
    low, high = float(values.min()), float(values.max())
    return (
        significant(low, 4)
        if high - low < 1e-9 * high
        else f"{significant(low, 4)} to {significant(high, 4)}"
    )

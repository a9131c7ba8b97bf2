"""Comparison over all modes, and the updating of the beam."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modal_id.results import Identification, IdentifiedMode
from modalcam.pipeline.results import RecordingResult, RunResult
from modalcam.pipeline.scoreboard import compared
from modalcam.report.derived.model_decays import model_label
from modalcam.report.derived.signals import nrmse_of_fit, shown_mode
from modalcam.report.figures.registry import figures_of
from modalcam.report.sections.modes import anchor_of
from modalcam.report.sections.scores import ScoreRow, ShiftRow, score_rows, shift_rows, verdict
from modalcam.report.sections.updating import (
    EvidenceRow,
    UpdatingRow,
    beam_facts,
    beam_notes,
    evidence_rows,
    measured_by_number,
    updating_rows,
)
from modalcam.report.style.format import MISSING, fixed, interval, percent, significant, with_sd
from modalcam.report.style.svg import FigureView
from modalcam.storage.cache import Cache
from sim.comparison import DecayComparison, ModelDecay


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
    envelope: str
    phase: str
    coverage: str
    damping_ratio_measured: float
    damping_ratio_simulated: float
    frequency_simulated_hz: float
    nrmse_full: float


@dataclass(frozen=True)
class BeamView:
    """The part of the page on simulation; `notes` say what to know."""

    figures: tuple[FigureView, ...]
    comparison: tuple[ComparisonRow, ...]
    finding: str
    verdict: tuple[str, ...]
    scores: tuple[ScoreRow, ...]
    shifts: tuple[ShiftRow, ...]
    unit: str
    updating: tuple[UpdatingRow, ...]
    evidence: tuple[EvidenceRow, ...]
    updating_figures: tuple[FigureView, ...]
    facts: tuple[tuple[str, str], ...]
    notes: tuple[str, ...]


def beam_view(result: RunResult, cache: Cache | None = None) -> BeamView:
    """Gather what was simulated over all recordings."""
    beam = result.beam
    rows: list[ComparisonRow] = []
    for index, recording in enumerate(result.recordings):
        found = recording.identification
        mode = shown_mode(found) if isinstance(found, Identification) else None
        if mode is None or not isinstance(found, Identification):
            continue
        if not isinstance(recording.comparison, DecayComparison):
            continue
        floor = nrmse_of_fit(found)
        rows += [
            _comparison_row(index, recording, mode, decay, floor) for decay in recording.comparison.models
        ]
    return BeamView(
        figures=tuple(figures_of("damping", result, "all", cache=cache)),
        comparison=tuple(rows),
        finding=_finding(rows),
        verdict=verdict(result),
        scores=score_rows(result),
        shifts=shift_rows(result),
        unit=next((c.unit for _, c in compared(result.recordings)), "mm"),
        updating=() if beam is None else updating_rows(beam, measured_by_number(result)),
        evidence=() if beam is None else evidence_rows(beam),
        facts=() if beam is None else beam_facts(beam),
        updating_figures=tuple(figures_of("updating", result, "all", cache=cache)),
        notes=() if beam is None else beam_notes(beam),
    )


def _comparison_row(
    index: int, recording: RecordingResult, mode: IdentifiedMode, model: ModelDecay, of_fit: float
) -> ComparisonRow:
    z, z_sd = 100.0 * mode.damping_ratio, 100.0 * mode.damping_ratio_sd
    low, high = mode.damping_interval()
    return ComparisonRow(
        anchor=anchor_of(index),
        recording=recording.name,
        number="" if mode.number is None else str(mode.number),
        model=model.model,
        name=model_label(model.model),
        damping_measured=with_sd(z, z_sd),
        damping_interval=interval(100.0 * low, 100.0 * high, z_sd),
        damping_simulated=significant(100.0 * model.damping_ratio, 3),
        ratio=fixed(model.damping_ratio / mode.damping_ratio, 2) if mode.damping_ratio > 0.0 else MISSING,
        frequency_measured=with_sd(mode.frequency_hz, mode.frequency_sd_hz),
        frequency_simulated=significant(model.frequency_hz, 5),
        nrmse=percent(model.nrmse),
        envelope=percent(model.envelope_error),
        phase=significant(1e3 * model.phase_error_rad, 2),
        coverage=percent(model.coverage, 2),
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

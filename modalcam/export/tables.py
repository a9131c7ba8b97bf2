"""CSV files of OUT, and the tracks file read back."""

from __future__ import annotations

import io
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from modal_id.results import Identification
from modalcam.names import csv_safe
from modalcam.pipeline.results import BeamResult, RecordingResult
from modalcam.storage.atomic import write_text
from sim.comparison import DecayComparison
from tracker.results import MarkerTracks

MODE_COLUMNS = (
    "recording",
    "mode",
    "target",
    "frequency_hz",
    "frequency_sd_hz",
    "frequency_q05_hz",
    "frequency_q95_hz",
    "damping_ratio",
    "damping_ratio_sd",
    "damping_ratio_q05",
    "damping_ratio_q95",
    "amplitude",
    "amplitude_unit",
    "onset_s",
    "n_samples",
    "n_markers",
    "flags",
)
COMPARISON_COLUMNS = (
    "recording",
    "mode",
    "model",
    "damping_ratio_measured",
    "damping_ratio_simulated",
    "frequency_measured_hz",
    "frequency_simulated_hz",
    "nrmse",
    "envelope_error",
    "phase_error_rad",
    "samples",
    "log_density",
    "log_density_gain",
    "log_density_gain_se",
    "crps",
    "coverage_90",
)
DRAG_COLUMNS = (
    "recording",
    "mode",
    "drag_coefficient",
    "drag_coefficient_sd",
    "drag_coefficient_q05",
    "drag_coefficient_q95",
    "damping_ratio",
    "damping_ratio_sd",
    "note",
)
UPDATING_COLUMNS = (
    "mode",
    "measured_hz",
    "standard_hz",
    "updated_hz",
    "updated_q05_hz",
    "updated_q95_hz",
    "paper_hz",
    "uniform_hz",
)


def write_tracks(path: Path, tracks: MarkerTracks) -> None:
    """One row per frame and marker; NaN where missing, flags by name joined by ``|``."""
    table = tracks.to_dataframe()
    table["marker"] = np.tile(
        np.array([csv_safe(name) for name in tracks.markers], dtype=object), tracks.frame.size
    )
    _write(path, table)


def write_modes(path: Path, recordings: Iterable[RecordingResult]) -> None:
    """One row per recording and identified mode; `mode` is empty where unknown."""
    frames = [pd.DataFrame(columns=pd.Index(MODE_COLUMNS))]
    for recording in recordings:
        if isinstance(recording.identification, Identification) and recording.identification.modes:
            frame = recording.identification.to_dataframe()
            frame.insert(0, "recording", csv_safe(recording.name))
            frames.append(frame.astype({"mode": object}).fillna({"mode": ""}))
    _write(path, pd.concat(frames[1:] or frames)[list(MODE_COLUMNS)])


def _write(path: Path, frame: pd.DataFrame) -> None:
    buffer = io.StringIO()
    frame.to_csv(buffer, index=False, na_rep="NaN", lineterminator="\n")
    write_text(path, buffer.getvalue())


def write_updating(path: Path, beam: BeamResult | None) -> None:
    """Measured, standard and updated natural frequencies; no row where nothing was updated."""
    rows = [] if beam is None or beam.updated is None else updating_rows(beam)
    _write(path, pd.DataFrame(rows, columns=pd.Index(UPDATING_COLUMNS)))


def updating_rows(beam: BeamResult) -> list[dict[str, Any]]:
    """Rows of `updating.csv`; empty where nothing was updated."""
    return [] if beam.updated is None else beam.updated.rows()


def write_comparison(path: Path, recordings: Iterable[RecordingResult]) -> None:
    """Measured against simulated, one row per recording and damping model."""
    rows = [row for recording in recordings for row in comparison_rows(recording)]
    _write(path, pd.DataFrame(rows, columns=pd.Index(COMPARISON_COLUMNS)))


def comparison_rows(recording: RecordingResult) -> list[dict[str, Any]]:
    """Rows of `comparison.csv` for one recording; empty where nothing was simulated."""
    comparison = recording.comparison
    if not isinstance(comparison, DecayComparison):
        return []
    return [{**row, "recording": csv_safe(recording.name)} for row in comparison.rows()]


def drag_rows(recordings: Iterable[RecordingResult]) -> list[dict[str, Any]]:
    """Drag of the air in each recording that was asked about it; NaN where it does not show."""
    rows = []
    for recording in recordings:
        comparison = recording.comparison
        if not isinstance(comparison, DecayComparison) or comparison.drag is None:
            continue
        drag = comparison.drag
        rows.append(
            {
                "recording": csv_safe(recording.name),
                "mode": comparison.mode_number,
                **{column: getattr(drag, column, float("nan")) for column in DRAG_COLUMNS[2:-1]},
                "note": getattr(drag, "reason", ""),
            }
        )
    return rows

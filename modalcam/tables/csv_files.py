"""CSV files of OUT: tracks, modes and their shapes, response to an input, comparison and updating."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from modal_id import FrequencyResponse, IdentifiedMode
from modal_id.modes import Aliases, Curvature, beam_curvature, in_phase
from modalcam.common import csv_safe
from modalcam.config import ExperimentConfig
from modalcam.pipeline import (
    BeamResult,
    RecordingResult,
    RunResult,
    Workspace,
    aliases,
    mode_table,
    replacing,
)
from modalcam.tables.base import Output, Writer
from modalcam.tables.columns import DRAG_COLUMNS, PARTICIPATION_COLUMNS, SHAPE_COLUMNS
from sim.comparison import COMPARISON_COLUMNS, DecayComparison
from sim.damping import LAW_COLUMNS, LEFT_OUT_COLUMNS, PART_COLUMNS, LawComparison
from sim.updating import UPDATING_COLUMNS
from tracker import Column, ComplexArray, Failure, FloatArray, MarkerTracks, table_row

if TYPE_CHECKING:
    import pandas as pd

# Of the tracks, which may have a million.
_FRAMES_AT_ONCE = 20_000
LAW_TABLES: dict[str, Callable[[LawComparison], list[dict[str, Any]]]] = {
    "damping_laws": lambda laws: laws.rows(),
    "damping_left_out": lambda laws: laws.left_out_rows(),
    "damping_parts": lambda laws: laws.parts.rows(),
}


def write_tracks(path: Path, tracks: MarkerTracks) -> None:
    """One row per frame and marker; NaN where missing, names of flags joined by ``|``."""
    write_table(path, tracks.tables(_FRAMES_AT_ONCE))


def comparison_rows(recording: RecordingResult) -> list[dict[str, Any]]:
    """Rows of `comparison.csv` for one recording; empty if nothing was simulated."""
    comparison = recording.comparison
    if not isinstance(comparison, DecayComparison):
        return []
    return [{**row, "recording": recording.name} for row in comparison.rows()]


def updating_rows(result: RunResult) -> list[dict[str, Any]]:
    """Rows of `updating.csv`; empty if nothing was updated."""
    updated = None if result.beam is None else result.beam.updated
    return [] if updated is None else updated.rows()


def law_rows(table: str, result: RunResult) -> list[dict[str, Any]]:
    """Rows of one of the `LAW_TABLES`; empty if no damping laws were compared."""
    laws = None if result.beam is None else result.beam.laws
    return LAW_TABLES[table](laws) if isinstance(laws, LawComparison) else []


def drag_rows(recordings: Iterable[RecordingResult]) -> list[dict[str, Any]]:
    """Drag coefficient of each recording for which it was to be identified; NaN with a note where it was not."""
    rows = []
    for recording in recordings:
        comparison = recording.comparison
        if not isinstance(comparison, DecayComparison) or comparison.drag is None:
            continue
        drag = comparison.drag
        numbers = {column.name: getattr(drag, column.name, float("nan")) for column in DRAG_COLUMNS}
        recorded = {"recording": recording.name, "mode": comparison.mode_number}
        rows.append({**recorded, **numbers, "note": getattr(drag, "reason", "")})
    return rows


def _track_outputs(workspace: Workspace, result: RunResult, _: ExperimentConfig) -> Iterator[Output]:
    for recording in result.recordings:
        if isinstance(recording.tracks, MarkerTracks):
            write = partial(write_tracks, tracks=recording.tracks)
            yield Output(workspace.tracks(recording.name), recording.tracks, write)


def _alias_outputs(workspace: Workspace, result: RunResult, _: ExperimentConfig) -> Iterator[Output]:
    if lines := aliases(result.recordings):
        write = partial(write_table, parts=(Aliases(lines).to_dataframe(),))
        yield Output(workspace.out / "aliases.csv", result, write)


def table_writer(
    name: str,
    description: str,
    rows: Callable[[RunResult], Iterable[dict[str, Any]]],
    columns: tuple[Column, ...],
) -> Writer:
    """Writer of one table of the whole run, `NAME.csv`, from its rows."""
    return _table(name, description, lambda result: frame(rows(result), columns))


def _table(name: str, description: str, table: Callable[[RunResult], pd.DataFrame]) -> Writer:
    """Writer of one table of the whole run."""

    def outputs(workspace: Workspace, result: RunResult, _: ExperimentConfig) -> Iterator[Output]:
        yield Output(workspace.out / f"{name}.csv", result, lambda path: write_table(path, [table(result)]))

    return Writer(name, f"{name}.csv", description, outputs)


def frame(rows: Iterable[dict[str, Any]], columns: tuple[Column, ...]) -> pd.DataFrame:
    """A table with these columns."""
    import pandas as pd  # noqa: PLC0415 - slow to import, and only a table that is written needs it

    return pd.DataFrame(list(rows), columns=pd.Index([column.name for column in columns]))


def write_table(path: Path, parts: Iterable[pd.DataFrame]) -> None:
    """Write a table, in parts, in which no text, wherever it comes from, is a formula of a spreadsheet."""
    with replacing(path) as temporary, temporary.open("wb") as file:
        for index, part in enumerate(parts):
            text = _safe(part).to_csv(index=False, header=index == 0, na_rep="NaN", lineterminator="\n")
            file.write(text.encode("utf-8", "backslashreplace"))


def _safe(table: pd.DataFrame) -> pd.DataFrame:
    """The table without a text that is a formula."""
    for name in table.select_dtypes(exclude="number").columns:
        texts = {value: csv_safe(value) for value in table[name].unique() if isinstance(value, str)}
        if any(safe != value for value, safe in texts.items()):
            table = table.assign(**{name: [texts.get(value, value) for value in table[name]]})
    return table


TRACKS = Writer("tracks", "tracks/<recording>.csv", "one row per frame and marker", _track_outputs)
MODES = _table(
    "modes", "one row per recording and identified mode", lambda result: mode_table(result.recordings)
)
ALIASES = Writer(
    "aliases",
    "aliases.csv",
    "only where a frequency may lie above half the sampling rate: the frequencies that it may be, with their "
    "probabilities, one row per recording, mode and frequency",
    _alias_outputs,
)
COMPARISON = table_writer(
    "comparison",
    "measurement against simulation, one row per recording, mode and damping model",
    lambda result: (row for recording in result.recordings for row in comparison_rows(recording)),
    COMPARISON_COLUMNS,
)
UPDATING = table_writer(
    "updating",
    "measured frequencies against those of the beam as configured and as updated",
    updating_rows,
    UPDATING_COLUMNS,
)
LAWS = (
    table_writer(
        "damping_laws",
        "damping laws over the measured modes, one row per law",
        partial(law_rows, "damping_laws"),
        LAW_COLUMNS,
    ),
    table_writer(
        "damping_left_out",
        "each mode as each damping law predicts it from the others",
        partial(law_rows, "damping_left_out"),
        LEFT_OUT_COLUMNS,
    ),
    table_writer(
        "damping_parts",
        "damping ratios divided into thermoelastic, viscous air and remainder",
        partial(law_rows, "damping_parts"),
        PART_COLUMNS,
    ),
)


class Participation(NamedTuple):
    """A mode at one channel of a recording with a measured input."""

    recording: str
    mode: IdentifiedMode
    channel: str
    participation: float
    participation_sd: float
    unit: str
    is_force: bool

    @property
    def modal_mass(self) -> float:
        """Inverse of the participation; NaN for a motion of the base."""
        return 1.0 / self.participation if self.is_force and self.participation else float("nan")

    @property
    def modal_mass_sd(self) -> float:
        """Its standard deviation, to first order."""
        return (
            abs(self.modal_mass / self.participation) * self.participation_sd
            if self.is_force
            else float("nan")
        )


def participations(recording: RecordingResult) -> Iterator[Participation]:
    """One for each mode and channel that was fitted; none without a measured input."""
    found = recording.identified
    if found is None or found.series.known_input is None:
        return
    known = found.series.known_input
    unit = f"{found.series.unit}/({known.unit} s^2)" if known.is_force else "1"
    for mode in found.modes:
        values, errors = mode.participation, mode.participation_sd
        if values is None or errors is None:
            continue
        for k in np.flatnonzero(np.isfinite(values)):
            name = found.series.channels[k]
            yield Participation(
                recording.name, mode, name, float(values[k]), float(errors[k]), unit, known.is_force
            )


def _responses(workspace: Workspace, result: RunResult, _: ExperimentConfig) -> Iterator[Output]:
    for recording in result.recordings:
        found = recording.identified
        response = None if found is None else found.response
        if isinstance(response, FrequencyResponse):
            write = partial(write_table, parts=(response.to_dataframe(),))
            yield Output(workspace.response(recording.name), response, write)


def _participations(workspace: Workspace, result: RunResult, _: ExperimentConfig) -> Iterator[Output]:
    rows = [table_row(PARTICIPATION_COLUMNS, one) for r in result.recordings for one in participations(r)]
    if rows:
        write = partial(write_table, parts=(frame(rows, PARTICIPATION_COLUMNS),))
        yield Output(workspace.out / "participation.csv", result, write)


RESPONSE = Writer(
    "response",
    "response/<recording>.csv",
    "only with a measured input: frequency response with its 90 % band, the local-polynomial estimate and the "
    "coherence, one row per channel and frequency",
    _responses,
)
PARTICIPATION = Writer(
    "participation",
    "participation.csv",
    "only with a measured input: participation factors, or modal constants and masses of a force, one row per "
    "recording, mode and channel",
    _participations,
)


@dataclass(frozen=True)
class ShapePoint:
    """A mode of a recording at one marker; curvature NaN where there is none."""

    recording: str
    mode: IdentifiedMode
    marker: str
    position_mm: float
    shape: complex
    shape_sd: float
    curvature_1_m2: float
    curvature_sd_1_m2: float


def unit_shape(mode: IdentifiedMode) -> ComplexArray:
    """Shape with a largest modulus of 1, rotated so that the sum of squares of its imaginary part is smallest."""
    return in_phase(mode.shape) / mode.amplitude


def curvature(
    recording: RecordingResult, mode: IdentifiedMode, beam: BeamResult | None, at_mm: FloatArray | None = None
) -> Curvature | Failure:
    """Curvature of `unit_shape` in 1/m^2, at the markers or at other distances from the clamp.

    Relative to an amplitude: times that of the mode in m, it is the curvature of the beam in 1/m.
    """
    identified, tracks = recording.identified, recording.tracks
    if identified is None or beam is None:
        return Failure("the free length of the beam is unknown: give it in [beam]")
    if not beam.standard.cantilever:
        return Failure(
            f"curvatures are known for a clamped and a free end only, not for {beam.standard.ends}"
        )
    return beam_curvature(
        identified.series.positions_mm,
        unit_shape(mode),
        mode.shape_sd / mode.amplitude,
        1e3 * beam.standard.length_m,
        at_mm,
        tracks.ends_sd_mm if isinstance(tracks, MarkerTracks) else None,
    )


def shape_rows(result: RunResult) -> Iterator[dict[str, Any]]:
    """One row for each mode and marker of known position; NaN where there is no curvature."""
    for recording in result.recordings:
        if recording.identified is None:
            continue
        series = recording.identified.series
        for mode in recording.identified.modes:
            shape, found = unit_shape(mode), curvature(recording, mode, result.beam)
            unknown = np.full(shape.size, np.nan)
            value, sd = (unknown, unknown) if isinstance(found, Failure) else (found.value, found.sd)
            for k in np.flatnonzero(np.isfinite(series.positions_mm) & np.isfinite(shape)):
                point = ShapePoint(
                    recording.name,
                    mode,
                    series.channels[k],
                    series.positions_mm[k],
                    shape[k],
                    mode.shape_sd[k] / mode.amplitude,
                    value[k],
                    sd[k],
                )
                yield table_row(SHAPE_COLUMNS, point)


SHAPES = table_writer(
    "shapes",
    "mode shapes and their curvature, one row per recording, mode and marker of known position",
    shape_rows,
    SHAPE_COLUMNS,
)

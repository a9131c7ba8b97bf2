"""CSV files of OUT: tracks, modes, comparison and updating."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from modal_id.modes import Aliases
from modalcam.common import csv_safe
from modalcam.config import ExperimentConfig
from modalcam.pipeline import RecordingResult, RunResult, Workspace, aliases, mode_table, replacing
from modalcam.tables.base import Output, Writer
from modalcam.tables.columns import DRAG_COLUMNS
from sim.comparison import COMPARISON_COLUMNS, DecayComparison
from sim.damping import LAW_COLUMNS, LEFT_OUT_COLUMNS, PART_COLUMNS, LawComparison
from sim.updating import UPDATING_COLUMNS
from tracker import Column, MarkerTracks

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

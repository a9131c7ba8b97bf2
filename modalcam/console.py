"""What people see in the terminal: progress while it works, one line per recording at the end. All on stderr."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path, PurePath

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

from modal_id.results import Identification, IdentifiedMode
from modalcam.export.summary import summary
from modalcam.names import shown
from modalcam.pipeline.results import RecordingResult, RunResult
from modalcam.report.style.format import interval, with_sd
from tracker.results import MarkerTracks


class ConsoleProgress:
    """Shows each stage as a bar; on a console that is no terminal as plain lines when asked to be verbose."""

    def __init__(self, bars: Progress, console: Console, verbose: int) -> None:
        self._bars = bars
        self._console = console
        self._verbose = verbose
        self._task: TaskID | None = None

    def begin(self, stage: str, total: int) -> None:
        """Add a bar for `stage`."""
        self._task = self._bars.add_task(stage, total=total)
        if self._verbose and not self._console.is_terminal:
            self._line(f"{stage}: {total}")

    def advance(self, name: str) -> None:
        """Move the stage's bar by one."""
        if self._task is not None:
            self._bars.advance(self._task)
        if self._verbose:
            self._line(f"  {name} done")

    def _line(self, text: str) -> None:
        self._console.print(Text(text))


@contextmanager
def listener(console: Console, verbose: int) -> Iterator[ConsoleProgress]:
    """Progress display for the time of the block."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, disable=not console.is_terminal) as bars:
        yield ConsoleProgress(bars, console, verbose)


def finish(console: Console, result: RunResult, out: Path, *, as_json: bool) -> None:
    """Print the outcome of a run: a table of modes, warnings, failures, where the report is."""
    console.print(_mode_table(result))
    problems(console, result)
    # Plain lines on standard output, so that scripts can take them.
    typer.echo(json.dumps(summary(result), indent=1) if as_json else shown(str(out / "report.html")))


def problems(console: Console, result: RunResult) -> None:
    """Print what went wrong in a run, and what it left out."""
    for recording in result.recordings:
        _warn(console, recording)
    for sentence in result.not_done:
        console.print(Text(f"note: {sentence}"))


def tracked(console: Console, recordings: Sequence[RecordingResult], out: Path) -> None:
    """Print the outcome of tracking."""
    for recording in recordings:
        if isinstance(recording.tracks, MarkerTracks):
            n, m = recording.tracks.x_px.shape
            console.print(Text(f"{recording.name}: {m} markers in {n} frames"))
        _warn(console, recording)
    typer.echo(shown(str(out / "tracks")))


def _mode_table(result: RunResult) -> Table:
    table = Table("recording", "mode", "frequency / Hz", "damping ratio / %", "90 % interval / %", "flags")
    for recording in result.recordings:
        found = recording.identification
        for mode in found.modes if isinstance(found, Identification) else ():
            if mode.target:
                table.add_row(*_mode_cells(recording, mode))
    return table


def _mode_cells(recording: RecordingResult, mode: IdentifiedMode) -> tuple[Text, ...]:
    low, high = mode.damping_interval()
    cells = (
        recording.name,
        "" if mode.number is None else str(mode.number),
        with_sd(mode.frequency_hz, mode.frequency_sd_hz),
        with_sd(100 * mode.damping_ratio, 100 * mode.damping_ratio_sd),
        interval(100 * low, 100 * high, 100 * mode.damping_ratio_sd),
        ", ".join(mode.flags),
    )
    return tuple(Text(cell) for cell in cells)


def _warn(console: Console, recording: RecordingResult) -> None:
    if recording.failure:
        # Readers name the file themselves.
        reason = recording.failure.removeprefix(f"{shown(PurePath(recording.file).name)}: ")
        console.print(Text(f"FAILED {shown(recording.file)}: {reason}", style="bold red"))
    if recording.target_failure:
        console.print(
            Text(f"NOT IDENTIFIED {shown(recording.file)}: {recording.target_failure}", style="red")
        )
    if isinstance(recording.tracks, MarkerTracks) and recording.tracks.time_axis.is_playback_guess:
        for sentence in recording.tracks.time_axis.notes:
            console.print(Text(f"WARNING {shown(recording.file)}: {sentence}", style="bold yellow"))

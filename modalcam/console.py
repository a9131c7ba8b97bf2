"""What is said on standard error: progress of the stages, and the outcome of each recording at the end.

The outcome is read from ``summary.json``, so that a run that is up to date shows it without loading any result.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path, PurePath
from time import monotonic
from typing import TYPE_CHECKING, Any, cast

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bars
from rich.segment import Segments
from rich.table import Column, Table
from rich.text import Text

from modal_id import DAMPING, FREQUENCY, QUOTED, SMALL_DAMPING, SMALL_FREQUENCY, FittingRate, quoted_note
from modalcam.common import ExitCode, ModalcamError, for_terminal, natural_key, shown
from modalcam.pace import Pace, duration, rest_of_run_s
from modalcam.pipeline import Progress, RecordingResult, Workspace, write_text
from modalcam.report.style import count, hertz, interval, with_sd
from tracker import Column as Value
from tracker import Severity

if TYPE_CHECKING:
    from tracker import MarkerTracks

# Flags of modes whose values at small amplitude differ from those of the table, or have a larger sd.
_OTHER_AMPLITUDE = {"AMPLITUDE_DEPENDENT", "FEW_CYCLES_LOST"}
# The numbers of a mode, and ten characters of the recording's name.
_TABLE_WIDTH = 80
# Columns of run.log.
_LOG_WIDTH = 160
# With more recordings than this a stage is summarised by numbers, unless more detailed output is wanted.
_MOST_NAMES = 6


class ConsoleProgress(Progress):
    """Shows each stage as a bar, or as a line when it has ended if the console is no terminal.

    Of a run as a whole (`whole_run`), with the time that the rest of it will take.
    """

    def __init__(self, bars: Bars, console: Console, verbose: int, *, whole_run: bool) -> None:
        self._bars = bars
        self._console = console
        self._verbose = verbose
        self._task: TaskID | None = None
        self._whole_run = whole_run
        self._stages: list[str] = [""]
        self._ended: dict[str, list[str]] = {}
        self._pace = Pace(monotonic(), 0)

    def begin(self, stage: str, total: int) -> None:
        """End the stage before and add a bar for this one."""
        self.end()
        self._stages.append(stage)
        self._pace = Pace(monotonic(), total)
        if self._verbose > 0 and not self._console.is_terminal:
            self.say(f"{stage} ({total})")
        if total:
            self._task = self._bars.add_task(stage, total=total, outcome="")

    def advance(self, name: str, *, reused: bool = False) -> None:
        """Move the bar by one and note whether the result was computed or reused."""
        outcome = "reused" if reused else "computed"
        self._ended.setdefault(outcome, []).append(shown(name))
        if self._task is not None:
            self._pace.end(name, reused=reused)
            self._bars.update(self._task, advance=1, outcome=self._with_pace())
        if self._verbose > 0 and name:
            self.say(f"  {name}: {outcome}")

    def within(self, name: str, frames: int, declared: int) -> None:
        """Show the frames of the recordings that are being worked on, their rate and the time that they will take."""
        self._pace.take(name, frames, declared)
        if self._task is not None:
            self._bars.update(self._task, outcome=self._with_pace())

    def say(self, text: str) -> None:
        """Print a line now."""
        self._console.print(_text(text))

    def note(self, text: str) -> None:
        """Print a line now, unless only failures and warnings are to be printed."""
        if self._verbose >= 0:
            self.say(text)

    def end(self) -> None:
        """Without a terminal, print which results of the current stage were computed and which reused."""
        if self._ended and not self._console.is_terminal and self._verbose >= 0:
            self.say(f"{self._stages[-1]}: {self._outcome(names=True)}")
        self._ended = {}
        self._task = None

    def _with_pace(self) -> str:
        """How many tasks have ended, frames of those that go on, and about how long the rest takes."""
        now_s = monotonic()
        left_s, said = self._pace.left_s(now_s), [self._outcome(names=False), self._pace.frames(now_s)]
        if left_s:
            after_s = (
                rest_of_run_s(self._stages, now_s - self._pace.since_s + left_s) if self._whole_run else None
            )
            said.append(f"about {duration(left_s + (after_s or 0.0))} left{' of the run' if after_s else ''}")
        return "; ".join(filter(None, said))

    def _outcome(self, *, names: bool) -> str:
        """Which results were computed and which reused: their names if they are few, else how many."""
        ended = [name for of_kind in self._ended.values() for name in of_kind]
        names = names and all(ended) and len(ended) <= _MOST_NAMES
        return "; ".join(
            f"{outcome} {', '.join(sorted(of_kind, key=natural_key)) if names else len(of_kind)}"
            for outcome, of_kind in self._ended.items()
        )


class JsonProgress(Progress):
    """Writes each step as one JSON object a line on standard error, for a program that starts this one.

    ``event`` is ``begin`` (``stage``, ``total``: its tasks), ``within`` (``name`` of a task that goes on, ``frames``
    done of ``declared``), ``advance`` (``name`` of a task that has ended, ``reused``: its saved result was valid),
    ``say`` (``text``: a message, a warning or a failure) or, at last, ``end`` (``exit_code``).
    """

    def __init__(self) -> None:
        # No line of a message is wrapped or coloured.
        self.console = Console(file=_Said(self), width=1_000_000, force_terminal=False, color_system=None)

    def begin(self, stage: str, total: int) -> None:
        """A stage begins."""
        _tell(event="begin", stage=stage, total=total)

    def advance(self, name: str, *, reused: bool = False) -> None:
        """One of its tasks has ended."""
        _tell(event="advance", name=name, reused=reused)

    def within(self, name: str, frames: int, declared: int) -> None:
        """One of its tasks goes on."""
        _tell(event="within", name=name, frames=frames, declared=declared)

    def say(self, text: str) -> None:
        """Show a message."""
        _tell(event="say", text=text)

    def ended(self, computed: Callable[[], ExitCode]) -> ExitCode:
        """Compute, and tell how it ended; a process that ends without telling has died."""
        try:
            code = computed()
        except ModalcamError as error:
            self.say(str(error))
            code = error.exit_code
        except KeyboardInterrupt:
            code = ExitCode.INTERRUPTED
        _tell(event="end", exit_code=int(code))
        return code


class _Said(io.StringIO):
    """Stream whose lines are messages."""

    def __init__(self, progress: JsonProgress) -> None:
        super().__init__()
        self._progress = progress

    def write(self, text: str) -> int:
        for line in text.splitlines():
            self._progress.say(line)
        return len(text)


def _tell(**values: Any) -> None:
    typer.echo(json.dumps(values), err=True)


@contextmanager
def listener(console: Console, verbose: int, *, whole_run: bool = False) -> Iterator[ConsoleProgress]:
    """Progress display while the block, perhaps a whole run, goes on; none where `verbose` is negative."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.fields[outcome]}"),
    )
    with Bars(*columns, console=console, disable=verbose < 0 or not console.is_terminal) as bars:
        progress = ConsoleProgress(bars, console, verbose, whole_run=whole_run)
        yield progress
        progress.end()


def finish(
    console: Console,
    out: Path,
    *,
    as_json: bool,
    quiet: bool = False,
    strict: bool = False,
    internal_errors: int = 0,
) -> ExitCode:
    """Print the outcome of the run in OUT: its modes, its problems, and on standard output the report's path.

    With `as_json` the summary is printed instead of the path, with `quiet` failures and warnings only. The modes and
    problems are kept in OUT as ``run.log``. Returns the exit code, which with `strict` counts values that may be wrong
    by more than their intervals as failures.
    """
    workspace = Workspace(out)
    text = workspace.summary.read_text("utf-8")
    summary = json.loads(text)
    log = io.StringIO()
    log.write(f"modalcam {summary['program']}: {summary['command_line']}\n")
    _outcome(Console(file=log, width=_LOG_WIDTH), summary, internal_errors, quiet=False)
    kept = log.getvalue().encode("utf-8", "backslashreplace")
    if not workspace.log.is_file() or workspace.log.read_bytes() != kept:
        write_text(workspace.log, log.getvalue())
    code = _outcome(console, summary, internal_errors, quiet=quiet)
    doubtful = [
        recording["file"] for recording in summary["recordings"] if strict and _is_doubtful(recording)
    ]
    if doubtful and code is ExitCode.OK:
        console.print(
            _text(f"--strict: values may be wrong by more than their intervals: {', '.join(doubtful)}")
        )
        code = ExitCode.PARTIAL
    typer.echo(text.rstrip("\n") if as_json else shown(str(workspace.report)))
    return code


def _outcome(console: Console, summary: dict[str, Any], internal_errors: int, *, quiet: bool) -> ExitCode:
    """Print the modes, unless `quiet`, and the problems; returns the exit code."""
    recordings = summary["recordings"]
    if not quiet:
        # A narrower terminal wraps the lines; no number is cut.
        room = console.options.update(width=max(console.width, _TABLE_WIDTH))
        console.print(Segments(console.render(_mode_table(recordings, summary["config"]), room)), crop=False)
        for sentence in (
            s for one in recordings for s in _beside_the_table(one, has_beam=summary["beam"] is not None)
        ):
            console.print(_text(sentence))
        for alias in summary["aliases"]:
            console.print(_text(f"{alias['recording']}: {alias['finding']}"))
    return problems(console, summary, internal_errors)


def problems(console: Console, summary: dict[str, Any], internal_errors: int = 0) -> ExitCode:
    """Print failures, warnings and skipped steps of a run; returns the exit code."""
    failures, missing, contradicted = [], [], False
    for recording in summary["recordings"]:
        failures.append(recording["failure"])
        missing.append(next((m["reason"] for m in recording["failed_modes"] if m["target"]), ""))
        words = _contradictions(recording)
        contradicted |= bool(words)
        _warn_of_cut(console, recording, failures[-1] or missing[-1])
        # A target that is missing because of the rate says so itself.
        for sentence in () if recording["fitting_rate"] and missing[-1] else words:
            console.print(_text(f"{recording['file']}: {sentence}", style="yellow"))
        axis = (recording["tracking"] or {}).get("time_axis")
        _warn(console, recording["file"], failures[-1], missing[-1], axis)
        if recording["proposed_px"] is not None:
            _how_to_set_markers(console, recording["proposed_px"])
    for sentence in summary["not_done"]:
        console.print(_text(f"note: {sentence}"))
    guessed = any(_rate_is_guessed(recording) for recording in summary["recordings"])
    return exit_code(failures, internal_errors, complete=not (any(missing) or guessed or contradicted))


def _warn_of_cut(console: Console, recording: dict[str, Any], reason: str) -> None:
    """Print how much of the declared recording is in its file, unless the `reason` of a failure does."""
    tracking = recording["tracking"]
    decode = {} if tracking is None else tracking["decode"]
    complete = not decode or decode["frames_declared"] <= decode["frames_decoded"]
    if complete or reason.startswith("the file is cut off"):
        return
    from tracker import DecodeReport  # noqa: PLC0415 - loads SciPy, which a run without changes does not

    fps = None if _rate_is_guessed(recording) else tracking["time_axis"]["fps_recorded"]
    if cut := DecodeReport(**decode).cut_off(fps):
        console.print(_text(f"WARNING {recording['file']}: {cut}", style="bold yellow"))


def _contradictions(recording: dict[str, Any]) -> list[str]:
    """What contradicts the recorded rate, or else what each mode's shape and the times of its frames contradict."""
    if recording["fitting_rate"]:
        return [str(FittingRate(**recording["fitting_rate"]))]
    named: dict[str, list[str]] = {}
    for mode in recording["modes"]:
        own = str(mode["mode"])
        if mode["mode"] is None:
            known = not _rate_is_guessed(recording)
            own = f"at {mode['frequency_hz']:.4g} Hz" if known else "of unknown frequency"
        for note in filter(None, (quoted_note(flag, mode["notes"]) for flag in QUOTED)):
            named.setdefault(note, []).append(f"mode {own}")
    return [f"{', '.join(modes)}: {note}" for note, modes in named.items()]


def exit_code(failures: Sequence[str], internal_errors: int, *, complete: bool = True) -> ExitCode:
    """Exit code of a run from the reason why each recording failed, empty if it did not."""
    if internal_errors:
        return ExitCode.INTERNAL
    if failures and all(failures):
        return ExitCode.NO_INPUT
    return ExitCode.OK if complete and not any(failures) else ExitCode.PARTIAL


def tracked(
    console: Console,
    recordings: Sequence[RecordingResult],
    out: Path,
    internal_errors: int,
    *,
    quiet: bool = False,
) -> ExitCode:
    """Print the outcome of tracking, with `quiet` failures and warnings only; returns the exit code."""
    from tracker.markers import noun_of  # noqa: PLC0415 - loads OpenCV, which a run without changes does not

    for recording in recordings:
        axis = None
        if recording.tracks:
            tracks = cast("MarkerTracks", recording.tracks)
            frames, markers = tracks.x_px.shape
            found = count(markers, noun_of(tracks.kind))
            axis = {"source": tracks.time_axis.source, "notes": tracks.time_axis.notes}
            guessed = tracks.time_axis.is_playback_guess
            notes = (*tracks.notes, *(() if guessed else tracks.time_axis.notes))
            lines = (
                f"{recording.name}: {found} in {frames} frames",
                *(f"note: {recording.name}: {s}" for s in notes),
            )
            for line in () if quiet else lines:
                console.print(_text(line))
        _warn(console, shown(recording.file), recording.failure, "", axis)
        proposed = getattr(recording.tracks, "proposed_px", None)
        if proposed is not None:
            _how_to_set_markers(console, proposed)
    typer.echo(shown(str(out / "tracks")))
    timed = all(
        not r.tracks or not cast("MarkerTracks", r.tracks).time_axis.is_playback_guess for r in recordings
    )
    return exit_code([recording.failure for recording in recordings], internal_errors, complete=timed)


def _how_to_set_markers(console: Console, proposed_px: Iterable[Sequence[float]]) -> None:
    points = ", ".join(f"[{x:.0f}, {y:.0f}]" for x, y in proposed_px)
    if points:
        console.print(_text(f'  points with texture that moves, for kind = "patch": points_px = [{points}]'))
    console.print(
        _text("  set points or a line by clicks: `modalcam studio FOLDER`, or `modalcam pick FILE`")
    )


def _text(text: str, style: str = "") -> Text:
    return Text(for_terminal(text), style)


def _mode_table(recordings: list[dict[str, Any]], config: str) -> Table:
    # Without frames the numbers fit into 80 columns; the names are folded, never cut.
    table = Table(Column("recording", overflow="fold"), box=SIMPLE_HEAD, pad_edge=False)
    for heading in ("mode", "frequency / Hz", "damping ratio / %", "90 % interval / %"):
        table.add_column(heading, no_wrap=True)
    for _, cells in (row for recording in recordings for row in mode_cells(recording, config)):
        table.add_row(*map(_text, cells))
    if any(str(cell).endswith("†") for cell in table.columns[2].cells):
        table.caption = _text("† below 50 ppm, the error of a clock: give camera.fps_tolerance_ppm")
    return table


def mode_cells(recording: dict[str, Any], config: str) -> Iterator[tuple[dict[str, Any], tuple[str, ...]]]:
    """Each target mode and driven motion of the summary of a recording, with its cells of the table of modes.

    A frequency has no mark for its clock where `config`, the text of the configuration, states a tolerance.
    """
    known = "fps_tolerance_ppm" in config
    for mode in (mode for mode in recording["modes"] if mode["target"]):
        sd = 100 * _number(mode[DAMPING[1].name])
        low, high = (100 * _number(value) for value in mode["damping_ratio_interval_90"])
        number = "" if mode["mode"] is None else str(mode["mode"])
        frequency = _frequency(recording, mode, clock_is_known=known)
        damping = _with_sd(mode, DAMPING, 100.0), interval(low, high, sd)
        yield mode, (recording["recording"], number, frequency, *damping)
    for line in recording["driven"]:
        yield line, (recording["recording"], "", _frequency(recording, line), "driven", "")


def _beside_the_table(recording: dict[str, Any], *, has_beam: bool) -> list[str]:
    """Lines on flags, further modes, a record that is not one decay, and values that belong to another amplitude."""
    name, lines = recording["recording"], []
    motions = [mode for mode in recording["modes"] if mode["target"]] + recording["driven"]
    flags = list(dict.fromkeys(flag for motion in motions for flag in motion["flags"]))
    if flags:
        lines.append(f"{name}: {', '.join(flags)}")
    others = [mode for mode in recording["modes"] if not (mode["target"] or mode["flags"])]
    if others:
        listed = "; ".join(f"{_frequency(recording, m)} Hz, {_with_sd(m, DAMPING, 100.0)} %" for m in others)
        unchecked = recording["mode_asked"] is not None and not has_beam
        asked = "; which of them has the number given is not checked without [beam]" if unchecked else ""
        lines.append(f"{name}: further modes at {listed}{asked}")
    parts = recording["segments"]
    if len(parts) > 1:
        listed = "; ".join(f"{p['kind']} from {p['start_s']:.4g} s to {p['end_s']:.4g} s" for p in parts)
        lines.append(f"{name}: {listed}")
    for mode in (mode for mode in recording["modes"] if mode["target"]):
        if not _OTHER_AMPLITUDE.isdisjoint(mode["flags"]):
            frequency = _with_sd(mode, SMALL_FREQUENCY, 1.0)
            damping = _with_sd(mode, SMALL_DAMPING, 100.0)
            known = "" if _rate_is_guessed(recording) else f"{frequency} Hz, "
            lines.append(f"{name}: at small amplitude {known}damping ratio {damping} %")
        decays = [_with_sd(one, DAMPING, 100.0) for one in mode["decays"]]
        if len(decays) > 1:
            lines.append(f"{name}: {len(decays)} decays, with damping ratios of {', '.join(decays)} %")
    return lines


def _is_doubtful(recording: dict[str, Any]) -> bool:
    """Whether a check of a target mode says that values may be wrong by more than their intervals."""
    targets = (mode for mode in recording["modes"] if mode["target"])
    severities = {severity for mode in targets for _, severity in mode["severities"]}
    return Severity.WRONG.name in severities


def _rate_is_guessed(recording: dict[str, Any]) -> bool:
    tracking = recording["tracking"]
    return tracking is not None and tracking["time_axis"]["source"] == "container"


def _frequency(recording: dict[str, Any], motion: dict[str, Any], *, clock_is_known: bool = True) -> str:
    """Frequency in Hz with its sd; that of a film without a recorded rate is unknown."""
    if _rate_is_guessed(recording):
        return "unknown"
    value, sd = (_number(motion[column.name]) for column in FREQUENCY)
    return hertz(value, sd, clock_is_known=clock_is_known)


def _with_sd(values: dict[str, Any], columns: tuple[Value, Value], factor: float) -> str:
    value, sd = (factor * _number(values[column.name]) for column in columns)
    return with_sd(value, sd)


def _number(value: float | None) -> float:
    """Number of the summary, where NaN and infinity are null."""
    return float("nan") if value is None else value


def _warn(console: Console, file: str, failure: str, no_target: str, axis: dict[str, Any] | None) -> None:
    if failure:
        # The message of a reader starts with the file's name.
        reason = failure.removeprefix(f"{PurePath(file).name}: ")
        console.print(_text(f"FAILED {file}: {reason}", style="bold red"))
    if no_target:
        console.print(_text(f"NOT IDENTIFIED {file}: {no_target}", style="red"))
    if axis is not None and axis["source"] == "container":
        for sentence in axis["notes"]:
            console.print(_text(f"WARNING {file}: {sentence}", style="bold yellow"))

"""A run started by the studio: at most one, in a process of its own, with its progress and what it found.

The process, ``python -m modalcam.apps.studio.run``, is ``modalcam run --progress json`` that a line on its standard
input, or its end, interrupts: what has begun is finished and saved.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType

from modalcam.common import ExitCode, ModalcamError
from modalcam.pace import Pace, rest_of_run_s
from tracker import Failure


def main() -> None:
    """Run as the arguments say; ends with the exit code of the command."""
    try:
        # Until the run begins there is nothing to finish. An exception out of an import would leave its locks undone.
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, _end_at_once)
        threading.Thread(target=_interrupt_when_asked, daemon=True).start()
        # Heavy: imported once a request can be interrupted.
        import modalcam.commands  # noqa: PLC0415
        import modalcam.console  # noqa: F401, PLC0415
        from modalcam.cli import main as command  # noqa: PLC0415

        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.default_int_handler)
        command()
    except KeyboardInterrupt:
        sys.exit(ExitCode.INTERRUPTED)
    finally:
        # A second interrupt, which follows at once where the studio is closed, must not end the process by the signal.
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def _end_at_once(_number: int, _frame: FrameType | None) -> None:
    os._exit(ExitCode.INTERRUPTED)


def _interrupt_when_asked() -> None:
    # Raised in this thread, handled in the main one; twice stops what has begun.
    for _ in sys.stdin:
        signal.raise_signal(signal.SIGINT)
    signal.raise_signal(signal.SIGINT)


# A child that does not end by itself after the studio has closed is killed after this time.
_PATIENCE_S = 20.0
_MOST_MESSAGES = 200
# Name of the stage whose pace is given in frames.
_TRACKING = "tracking"
_OUTCOMES = {
    ExitCode.OK: "finished",
    ExitCode.INTERNAL: "internal error, please report it",
    ExitCode.USAGE: "not started",
    ExitCode.NO_INPUT: "no recording could be used",
    ExitCode.PARTIAL: "finished, but some recordings failed, gave no mode, or have no certain frame rate",
    ExitCode.INTERRUPTED: "cancelled; what was finished is kept, and the next run continues from it",
}


@dataclass
class StageState:
    """Progress of one stage: names of the tasks that were computed and of those whose saved result was reused.

    `working` holds those that have begun, with the number of frames done; 0 in a stage that counts none.
    """

    name: str
    total: int
    started_s: float
    computed: list[str] = field(default_factory=list)
    reused: list[str] = field(default_factory=list)
    working: dict[str, int] = field(default_factory=dict)
    last_s: float = 0.0

    @property
    def done(self) -> int:
        """Number of tasks that have ended."""
        return len(self.computed) + len(self.reused)

    def state_of(self, name: str, *, is_running: bool, frames: int | None = None) -> str:
        """State of a task of this stage that has `frames` frames in all; empty where none has this name."""
        if name in self.reused:
            return "reused"
        if name in self.computed:
            return "done"
        if name in self.working and is_running:
            done = self.working[name]
            return f"{min(100 * done // frames, 100)} %" if done and frames else "working"
        return "to do" if is_running and self.done < self.total else ""


@dataclass
class RunState:
    """Progress of a run: its stages so far, messages, exit code; `frames` of each recording, where they are known."""

    started_s: float = 0.0
    frames: Mapping[str, int] = field(default_factory=dict)
    stages: list[StageState] = field(default_factory=list)
    messages: list[str] = field(default_factory=list)
    ended_s: float | None = None
    exit_code: int | None = None
    cancelled: bool = False

    @property
    def stage(self) -> StageState:
        """The current stage."""
        return self.stages[-1] if self.stages else StageState("starting", 0, self.started_s)

    @property
    def is_running(self) -> bool:
        """Whether the process has not ended."""
        return self.exit_code is None

    @property
    def outcome(self) -> str:
        """What came of a run that has ended."""
        if self.exit_code is None:
            return ""
        with suppress(ValueError):
            return _OUTCOMES[ExitCode(self.exit_code)]
        return f"the process died (exit code {self.exit_code}); what was finished is kept"

    def elapsed_s(self, now_s: float) -> float:
        """Time since the start, up to the end of the run."""
        return (self.ended_s or now_s) - self.started_s

    def frames_per_s(self) -> float | None:
        """Frames tracked a second so far; None before the first."""
        stage = next((stage for stage in self.stages if stage.name == _TRACKING), None)
        if stage is None:
            return None
        known = sum(self.frames.get(name, 0) for name in stage.computed) + sum(stage.working.values())
        return known / max(stage.last_s - stage.started_s, 1e-3) if known else None

    @property
    def share(self) -> float:
        """Share of the current stage that is done: of its tasks, those begun by their frames where these are known."""
        stage = self.stage
        begun = sum(
            min(done / self.frames[name], 1.0)
            for name, done in stage.working.items()
            if self.frames.get(name)
        )
        return (stage.done + begun) / stage.total if stage.total else 0.0

    def remaining_s(self, now_s: float) -> float | None:
        """Time that the rest of the stage takes at its pace so far; None before there is one."""
        stage = self.stage
        if not self.is_running:
            return None
        rate = self.frames_per_s()
        if stage.name == _TRACKING and rate is not None:
            left = sum(n for name, n in self.frames.items() if name not in (*stage.computed, *stage.reused))
            left -= sum(stage.working.values())
            return max(left / rate - (now_s - stage.last_s), 0.0)
        return Pace(stage.started_s, stage.total, len(stage.computed), len(stage.reused)).left_s(now_s)

    def rest_of_run_s(self, now_s: float) -> float | None:
        """About the time until the run ends; None before there is a pace."""
        left_s = self.remaining_s(now_s)
        if left_s is None:
            return None
        stages, stage_s = [stage.name for stage in self.stages], now_s - self.stage.started_s + left_s
        return left_s + (rest_of_run_s(stages, stage_s) or 0.0)

    def take(self, line: str, now_s: float) -> None:
        """Note one line of the process's output; a line of something else is a message."""
        try:
            values = json.loads(line)
            event = values["event"]
        except (ValueError, TypeError, KeyError):
            self._say(line.rstrip())
            return
        if event == "begin":
            self.stages.append(StageState(values["stage"], values["total"], now_s))
        elif event == "advance" and self.stages:
            stage = self.stages[-1]
            (stage.reused if values["reused"] else stage.computed).append(values["name"])
            stage.working.pop(values["name"], None)
            stage.last_s = now_s
        elif event == "within" and self.stages:
            stage = self.stages[-1]
            stage.working[values["name"]] = values["frames"]
            stage.last_s = now_s if values["frames"] else stage.last_s
        elif event == "say":
            self._say(values["text"])

    def _say(self, text: str) -> None:
        self.messages = [*self.messages[-_MOST_MESSAGES:], text]


class Runner:
    """Starts, cancels and watches the run of a studio."""

    def __init__(self) -> None:
        self.state: RunState | None = None
        self._process: subprocess.Popen[str] | None = None
        self._start = threading.Lock()

    @property
    def is_running(self) -> bool:
        """Whether a run has not ended."""
        return self.state is not None and self.state.is_running

    def start(
        self, folder: Path, out: Path, config: Path | None = None, frames: Mapping[str, int] | None = None
    ) -> None:
        """Start a run of recordings, with their numbers of `frames` by name; ModalcamError while another one runs."""
        with self._start:
            if self.is_running:
                msg = "a run is going on already; wait for it, or cancel it"
                raise ModalcamError(msg)
            given = () if config is None else ("-c", str(config))
            # A session of its own: Ctrl-C ends the studio, which then lets the run finish what has begun.
            self._process = subprocess.Popen(  # noqa: S603 - our own module
                [
                    *(sys.executable, "-m", "modalcam.apps.studio.run"),
                    *("run", "--progress", "json", "-o", str(out), *given, "--", str(folder)),
                ],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
                encoding="utf-8",
                errors="backslashreplace",
                start_new_session=True,
            )
            now_s = time.monotonic()
            self.state = RunState(now_s, frames or {})
            threading.Thread(target=self._watch, args=(self._process, self.state), daemon=True).start()

    def cancel(self) -> None:
        """Let the run end after the recordings it works on; a second call stops these, too."""
        if self.is_running and self.state is not None:
            self.state.cancelled = True
            self._tell("cancel\n")

    def close(self) -> None:
        """End the run, if there is one, and wait for its process."""
        process = self._process
        if process is None or process.poll() is not None:
            return
        self._tell("cancel\n")
        with suppress(OSError):
            process.stdin.close()  # type: ignore[union-attr]  # it was opened as a pipe
        try:
            process.wait(_PATIENCE_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    def _tell(self, line: str) -> None:
        process = self._process
        # A process that has just ended reads nothing more.
        if process is not None and process.stdin is not None:
            with suppress(OSError, ValueError):
                process.stdin.write(line)
                process.stdin.flush()

    @staticmethod
    def _watch(process: subprocess.Popen[str], state: RunState) -> None:
        # Its pipes are closed with the block.
        with process:
            for line in process.stderr or ():
                state.take(line, time.monotonic())
            code = process.wait()
        state.ended_s = time.monotonic()
        state.exit_code = code


MODE_COLUMNS = ("recording", "mode", "frequency / Hz", "damping ratio / %", "90 % interval / %", "flags")


@dataclass(frozen=True)
class RunResults:
    """Rows of the table, and (file, reason) of each recording without a result."""

    rows: tuple[tuple[str, ...], ...]
    failures: tuple[tuple[str, str], ...]


def run_results(summary: Path) -> RunResults | Failure:
    """Read them from ``summary.json``."""
    from modalcam.console import mode_cells  # noqa: PLC0415 - heavy

    try:
        found = json.loads(summary.read_text("utf-8"))
        recordings, config = found["recordings"], found["config"]
        cells = [(motion, row) for recording in recordings for motion, row in mode_cells(recording, config)]
        rows = tuple((*row, ", ".join(motion["flags"])) for motion, row in cells)
        reasons = ((one["file"], one["failure"] or _no_target(one["failed_modes"])) for one in recordings)
        # The message of a reader starts with the file's name.
        failures = tuple((file, reason.removeprefix(f"{file}: ")) for file, reason in reasons if reason)
        return RunResults(rows, failures)
    except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
        return Failure(f"summary.json of the run cannot be read: {error!r}")


def _no_target(failed: list[dict[str, object]]) -> str:
    return next((str(mode["reason"]) for mode in failed if mode["target"]), "")


if __name__ == "__main__":
    main()

"""A run started by the studio: at most one, in a process of its own, with its progress so far.

A run in a process of its own, which tells its progress in lines of JSON: ``python -m modalcam.apps.studio.run``.

Its input is one line of JSON, with the folder, OUT and the configuration; a further line, or its end, interrupts the
run: what has begun is finished and saved. A run that the studio starts is the run of the command line: it takes the
same lock, reuses the same results, and ends with the same exit code.
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
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from modalcam.common import ExitCode, ModalcamError
from modalcam.pipeline import Progress


@dataclass(frozen=True)
class RunRequest:
    """Folder of recordings, folder of results, and the configuration where it is not that of the folder."""

    folder: str
    out: str
    config: str | None = None

    def as_line(self) -> str:
        """The request as the first line of the input."""
        return json.dumps(asdict(self)) + "\n"


class ToldProgress(Progress):
    """Writes one line for each step."""

    def begin(self, stage: str, total: int) -> None:
        """A stage begins."""
        tell(event="begin", stage=stage, total=total)

    def advance(self, name: str, *, reused: bool = False) -> None:
        """One of its tasks has ended."""
        tell(event="advance", name=name, reused=reused)

    def within(self, name: str, frames: int, declared: int) -> None:  # noqa: ARG002 - the page knows the recordings
        """One of its tasks goes on."""
        tell(event="within", name=name, frames=frames)

    def say(self, text: str) -> None:
        """Show a message."""
        tell(event="say", text=text)


def tell(**values: Any) -> None:
    """Write one line of JSON on standard output."""
    sys.stdout.write(json.dumps(values) + "\n")
    sys.stdout.flush()


def main() -> int:
    """Run as the first line of the input says; returns the exit code of `modalcam run`."""
    request = RunRequest(**json.loads(sys.stdin.readline()))
    try:
        return _interruptible(request)
    except KeyboardInterrupt:
        return int(ExitCode.INTERRUPTED)
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def _interruptible(request: RunRequest) -> int:
    try:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.signal(signal.SIGTERM, signal.default_int_handler)
        threading.Thread(target=_interrupt_when_asked, daemon=True).start()
        return _run(request)
    except ModalcamError as error:
        tell(event="say", text=str(error))
        return int(error.exit_code)
    finally:
        # A second interrupt, which follows at once where the studio is closed, must not end the process by the signal.
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def _run(request: RunRequest) -> int:
    # Heavy: imported once a request can be interrupted.
    from modalcam.commands import Options, run  # noqa: PLC0415
    from modalcam.console import exit_code  # noqa: PLC0415

    config = None if request.config is None else Path(request.config)
    options = Options(out=Path(request.out), config=config, jobs=os.cpu_count() or 1)
    result = run(Path(request.folder), options, ToldProgress())
    summary = json.loads((options.out / "summary.json").read_text("utf-8"))["recordings"]
    missing = any(mode["target"] for recording in summary for mode in recording["failed_modes"])
    for recording in summary:
        if recording["failure"]:
            tell(event="say", text=f"{recording['file']}: {recording['failure']}")
    failures = [recording["failure"] for recording in summary]
    return int(exit_code(failures, result.internal_errors, complete=not missing))


def _interrupt_when_asked() -> None:
    # Raised in this thread, handled in the main one; twice stops what has begun.
    for _ in sys.stdin:
        signal.raise_signal(signal.SIGINT)
    signal.raise_signal(signal.SIGINT)


if __name__ == "__main__":
    sys.exit(main())


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
    ExitCode.PARTIAL: "finished, but some recordings failed or gave no mode",
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
        if not stage.computed:
            return None
        return (now_s - stage.started_s) / len(stage.computed) * (stage.total - stage.done)

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

    def start(self, request: RunRequest, frames: Mapping[str, int] | None = None) -> None:
        """Start a run of recordings, with their numbers of `frames` by name; ModalcamError while another one runs."""
        with self._start:
            if self.is_running:
                msg = "a run is going on already; wait for it, or cancel it"
                raise ModalcamError(msg)
            # A session of its own: Ctrl-C ends the studio, which then lets the run finish what has begun.
            self._process = subprocess.Popen(
                [sys.executable, "-m", "modalcam.apps.studio.run"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                encoding="utf-8",
                errors="backslashreplace",
                start_new_session=True,
            )
            now_s = time.monotonic()
            self.state = RunState(now_s, frames or {})
            self._tell(request.as_line())
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
            for line in process.stdout or ():
                state.take(line, time.monotonic())
            code = process.wait()
        state.ended_s = time.monotonic()
        state.exit_code = code

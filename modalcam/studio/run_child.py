"""A run in a process of its own, which tells its progress in lines of JSON: ``python -m modalcam.studio.run_child``.

Its input is one line of JSON, with the folder, OUT and the configuration; a further line, or its end, interrupts the
run: what has begun is finished and saved. A run that the studio starts is the run of the command line: it takes the
same lock, reuses the same results, and ends with the same exit code.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from modalcam.errors import ExitCode, ModalcamError
from modalcam.execution import Progress


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

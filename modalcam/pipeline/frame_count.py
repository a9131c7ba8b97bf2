"""How far another process is with a recording: frames done and declared in a small file, which a cluster can share."""

from __future__ import annotations

import struct
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

# Frames done and declared; 0 from the beginning of the task on.
_COUNT = struct.Struct("<QQ")
# Frames from one writing to the next: it costs as much as a hundredth of a small frame.
_EVERY = 8


@dataclass(frozen=True)
class FrameCount:
    """The count of one task, which the worker writes and the parent reads."""

    path: Path

    def begin(self) -> None:
        """Note that the task has begun."""
        # Progress must not end a task: a full disk is noticed when the result is saved.
        with suppress(OSError):
            self.path.write_bytes(_COUNT.pack(0, 0))

    def __call__(self, done: int, declared: int) -> None:
        """Note the frames done, now and then; as the listener of `tracker.track.track`."""
        if done % _EVERY == 0 or done == declared:
            # Not emptied before: the system writes a file that is emptied to the disk when it is closed.
            with suppress(OSError), self.path.open("r+b", buffering=0) as file:
                file.write(_COUNT.pack(done, max(declared, 0)))

    def read(self) -> tuple[int, int] | None:
        """Frames done and declared, 0 where unknown; None where the task has not begun or has ended."""
        try:
            done, declared = _COUNT.unpack(self.path.read_bytes())
        except (OSError, struct.error):
            return None
        return int(done), int(declared)

    def end(self) -> None:
        """Remove the file."""
        with suppress(OSError):
            self.path.unlink()

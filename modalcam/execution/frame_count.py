"""How far another process is with a recording: a number of frames in a small file, which a cluster can share, too."""

from __future__ import annotations

import struct
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

# Frames done; 0 from the beginning of the task on.
_COUNT = struct.Struct("<Q")
# Frames from one writing to the next: it costs as much as a hundredth of a small frame.
_EVERY = 8


@dataclass(frozen=True)
class FrameCount:
    """The count of one task, which the worker writes and the parent reads."""

    path: Path

    def begin(self) -> None:
        """Note that the task has begun."""
        self._write(0)

    def __call__(self, done: int, declared: int) -> None:
        """Note the frames done, now and then; as the listener of `tracker.track.track`."""
        if done % _EVERY == 0 or done == declared:
            self._write(done)

    def read(self) -> int | None:
        """Frames done; None where the task has not begun or has ended."""
        try:
            (done,) = _COUNT.unpack(self.path.read_bytes())
        except (OSError, struct.error):
            return None
        return int(done)

    def end(self) -> None:
        """Remove the file."""
        with suppress(OSError):
            self.path.unlink()

    def _write(self, done: int) -> None:
        # Progress must not end a task: a full disk is noticed when the result is saved.
        with suppress(OSError):
            self.path.write_bytes(_COUNT.pack(done))

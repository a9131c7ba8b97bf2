"""Memory of processes: of arrays that are no longer used, which the system gets back at once, and at its peak."""

from __future__ import annotations

import ctypes
import sys
from contextlib import suppress
from pathlib import Path

# M_MMAP_THRESHOLD of mallopt(3).
_THRESHOLD = -3
# A column of half a million samples; smaller arrays are reused faster than the system gives new pages.
_LARGE_BYTES = 4 * 2**20


def return_large_arrays() -> None:
    """Make the C library return each large array to the system when it is freed.

    That of GNU by default raises the size from which it does so, up to 32 MB, with every array freed. Those of a long
    record then lie in its heap, whose holes are a fifth of the peak. Nothing is done with other C libraries.
    """
    if sys.platform == "linux":
        mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
        if mallopt is not None:
            mallopt(_THRESHOLD, _LARGE_BYTES)


def peak_bytes(pid: int) -> int:
    """Largest memory so far of a running process, 0 where the system does not say."""
    with suppress(OSError):
        for line in Path(f"/proc/{pid}/status").read_text("ascii").splitlines():
            if line.startswith("VmHWM:"):
                return 1024 * int(line.split()[1])
    return 0

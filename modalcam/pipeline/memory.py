"""Memory of processes: of arrays that are no longer used, which the system gets back at once, and at its peak."""

from __future__ import annotations

import ctypes
import sys
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

# M_MMAP_THRESHOLD of mallopt(3).
_THRESHOLD = -3


@dataclass(frozen=True)
class Tuning:
    """Sizes of arrays and of the memory of a process."""

    #: [bytes] an array of this size is returned to the system when it is freed
    #: measurement: A column of half a million samples; smaller arrays are reused faster than the system gives new
    #: pages.
    large_array: int = 4 * 2**20
    #: [bytes] a smaller limit on data (RLIMIT_DATA) is refused
    #: measurement: NumPy, SciPy, OpenCV, FFmpeg and numba take 268 MB (x86-64, one thread); a fifth for a recording.
    least_data: int = 320 * 2**20
    #: [bytes] a smaller limit on addresses (RLIMIT_AS) is refused
    #: measurement: The same libraries take 832 MB of addresses.
    least_address: int = 1000 * 2**20


TUNING = Tuning()


def return_large_arrays() -> None:
    """Make the C library return each large array to the system when it is freed.

    That of GNU by default raises the size from which it does so, up to 32 MB, with every array freed. Those of a long
    record then lie in its heap, whose holes are a fifth of the peak. Nothing is done with other C libraries.
    """
    if sys.platform == "linux":
        mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
        if mallopt is not None:
            mallopt(_THRESHOLD, TUNING.large_array)


def low_memory_limits() -> str:
    """Why the limits of this process are too low for the libraries; empty where they are not, and on other systems."""
    if sys.platform != "linux":
        return ""
    import resource  # noqa: PLC0415 - other systems have none

    for name, kind, least in (
        ("RLIMIT_DATA, ulimit -d", resource.RLIMIT_DATA, TUNING.least_data),
        ("RLIMIT_AS, ulimit -v", resource.RLIMIT_AS, TUNING.least_address),
    ):
        limit = resource.getrlimit(kind)[0]
        if limit != resource.RLIM_INFINITY and limit < least:
            return (
                f"its libraries need {least // 2**20} MB of memory, but this process may use {limit // 2**20} MB "
                f"({name}); raise the limit, of the shell, container or batch job, to 2 GB or more"
            )
    return ""


def peak_bytes(pid: int) -> int:
    """Largest memory so far of a running process, 0 where the system does not say."""
    with suppress(OSError):
        for line in Path(f"/proc/{pid}/status").read_text("ascii").splitlines():
            if line.startswith("VmHWM:"):
                return 1024 * int(line.split()[1])
    return 0

"""Time and memory of whole commands over the length of a table and of a film, from 10^3 to 10^6 rows or frames.

python -m benchmarks.limits --rows 1000 10000 100000 1000000 --frames 1000 10000 100000
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np

from sim.render import write_video
from tracker import FloatArray, GrayImage

_RATE_HZ, _FREQUENCY_HZ, _NOISE_SD = 1000.0, 18.0, 0.01
# Amplitudes lost over the whole record: it is one free decay of any length.
_TIMES = 3.0
_WIDTH_PX, _HEIGHT_PX, _RADIUS_PX, _SWING_PX = 64, 32, 6.5, 4.0

# A small process that waits: the peak of a program begins with that of the process that starts it. It writes the sum of
# the times, and the largest of the peaks, of the program and of those that it waited for.
_WAITER = """
import resource, subprocess, sys
code = subprocess.call(sys.argv[1:], stdout=subprocess.DEVNULL)
used = resource.getrusage(resource.RUSAGE_CHILDREN)
sys.stdout.write(f"{used.ru_utime + used.ru_stime} {used.ru_maxrss}")
sys.exit(code)
"""


@dataclass(frozen=True)
class Used:
    """CPU seconds of a command with its processes, and the memory of the largest of these in MB."""

    command: str
    size: int
    cpu_s: float
    peak_mb: float


def motion(size: int) -> tuple[FloatArray, FloatArray]:
    """Times in s and displacement of one free decay that lasts for the whole record, without noise."""
    time_s = np.arange(size) / _RATE_HZ
    decay = np.exp(-_TIMES * time_s / time_s[-1])
    return time_s, np.asarray(decay * np.cos(2.0 * np.pi * _FREQUENCY_HZ * time_s))


def write_table(path: Path, rows: int) -> None:
    """A table of times and one channel, with seeded noise."""
    time_s, values = motion(rows)
    values = values + _NOISE_SD * np.random.default_rng(1).standard_normal(rows)
    np.savetxt(path, np.column_stack([time_s, values]), "%.9g", ",", header="time_s,y", comments="")


def write_film(path: Path, frames: int) -> None:
    """A dark dot that moves in one free decay, with seeded noise, coded as MJPG: a million frames take 450 MB."""
    write_video(path, _images(frames), fps_container=Fraction(30), codec="mjpeg")


def _images(frames: int) -> Iterator[GrayImage]:
    rng = np.random.default_rng(1)
    y, x = np.mgrid[:_HEIGHT_PX, :_WIDTH_PX]
    for swing in motion(frames)[1]:
        distance = np.hypot(x - 0.5 * _WIDTH_PX - _SWING_PX * swing, y - 0.5 * _HEIGHT_PX)
        image = 200.0 - 170.0 * np.clip(_RADIUS_PX - distance, 0.0, 1.0) + rng.normal(0.0, 1.5, x.shape)
        yield np.clip(np.rint(image), 0, 255).astype(np.uint8)


def used(arguments: Sequence[str], command: str, size: int) -> Used:
    """Run a program to its end.

    Raises
    ------
    RuntimeError
        If its exit code is not 0.
    """
    done = subprocess.run(  # noqa: S603 - our own program
        [sys.executable, "-c", _WAITER, sys.executable, *arguments],
        stdout=subprocess.PIPE,
        text=True,
        check=False,
    )
    if done.returncode:
        msg = f"{command} of {size} ended with exit code {done.returncode}"
        raise RuntimeError(msg)
    cpu_s, peak_kb = map(float, done.stdout.split())
    return Used(command, size, cpu_s, peak_kb / 1024.0)


def measured(rows: Sequence[int], frames: Sequence[int]) -> Iterator[Used]:
    """`modalcam identify` of tables, `modalcam track` and `modalcam run` of films, each once."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for size in rows:
            path = folder / f"table{size}.csv"
            write_table(path, size)
            call = ("-m", "modalcam", "identify", str(path), "-o", str(folder / f"table{size}"))
            yield used(call, "identify", size)
        for size in frames:
            path = folder / f"film{size}.avi"
            write_film(path, size)
            for command in ("track", "run"):
                out = str(folder / f"{command}{size}")
                call = ("-m", "modalcam", command, str(path), "-o", out, "--jobs", "1")
                yield used((*call, "--fps", f"{_RATE_HZ:g}"), command, size)


def main() -> None:
    """Print a row of the table of docs/bad_inputs.md for each size as it is measured."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, nargs="*", default=[1000, 10_000, 100_000, 1_000_000])
    parser.add_argument("--frames", type=int, nargs="*", default=[1000, 10_000, 100_000])
    given = parser.parse_args()
    sys.stdout.write("| command | size | CPU s | memory, MB |\n| --- | --- | --- | --- |\n")
    for one in measured(given.rows, given.frames):
        sys.stdout.write(f"| {one.command} | {one.size} | {one.cpu_s:.1f} | {one.peak_mb:.0f} |\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()

"""Patches on real clips, compared with Lucas-Kanade as in pyidi, without a known truth.

``python -m benchmarks.tracking_clips CLIP --fps 250 --point 168,46 --point 222,52 [--size 41]``, from the repository's
root. A clip shows a free vibration: the residual is what three decaying sinusoids and a slow polynomial leave of the
displacements, fitted to the frames that both tools have. The frames that repeat their predecessor are left out.
"""

from __future__ import annotations

import argparse
import time
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from scipy.optimize import least_squares

from benchmarks.tracking_peers import pyidi_lk
from tracker import BoolArray, FailedTracking, FloatArray, TrackerSettings, flags, track

MODES, POLYNOMIAL = 3, 5
# The first lines of the spectrum belong to the polynomial.
SLOW_LINES = 8
PADDING = 8


def residual(values: FloatArray, used: BoolArray) -> FloatArray:
    """What decaying sinusoids and a polynomial, fitted to the used samples, leave of all; shape (n,)."""
    n = values.size
    index = np.arange(n)
    slow = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, n), POLYNOMIAL)

    def left(parameters: FloatArray) -> FloatArray:
        waves = [np.exp(complex(-rate / n, angle) * index) for rate, angle in parameters.reshape(-1, 2)]
        columns = np.column_stack([slow, *(part for wave in waves for part in (wave.real, wave.imag))])
        coefficients = np.linalg.lstsq(columns[used], values[used], rcond=None)[0]
        return np.asarray(values - columns @ coefficients)

    found: FloatArray = np.zeros(0)
    for _ in range(MODES):
        rest = np.where(used, left(found), 0.0) * np.hanning(n)
        spectrum = np.abs(np.fft.rfft(rest, PADDING * n))
        spectrum[: PADDING * SLOW_LINES] = 0.0
        start = np.append(found, [0.0, 2.0 * np.pi * np.argmax(spectrum) / (PADDING * n)])
        scale = np.tile([1.0, 1.0 / n], start.size // 2)
        found = least_squares(lambda p: left(p)[used], start, x_scale=scale, max_nfev=30).x
    return left(found)


def gray_frames(path: Path) -> list[FloatArray]:
    """All frames as 8-bit gray images."""
    with av.open(path) as container:
        return [frame.to_ndarray(format="gray8") for frame in container.decode(video=0)]


def main() -> None:
    """Print a row for each point and direction."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("clip", type=Path)
    parser.add_argument("--fps", type=Fraction, required=True)
    parser.add_argument("--point", action="append", required=True, help="x,y in px; may be repeated")
    parser.add_argument("--size", type=int, default=41, help="width of the patch in px, odd")
    options = parser.parse_args()
    points = np.array([[float(value) for value in point.split(",")] for point in options.point])
    settings = TrackerSettings(
        fps=options.fps, kind="patch", points_px=tuple(map(tuple, points)), size_px=float(options.size)
    )
    began = time.perf_counter()
    tracks = track(options.clip, settings, recording=options.clip.name)
    ours_s = time.perf_counter() - began
    if isinstance(tracks, FailedTracking):
        parser.error(tracks.reason)
    frames = gray_frames(options.clip)
    began = time.perf_counter()
    theirs = pyidi_lk(options.size)(np.array(frames), points)
    theirs_s = time.perf_counter() - began
    repeated = np.any(tracks.flags & flags.DUPLICATE_FRAME.value, axis=1)
    print(f"{options.clip.name}: {len(frames)} frames, {ours_s:.1f} s with decoding; pyidi {theirs_s:.1f} s")
    print("point | direction | frames lost | pyidi lost | residual, px | pyidi | ratio")
    for marker in range(len(points)):
        for direction, ours in enumerate((tracks.x_px, tracks.y_px)):
            lost = ~np.isfinite(ours[:, marker]) & ~repeated
            peer_lost = ~np.isfinite(theirs[:, marker, direction])
            used = ~lost & ~repeated & ~peer_lost
            mine, peer = (
                float(np.std(residual(np.where(used, values, 0.0), used)[used]))
                for values in (ours[:, marker], theirs[:, marker, direction])
            )
            row = (
                f"{marker + 1} | {'xy'[direction]} | {np.count_nonzero(lost)} | {np.count_nonzero(peer_lost)}"
            )
            print(f"{row} | {mine:.4f} | {peer:.4f} | {mine / peer:.2f}")


if __name__ == "__main__":
    main()

"""Markers that are lost at the same phase of every cycle: the rest of their track fits wrong frequencies as well."""

from __future__ import annotations

import numpy as np

from tracker import flags
from tracker.arrays import BoolArray, FloatArray
from tracker.results import MarkerTracks

# Below this share of lost frames the rest determines the motion.
LEAST_LOST = 0.25
# Largest line of the spectral window at which the frequency is still unambiguous: that of a marker seen in two thirds
# of each cycle is sin(2 pi / 3) / (2 pi / 3) = 0.41. A marker seen in a third of each has 0.83.
LARGEST_LINE = 0.45
# Slower patterns, fewer than this many times in the record, are single losses.
LEAST_CYCLES = 5
# Longer steps, in median steps, divide the record: the window of its longest part is evaluated, since that of hours
# without a frame fills memory.
LONGEST_STEP = 100
# The spectral window is evaluated this much finer than the resolution of the record.
FINER = 4


def misleading_losses(tracks: MarkerTracks) -> tuple[tuple[str, str], ...]:
    """Markers whose lost frames follow the motion, each with the reason why its track cannot be fitted.

    The fit of a record with gaps is ambiguous by the lines of its spectral window (the Fourier transform of the times
    with a value): a marker that is seen only at the same phase of each cycle fits frequencies that differ from the true
    one by multiples of the line (VanderPlas 2018, doi:10.3847/1538-4365/aab766, section 7). Frames that no marker can
    be measured in (damaged, repeated, recorded at another rate) count neither as found nor as lost.
    """
    unusable = flags.LEFT_OUT | flags.DECODE_CORRUPT.value
    found: list[tuple[str, str]] = []
    for k, name in enumerate(tracks.markers):
        available = (tracks.flags[:, k] & unusable) == 0
        seen = available & np.isfinite(tracks.x_px[:, k])
        lost = 1.0 - float(seen.sum()) / max(float(available.sum()), 1.0)
        if lost < LEAST_LOST or not seen.any():
            continue
        line, frequency_hz = _largest_line(tracks.time_s, seen, available)
        if line > LARGEST_LINE:
            reason = (
                f"it was not found in {100.0 * lost:.0f} % of the frames, and the others repeat {frequency_hz:.4g} "
                "times a second: found only at the same phase of its motion, it has an ambiguous frequency; use a "
                "shorter exposure or a marker that is found throughout"
            )
            found.append((name, reason))
    return tuple(found)


def _largest_line(time_s: FloatArray, seen: BoolArray, available: BoolArray) -> tuple[float, float]:
    """Largest line of the spectral window that is not one of the available frames, 0 to 1, and its frequency in Hz."""
    step_s = float(np.median(np.diff(time_s)))
    pauses = np.flatnonzero(np.diff(time_s) > LONGEST_STEP * step_s) + 1
    part = max(np.split(np.arange(time_s.size), pauses), key=np.size)
    time_s, seen, available = time_s[part], seen[part], available[part]
    slots = np.rint((time_s - time_s[0]) / step_s).astype(np.int64)
    length = FINER * (int(slots[-1]) + 1)
    windows = []
    for mask in (seen, available):
        comb = np.bincount(slots[mask], minlength=length).astype(np.float64)
        windows.append(np.abs(np.fft.rfft(comb, length)) / max(float(mask.sum()), 1.0))
    lines = np.where(windows[1] < 0.5 * windows[0], windows[0], 0.0)
    lines[: FINER * LEAST_CYCLES] = 0.0
    best = int(np.argmax(lines))
    return float(lines[best]), best / (length * step_s)

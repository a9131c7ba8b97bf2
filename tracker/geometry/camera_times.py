"""Times from a camera's header, or from the camera's time of each frame where these carry more."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np

from tracker.geometry import stamps as ticking
from tracker.geometry.time_axis import FrameTimes, TimeAxis, rate_text, regular

# A step this many times the median step means damaged time stamps, not frames that were not saved.
LONGEST_GAP = 1000
# Steps within this share of the median step count as even: camera time stamps have a resolution of about 1 us.
EVEN = 0.1
# Quartz oscillators and rounded headers agree to this; beyond it the frames' own times decide.
HEADER_TOLERANCE = 1e-4
CAMERA_TICK_S = 1e-6


def camera_times(
    stamps: list[int | None],
    time_base: Fraction | None,
    header_rate: Fraction,
    container_rate: Fraction | None,
) -> FrameTimes:
    """Times from a camera's header, or from the camera's time of each frame where these carry more."""
    n = len(stamps)
    by_header = TimeAxis("camera header", header_rate, container_rate)
    by_header_rate = FrameTimes(regular(np.arange(n), header_rate), by_header)
    if n < 2 or time_base is None or any(pts is None for pts in stamps):
        return by_header_rate
    ticks = np.array(stamps, dtype=np.int64)
    steps = np.diff(ticks)
    median = float(np.median(steps))
    broken = np.flatnonzero((steps <= 0) | (steps > LONGEST_GAP * median))
    if broken.size:
        note = (
            f"The camera's frame times jump at frame {int(broken[0]) + 1} and were not used: frames are assumed "
            f"equally spaced at the {rate_text(header_rate)} fps of its header."
        )
        return replace(by_header_rate, time_axis=replace(by_header, notes=(note,)))
    quantum = min(1.5 * CAMERA_TICK_S / float(time_base), 0.6 * median)
    if float(np.max(np.abs(steps - median))) > max(EVEN * median, quantum):
        note = f"The camera's frame times are uneven ({ticking.step_range(steps, time_base)}) and are used directly."
        axis = TimeAxis("camera header", None, container_rate, (note,))
        return FrameTimes((ticks - ticks[0]) * float(time_base), axis)
    length = int(ticks[-1] - ticks[0]) * time_base
    saved_every = max(round(length * header_rate / (n - 1)), 1)
    rate = header_rate / saved_every
    notes = []
    if saved_every > 1:
        notes.append(
            f"Recorded at {rate_text(header_rate)} fps, of which one frame in {saved_every} is in the file: "
            f"{rate_text(rate)} fps."
        )
    spread_s = float(int(steps.max() - steps.min()) * time_base) or CAMERA_TICK_S
    tolerance = max(HEADER_TOLERANCE, spread_s / float(length))
    if abs(float(length * rate / (n - 1)) - 1.0) > tolerance:
        rate = Fraction(n - 1) / length
        notes.append(
            f"The camera's frame times give {rate_text(rate)} fps, which is used: its header's "
            f"{rate_text(header_rate)} fps is a rounded setting."
        )
    axis = TimeAxis("camera header", rate.limit_denominator(10**6), container_rate, tuple(notes))
    return FrameTimes(regular(np.arange(n), rate), axis)

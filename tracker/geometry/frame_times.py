"""Time of each frame of a recording: from the user, the camera's header, the time stamps, or the container."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np

from tracker.arrays import IntArray
from tracker.geometry import stamps as ticking
from tracker.geometry.camera_times import camera_times
from tracker.geometry.given_rate import given_rate
from tracker.geometry.time_axis import (
    GIVE_FPS,
    RATE_SD_PPM,
    FrameTimes,
    NoTimeAxis,
    TimeAxis,
    rate_text,
    regular,
)

# A file with more missing frames than this share has real time stamps.
FEW_GAPS = 0.1


def resolve_time_axis(
    stamps: list[int | None],
    *,
    time_base: Fraction | None,
    container_rate: Fraction | None,
    header_rate: Fraction | None,
    user_fps: Fraction | None,
    rate_sd_ppm: float | None = None,
) -> FrameTimes | NoTimeAxis:
    """Time of each frame, from the first applicable source in this order.

    1. The rate given by the user. Stamps that are uneven in whole steps then count as frames missing from the file.
    2. The camera's own header: its rate, or the camera's time of each frame where these differ from it, for example
       because frames were not saved.
    3. The stamps, where they are uneven by more than one tick of their time base and more than 2 % of a step: they
       must then be real times. Phones and converters jitter by less, at any playback rate.
    4. The container's rate, with a note: high-speed footage is stored at a playback rate.

    There is no time axis when stamps are missing, do not increase or are too coarse for the rate, and no rate is given.

    Parameters
    ----------
    stamps : list of int or None, length n
        Presentation times in ticks of `time_base`, in frame order; camera times where there is a `header_rate`.
    rate_sd_ppm : float or None
        Relative standard deviation of the rate, in parts per million; that of its source (`RATE_SD_PPM`) when None.
    """
    times = _from_first_source(stamps, time_base, container_rate, header_rate, user_fps)
    if isinstance(times, NoTimeAxis):
        return times
    axis = times.time_axis
    ppm = RATE_SD_PPM[axis.source] if rate_sd_ppm is None else rate_sd_ppm
    return replace(times, time_axis=replace(axis, rate_sd_ppm=ppm))


def _from_first_source(
    stamps: list[int | None],
    time_base: Fraction | None,
    container_rate: Fraction | None,
    header_rate: Fraction | None,
    user_fps: Fraction | None,
) -> FrameTimes | NoTimeAxis:
    if user_fps is not None:
        return given_rate(stamps, time_base, container_rate, user_fps)
    if header_rate is not None:
        return camera_times(stamps, time_base, header_rate, container_rate)
    return _file_times(stamps, time_base, container_rate)


def _file_times(
    stamps: list[int | None], time_base: Fraction | None, container_rate: Fraction | None
) -> FrameTimes | NoTimeAxis:
    """Times from the time stamps where they carry more than a playback rate, else from the container's rate."""
    n = len(stamps)
    counts = None
    if time_base is not None and n > 1 and not any(pts is None for pts in stamps):
        whole = np.array(stamps, dtype=np.int64)
        counts = ticking.whole_frames(np.diff(whole), time_base, container_rate)
    trouble = None if counts is not None else ticking.problem(stamps, time_base)
    if trouble is not None or time_base is None:
        return NoTimeAxis(f"{trouble}; {GIVE_FPS}")
    ticks = np.array(stamps, dtype=np.int64)
    steps = np.diff(ticks)
    gaps: tuple[str, ...] = ()
    slots = np.arange(n)
    if counts is not None or not ticking.is_regular(steps):
        jump = ticking.too_long(steps)
        if jump is not None:
            return NoTimeAxis(ticking.jump_text(jump, steps, time_base))
        segments = ticking.rate_segments(steps)
        found = (counts, 1.0) if counts is not None else ticking.whole_steps(steps, exact=True)
        if segments or found is None or np.mean(found[0] > 1) > FEW_GAPS:
            return _real_times(ticks, time_base, container_rate, segments, found)
        slots = np.concatenate([[0], np.cumsum(found[0])])
        absent = int(slots[-1]) + 1 - n
        gaps = (
            f"The time stamps show gaps of {absent} frames that are not in the file; times allow for them.",
        )
        container_rate = _known_rate(found[1] * float(time_base), container_rate)
    rate = container_rate
    if rate is None and n > 1:
        rate = Fraction(n - 1) / (int(ticks[-1] - ticks[0]) * time_base)
    if rate is None:
        return NoTimeAxis(f"the file contains no frame rate; {GIVE_FPS}")
    note = (
        f"The container's {rate_text(rate)} fps is a playback rate: high-speed footage is nearly always stored "
        f"slower than it was recorded, and every frequency scales with it; {GIVE_FPS}."
    )
    return FrameTimes(regular(slots, rate), TimeAxis("container", rate, rate, (note, *gaps)))


def _real_times(
    ticks: IntArray,
    time_base: Fraction,
    container_rate: Fraction | None,
    segments: tuple[ticking.RateSegment, ...],
    whole: tuple[IntArray, float] | None,
) -> FrameTimes:
    """Uneven time stamps as times, without their rounding to ticks where what they are rounded from is seen."""
    exact, used = ticks.astype(np.float64), None
    what = f"are uneven ({ticking.step_range(np.diff(ticks), time_base)})"
    if segments:
        exact = ticking.without_rounding(ticks, segments)
        most = ticking.most_frames(segments)[0]
        used = ticking.frames_at_rate(ticks.size, segments, most)
        what = f"show that the rate changes inside the file ({ticking.listed(segments, time_base)})"
    elif whole is not None:
        exact = np.concatenate([[0.0], np.cumsum(whole[0]) * whole[1]])
    note = f"The time stamps {what} and are taken as real times; if they are not, {GIVE_FPS}."
    if used is not None and not used.all():
        note += (
            f" Frames at a rate that differs much from the {1.0 / (most.step * float(time_base)):.4g} fps of most "
            "frames are not used; to use others, give their rate as fps."
        )
    axis = TimeAxis("time stamps", None, container_rate, (note,))
    return FrameTimes((exact - exact[0]) * float(time_base), axis, used)


def _known_rate(interval_s: float, container_rate: Fraction | None) -> Fraction:
    """The container's rate, or one derived from the stamps where the container's is a mean over gaps."""
    if container_rate is not None and abs(float(container_rate) * interval_s - 1.0) < 1e-3:
        return container_rate
    return Fraction(1.0 / interval_s).limit_denominator(1001)

"""Times at the rate given by the user, with what the time stamps say about missing frames and changes of the rate."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np

from tracker.arrays import IntArray
from tracker.geometry import stamps as ticking
from tracker.geometry.time_axis import FrameTimes, NoTimeAxis, TimeAxis, rate_text, regular

# A given rate is that of a part of the file where their rates differ by less than this share.
NAMED = 0.02
# Without such a part, it is that of the part with at least this share of the frames.
MAIN_PART = 0.75


def given_rate(
    stamps: list[int | None], time_base: Fraction | None, container_rate: Fraction | None, fps: Fraction
) -> FrameTimes | NoTimeAxis:
    """Times at the user's rate; stamps show missing frames and changes of the rate, and must agree with the times."""
    axis = TimeAxis("user", fps, container_rate, _ratio_note(fps, container_rate))
    plain = FrameTimes(regular(np.arange(len(stamps)), fps), axis)
    if len(stamps) < 3 or any(pts is None for pts in stamps):
        return plain
    ticks = np.array(stamps, dtype=np.int64)
    steps: IntArray = np.diff(ticks)
    if steps.min() <= 0:
        return _noted(plain, "The file's time stamps do not increase; frames are counted instead.")
    counts = ticking.whole_frames(steps, time_base, container_rate)
    if counts is None and ticking.is_regular(steps):
        return plain
    jump = ticking.too_long(steps)
    if jump is not None:
        return NoTimeAxis(ticking.jump_text(jump, steps, time_base))
    segments = ticking.rate_segments(steps)
    if segments and time_base is not None:
        return _changing_rate(ticks, time_base, segments, fps, axis)
    return _with_gaps(ticks, time_base, counts, fps, plain)


def _with_gaps(
    ticks: IntArray,
    time_base: Fraction | None,
    counts: IntArray | None,
    fps: Fraction,
    plain: FrameTimes,
) -> FrameTimes | NoTimeAxis:
    """The evenly spaced times of `plain`, with gaps where the stamps show missing frames (`counts` if known)."""
    steps: IntArray = np.diff(ticks)
    if counts is None:
        found = ticking.whole_steps(steps)
        counts = None if found is None else found[0]
    if counts is not None:
        slots = np.concatenate([[0], np.cumsum(counts)])
        absent = int(slots[-1]) + 1 - ticks.size
        if not absent:
            return plain
        note = f"The time stamps show gaps of {absent} frames that are not in the file; times allow for them."
        return _noted(replace(plain, time_s=regular(slots, fps)), note)
    if ticking.evenly_spaced(ticks) or np.median(steps) < ticking.LEAST_TICKS:
        note = "The file's time stamps are uneven; they are ignored because the recorded rate is given."
        return _noted(plain, note)
    spread = f"steps of {int(steps.min())} to {int(steps.max())} ticks"
    if time_base is not None:
        spread = ticking.step_range(steps, time_base)
    return NoTimeAxis(
        f"the time stamps contradict the constant rate that is given: their {spread} are not whole multiples of one "
        "frame interval; leave out fps to use the time stamps as real times, or export the frames without them (FFV1 "
        "in AVI) if they are wrong"
    )


def _changing_rate(
    ticks: IntArray,
    time_base: Fraction,
    segments: tuple[ticking.RateSegment, ...],
    fps: Fraction,
    axis: TimeAxis,
) -> FrameTimes | NoTimeAxis:
    """Times of a file whose rate changes, at the user's rate in the part that has it or that is most of the file."""
    seen = f"rate changes inside the file: {ticking.listed(segments, time_base)} by the time stamps"

    def off(segment: ticking.RateSegment) -> float:
        return abs(segment.step * float(time_base * fps) - 1.0)

    chosen = min(segments, key=off)
    if off(chosen) > NAMED:
        most = ticking.most_frames(segments)
        if sum(s.frames for s in most) < MAIN_PART * ticks.size:
            return NoTimeAxis(
                f"the {seen}, and {rate_text(fps)} fps is the rate of none of these parts; give the rate of one part "
                "as it stands here, leave out fps to use the time stamps as real times, or cut the file to one part"
            )
        chosen = max(most, key=lambda s: s.frames)
    note = (
        f"The {seen}. The {rate_text(fps)} fps given are those of frames {chosen.first} to {chosen.last}; the other "
        "frames keep their times relative to these, and those at a very different rate are not used."
    )
    exact = ticking.without_rounding(ticks, segments)
    time_s = (exact - exact[0]) / (chosen.step * float(fps))
    used = ticking.frames_at_rate(ticks.size, segments, chosen)
    return _noted(FrameTimes(time_s, replace(axis, fps_recorded=None), used), note)


def _noted(times: FrameTimes, note: str) -> FrameTimes:
    axis = times.time_axis
    return replace(times, time_axis=replace(axis, notes=(*axis.notes, note)))


def _ratio_note(user: Fraction, container: Fraction | None) -> tuple[str, ...]:
    if container is None or container == user:
        return ()
    ratio = float(user / container)
    pace = f"{ratio:.4g} times slower" if ratio > 1 else f"{1 / ratio:.4g} times faster"
    note = (
        f"Recorded at {rate_text(user)} fps as given; the file plays at {rate_text(container)} fps, "
        f"{pace} than it was recorded."
    )
    return (note,)

"""Presentation times in whole ticks: missing frames, changes of the rate, and what is wrong with them."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from tracker.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class Tuning:
    """What time stamps can tell."""

    #: [1] time stamps that vary by less than this share of a step carry no more than a playback rate
    #: convention: phones and converters shake their stamps by a fraction of a percent at whatever rate they play
    jitter: float = 0.02
    #: [1] steps are whole multiples of a frame interval if they deviate by less than a tick plus this share of it
    whole: float = 0.1
    #: [ticks] in a frame interval
    #: convention: with fewer every step is near a whole multiple of it
    least_ticks: int = 3
    #: [frames] missing for each in the file, beyond which the stamps are not those of the recording
    absent_per_frame: int = 100
    #: [1] steps that differ by less from one to the next belong to the same rate
    #: convention: below the ratio of usual rates
    same_rate: float = 0.15
    #: [frames] in succession that make a rate
    least_steps: int = 8
    #: [1] rates that differ by less than this factor are used together
    #: convention: each frame has its time
    mixed: float = 1.5
    #: [1] parts that a message lists
    #: convention: a line of text
    listed: int = 6
    #: [1] share of a step by which single steps of evenly spaced frames may differ
    #: convention: a missing frame makes a step of twice the mean
    even_step: float = 0.4
    #: [1] the same in long records, for each frame
    even_drift: float = 1e-3


TUNING = Tuning()


@dataclass(frozen=True)
class RateSegment:
    """Frames `first` to `last`, evenly spaced by `step` ticks."""

    first: int
    last: int
    step: float

    @property
    def frames(self) -> int:
        """Number of frames."""
        return self.last - self.first + 1


def is_regular(steps: IntArray) -> bool:
    """Whether steps vary by no more than rounding to ticks, or the jitter of a constant rate."""
    return steps.size == 0 or int(np.ptp(steps)) <= max(1.0, TUNING.jitter * float(np.median(steps)))


def problem(stamps: list[int | None], time_base: Fraction | None) -> str | None:
    """Why the stamps cannot give a time axis, or None."""
    if time_base is None:
        return "the file has no time base"
    missing = sum(pts is None for pts in stamps)
    if missing:
        return f"{missing} of {len(stamps)} frames have no time stamp"
    steps = np.diff(np.array(stamps, dtype=np.int64))
    wrong = int(np.count_nonzero(steps <= 0))
    coarse = f"the time stamps' ticks of {seconds(1, time_base)} s are too coarse for the frame rate"
    if wrong and steps.min() == 0 and steps.sum() < 2 * steps.size:
        return f"{coarse} ({wrong} of {steps.size} steps are zero)"
    if wrong:
        where = int(np.flatnonzero(steps <= 0)[0]) + 1
        return f"the time stamps do not increase ({wrong} of {steps.size} steps, first at frame {where})"
    if steps.size and time_base > Fraction(1, 100_000_000) and steps.mean() < 2 and steps.max() > 1:
        return coarse
    return None


def whole_steps(steps: IntArray, *, exact: bool = False) -> tuple[IntArray, float] | None:
    """Frame intervals in each step, and ticks in a frame interval; None where steps are no whole multiples of any.

    With `exact`, all stamps must be at whole multiples but for rounding, so that nothing is lost without them.

    The frame interval is the smallest step or, where no two successive frames are in the file, a half or a third of
    it. It is refined over longer and longer steps, because the stamps hold it rounded to whole ticks: 33 ms for 33.3.
    """
    smallest = float(np.median(steps[steps <= steps.min() * (1.0 + TUNING.same_rate) + 1]))
    for parts in (1, 2, 3):
        base = smallest / parts
        for longest in (1, 4, 16, 64, np.iinfo(np.int64).max):
            counts = np.rint(steps / base).astype(np.int64)
            chosen = (counts >= 1) & (counts <= longest * parts)
            if np.any(chosen):
                base = float(steps[chosen].sum() / counts[chosen].sum())
        counts = np.rint(steps / base).astype(np.int64)
        off = np.abs(steps - counts * base)
        if (
            base >= parts * TUNING.least_ticks
            and counts.min() >= 1
            and np.all(off <= 1.0 + TUNING.whole / parts * base)
        ):
            drift = np.cumsum(steps) - np.cumsum(counts) * base
            return (
                (counts, base) if not exact or np.ptp(drift) <= 2.0 * max(1.0, TUNING.jitter * base) else None
            )
    return None


def jump(steps: IntArray, time_base: Fraction | None) -> str | None:
    """Why stamps cannot be used of which a step is longer than a recording with so few frames can be, or None."""
    at = int(np.argmax(steps))
    if not float(steps[at]) > TUNING.absent_per_frame * (steps.size + 1) * float(np.median(steps)):
        return None
    length = f"{int(steps[at])} ticks" if time_base is None else f"{seconds(int(steps[at]), time_base)} s"
    return (
        f"the time stamps jump by {length} between frames {at} and {at + 1}, longer than such a recording can be; "
        "cut the file there, or export its frames without their stamps (FFV1 in AVI)"
    )


def evenly_spaced(ticks: IntArray) -> bool:
    """Whether stamps with jitter agree with evenly spaced frames: near them everywhere, and none of them missing."""
    steps = np.diff(ticks)
    mean = float(ticks[-1] - ticks[0]) / steps.size
    off = np.abs(ticks - ticks[0] - mean * np.arange(ticks.size))
    return bool(
        np.all(np.abs(steps - mean) < TUNING.even_step * mean)
        # half a step from its place is the next frame
        and np.all(off < mean * max(0.5, TUNING.even_drift * steps.size))
    )


def rate_segments(steps: IntArray) -> tuple[RateSegment, ...]:
    """Segments of constant rate, in order, if there are two rates or more; otherwise none.

    Frames between them that belong to no rate, such as at single missing frames, are in no segment.
    """
    if steps.size < 2 * TUNING.least_steps or int(steps.min()) <= 0:
        return ()
    change = np.abs(np.diff(steps)) > np.maximum(1.0, TUNING.same_rate * np.minimum(steps[1:], steps[:-1]))
    edges = np.concatenate([[0], np.flatnonzero(change) + 1, [steps.size]])
    runs = [
        RateSegment(int(a), int(b), float(steps[a:b].mean()))
        for a, b in itertools.pairwise(edges)
        if b - a >= TUNING.least_steps
    ]
    joined: list[RateSegment] = []
    for run in runs:
        if joined and same_rate(joined[-1], run):
            before = joined.pop()
            steps_here = np.array([before.step] * before.frames + [run.step] * run.frames)
            run = RateSegment(before.first, run.last, float(steps_here.mean()))  # noqa: PLW2901
        joined.append(run)
    return tuple(joined) if len(joined) > 1 else ()


def same_rate(one: RateSegment, other: RateSegment) -> bool:
    """Whether two segments have the same rate, ticks and jitter allowed for."""
    smaller, larger = sorted((one.step, other.step))
    return larger - smaller <= max(0.5, TUNING.same_rate * smaller)


def most_frames(segments: tuple[RateSegment, ...]) -> tuple[RateSegment, ...]:
    """The segments of the rate that most frames have."""
    alike = [tuple(other for other in segments if same_rate(one, other)) for one in segments]
    return max(alike, key=lambda group: sum(s.frames for s in group))


def frames_at_rate(n: int, segments: tuple[RateSegment, ...], chosen: RateSegment) -> BoolArray:
    """Of n frames those that do not belong to a segment of a rate that differs much from the chosen one; shape (n,)."""
    used = np.ones(n, dtype=bool)
    alike = [max(s.step, chosen.step) < TUNING.mixed * min(s.step, chosen.step) for s in segments]
    # Segments share the frame between them.
    for wanted in (False, True):
        for segment, is_alike in zip(segments, alike, strict=True):
            if is_alike == wanted:
                used[segment.first : segment.last + 1] = wanted
    return used


def without_rounding(ticks: IntArray, segments: tuple[RateSegment, ...]) -> FloatArray:
    """Stamps in ticks, those within a segment on the straight line through them where they are so but for rounding."""
    exact = ticks.astype(np.float64)
    for segment in segments:
        frames = np.arange(segment.first, segment.last + 1)
        slope, start = np.polyfit(frames - segment.first, ticks[frames] - ticks[segment.first], 1)
        line = ticks[segment.first] + start + slope * (frames - segment.first)
        if np.max(np.abs(line - ticks[frames])) <= max(1.0, TUNING.jitter * slope):
            exact[frames] = line
    return exact if np.all(np.diff(exact) > 0.0) else ticks.astype(np.float64)


def listed(segments: tuple[RateSegment, ...], time_base: Fraction) -> str:
    """Segments as text: frames and rate of each, at most six."""
    parts = [
        f"frames {s.first} to {s.last} at {1.0 / (s.step * float(time_base)):.4g} fps"
        for s in segments[: TUNING.listed]
    ]
    more = len(segments) - TUNING.listed
    return ", ".join(parts) + (f" and {more} more parts" if more > 0 else "")


def seconds(ticks: int, time_base: Fraction) -> str:
    """Ticks in seconds, as text."""
    return f"{float(ticks * time_base):.6g}"


def step_range(steps: IntArray, time_base: Fraction) -> str:
    """Shortest and longest step as text."""
    return f"steps of {seconds(int(steps.min()), time_base)} to {seconds(int(steps.max()), time_base)} s"


def whole_frames(
    steps: IntArray, time_base: Fraction | None, container_rate: Fraction | None
) -> IntArray | None:
    """The steps where a tick is a frame interval, as in AVI, and some are longer: then they are not rounded."""
    if time_base is None or container_rate is None or time_base * container_rate != 1:
        return None
    return steps if steps.min() == 1 and steps.max() > 1 else None

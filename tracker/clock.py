"""The time axis of a recording: which rate is believed, and what the user must be told about it."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise

import numpy as np

from tracker.series import Clock, FloatArray

GIVE_FPS = "give the recorded rate with --fps or [camera] fps"


@dataclass(frozen=True)
class TimeAxis:
    """Times of all frames in s, 0 at the first, and where they came from."""

    time_s: FloatArray
    clock: Clock


@dataclass(frozen=True)
class NoClock:
    """No time axis can be made: falsy, with the reason."""

    reason: str

    def __bool__(self) -> bool:
        return False


def resolve_clock(
    stamps: list[int | None],
    *,
    time_base: Fraction | None,
    container_rate: Fraction | None,
    header_rate: Fraction | None,
    user_fps: Fraction | None,
) -> TimeAxis | NoClock:
    """Time of each frame, from the first source of this order that can be believed.

    1. The rate the user gives. Stamps that are uneven in whole steps then count as frames that are absent
       from the file.
    2. The rate in a camera's own header.
    3. The stamps, where they are uneven by more than one tick of their time base: a constant rate would be
       wrong, so they are real times.
    4. The container's rate, with a note: high-speed footage is stored at a playback rate.

    Parameters
    ----------
    stamps : list of int or None, length n
        Presentation times in ticks of `time_base`, in the order of the frames.
    time_base, container_rate, header_rate, user_fps : Fraction or None
        Seconds a tick; frames a second.

    Returns
    -------
    TimeAxis or NoClock
        `NoClock` when stamps are missing, do not increase or are too coarse for the rate, and no rate is given.
    """
    n = len(stamps)
    if user_fps is not None:
        slots, notes = _slots(stamps)
        clock = Clock("user", user_fps, container_rate, (*_ratio_note(user_fps, container_rate), *notes))
        return TimeAxis(_regular(slots, user_fps), clock)
    if header_rate is not None:
        return TimeAxis(
            _regular(np.arange(n), header_rate), Clock("camera header", header_rate, container_rate)
        )
    problem = _problem(stamps, time_base)
    if problem is not None or time_base is None:
        return NoClock(f"{problem}; {GIVE_FPS}")
    ticks = np.array(stamps, dtype=np.int64)
    steps = np.diff(ticks)
    if n > 1 and int(steps.max() - steps.min()) > 1:
        time_s = (ticks - ticks[0]) * float(time_base)
        note = (
            f"The time stamps are uneven (steps of {_seconds(int(steps.min()), time_base)} to "
            f"{_seconds(int(steps.max()), time_base)} s) and are taken as real times; if they are not, {GIVE_FPS}."
        )
        return TimeAxis(time_s, Clock("time stamps", None, container_rate, (note,)))
    rate = container_rate
    if rate is None and n > 1:
        rate = Fraction(n - 1) / (int(ticks[-1] - ticks[0]) * time_base)
    if rate is None:
        return NoClock(f"the file holds no frame rate; {GIVE_FPS}")
    note = (
        f"The container's {rate_text(rate)} fps is a playback rate: high-speed footage is nearly always stored "
        f"slower than it was recorded, and every frequency scales with it; {GIVE_FPS}."
    )
    return TimeAxis(_regular(np.arange(n), rate), Clock("container", rate, rate, (note,)))


def rate_text(rate: Fraction) -> str:
    """A rate for people: whole numbers as such, others to six digits."""
    return str(rate.numerator) if rate.denominator == 1 else f"{float(rate):.6g}"


def step_histogram(stamps: list[int | None]) -> dict[int, int]:
    """How often each difference of neighbouring stamps occurs, in ticks; missing stamps are left out."""
    known = [pts for pts in stamps if pts is not None]
    return dict(sorted(Counter(b - a for a, b in pairwise(known)).items()))


def _seconds(ticks: int, time_base: Fraction) -> str:
    return f"{float(ticks * time_base):.6g}"


def _regular(slots: np.ndarray, rate: Fraction) -> FloatArray:
    # Multiplying before dividing keeps whole seconds exact.
    return np.asarray(slots, dtype=np.float64) * rate.denominator / rate.numerator


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


def _problem(stamps: list[int | None], time_base: Fraction | None) -> str | None:
    """Why the stamps cannot serve as a clock, or None."""
    if time_base is None:
        return "the file has no time base"
    missing = sum(pts is None for pts in stamps)
    if missing:
        return f"{missing} of {len(stamps)} frames have no time stamp"
    steps = np.diff(np.array(stamps, dtype=np.int64))
    wrong = int(np.count_nonzero(steps <= 0))
    if wrong and steps.sum() < 2 * steps.size:
        return (
            f"the time stamps' ticks of {_seconds(1, time_base)} s are too coarse for the frame rate "
            f"({wrong} of {steps.size} steps are zero)"
        )
    if wrong:
        where = int(np.flatnonzero(steps <= 0)[0]) + 1
        return f"the time stamps do not increase ({wrong} of {steps.size} steps, first at frame {where})"
    if steps.size and time_base > Fraction(1, 100_000_000) and steps.mean() < 2 and steps.max() > 1:
        return f"the time stamps' ticks of {_seconds(1, time_base)} s are too coarse for the frame rate"
    return None


def _slots(stamps: list[int | None]) -> tuple[np.ndarray, tuple[str, ...]]:
    """Index of each frame on the camera's clock: gaps of whole steps in the stamps count."""
    n = len(stamps)
    plain = np.arange(n)
    if n < 3 or any(pts is None for pts in stamps):
        return plain, ()
    ticks = np.array(stamps, dtype=np.int64)
    steps = np.diff(ticks)
    if steps.min() <= 0:
        return plain, ("The file's time stamps do not increase; frames are counted instead.",)
    if int(steps.max() - steps.min()) <= 1:
        return plain, ()
    base = float(np.median(steps[steps <= steps.min() + 1]))
    slots = np.rint((ticks - ticks[0]) / base).astype(np.int64)
    error = np.abs(np.diff(slots) * base - steps)
    if base < 3 or np.any(error > 1 + 0.02 * base) or np.any(np.diff(slots) < 1):
        note = "The file's time stamps are uneven; they are ignored, as the recorded rate is given."
        return plain, (note,)
    absent = int(slots[-1]) + 1 - n
    note = f"The time stamps leave room for {absent} frames that are not in the file; times allow for them."
    return slots, (note,)

"""The time axis of a recording: which rate is believed, and what the user must be told about it."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import pairwise

import numpy as np

from tracker.arrays import FloatArray
from tracker.results import Clock

GIVE_FPS = "give the recorded rate with --fps or [camera] fps"
# A step so many times the usual one is a broken clock, not frames that were not saved.
LONGEST_GAP = 1000
# Steps that differ by less than this share of the usual one are even: cameras' clocks have ticks of about 1 us.
EVEN = 0.1
# Time stamps of a file that differ by less than this share of a step tell no more than a playback rate does.
JITTER = 0.02
# Quartz clocks and rounded headers agree this well; where the frames' times say otherwise they are right.
HEADER_TOLERANCE = 1e-4
CAMERA_TICK_S = 1e-6
# More absent frames than this for each that is there: the stamps are not those of the recording.
ABSENT_PER_FRAME = 100


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
    2. The camera's own header: its rate, and the camera's times of the frames where they tell more, such as frames
       that were not saved.
    3. The stamps, where they are uneven by more than one tick of their time base and more than 2 % of a step: a
       constant rate would be wrong, so they are real times. Phones and converters jitter by less, at any playback rate.
    4. The container's rate, with a note: high-speed footage is stored at a playback rate.

    Parameters
    ----------
    stamps : list of int or None, length n
        Presentation times in ticks of `time_base`, in the order of the frames.
    time_base, container_rate, header_rate, user_fps : Fraction or None
        Seconds a tick; frames a second. With a `header_rate`, stamps are of the camera's clock.

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
        return _camera_axis(stamps, time_base, header_rate, container_rate)
    problem = _problem(stamps, time_base)
    if problem is not None or time_base is None:
        return NoClock(f"{problem}; {GIVE_FPS}")
    ticks = np.array(stamps, dtype=np.int64)
    steps = np.diff(ticks)
    if n > 1 and int(steps.max() - steps.min()) > max(1.0, JITTER * float(np.median(steps))):
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


def _camera_axis(
    stamps: list[int | None],
    time_base: Fraction | None,
    header_rate: Fraction,
    container_rate: Fraction | None,
) -> TimeAxis:
    """Times by a camera's header, and by its times of the frames where they say more."""
    n = len(stamps)
    regular = TimeAxis(
        _regular(np.arange(n), header_rate), Clock("camera header", header_rate, container_rate)
    )
    if n < 2 or time_base is None or any(pts is None for pts in stamps):
        return regular
    ticks = np.array(stamps, dtype=np.int64)
    steps = np.diff(ticks)
    usual = float(np.median(steps))
    broken = np.flatnonzero((steps <= 0) | (steps > LONGEST_GAP * usual))
    if broken.size:
        note = (
            f"The camera's times of the frames jump at frame {int(broken[0]) + 1} and were not used: frames are "
            f"taken as even, at the {rate_text(header_rate)} fps of its header."
        )
        return replace(regular, clock=replace(regular.clock, notes=(note,)))
    quantum = min(1.5 * CAMERA_TICK_S / float(time_base), 0.6 * usual)
    if float(np.max(np.abs(steps - usual))) > max(EVEN * usual, quantum):
        note = (
            f"The camera's times of the frames are uneven (steps of {_seconds(int(steps.min()), time_base)} to "
            f"{_seconds(int(steps.max()), time_base)} s) and are used as they are."
        )
        time_s = (ticks - ticks[0]) * float(time_base)
        return TimeAxis(time_s, Clock("camera header", None, container_rate, (note,)))
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
            f"The camera's times of the frames give {rate_text(rate)} fps, which is used: its header's "
            f"{rate_text(header_rate)} fps is a rounded setting."
        )
    return TimeAxis(
        _regular(np.arange(n), rate),
        Clock("camera header", rate.limit_denominator(10**6), container_rate, tuple(notes)),
    )


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
    if wrong and steps.min() == 0 and steps.sum() < 2 * steps.size:
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
    if absent > ABSENT_PER_FRAME * n:
        return plain, ("The file's time stamps jump; they are ignored, as the recorded rate is given.",)
    note = f"The time stamps leave room for {absent} frames that are not in the file; times allow for them."
    return slots, (note,)

"""Time axis of a recording: the frame rate that applies, and notes for the user."""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Literal

import numpy as np

from tracker.arrays import FloatArray, IntArray

TimeSource = Literal["user", "camera header", "time stamps", "container", "unknown"]

# Relative standard deviation of a rate by its source, in parts per million: a number typed by the user is taken as it
# is; quartz oscillators of cameras are within 50; phones state the rate of their display and converters round it.
RATE_SD_PPM: dict[TimeSource, float] = {
    "user": 0.0,
    "camera header": 50.0,
    "time stamps": 1000.0,
    "container": 1000.0,
    "unknown": 0.0,
}
# A rate that is less certain gives no frequency.
MAX_RATE_SD_PPM = 100_000.0

GIVE_FPS = "give the recorded rate with --fps or [camera] fps"
# A step this many times the median step means damaged time stamps, not frames that were not saved.
LONGEST_GAP = 1000
# Steps within this share of the median step count as even: camera time stamps have a resolution of about 1 us.
EVEN = 0.1
# Time stamps in a file that vary by less than this share of a step carry no more than a playback rate.
JITTER = 0.02
# Quartz oscillators and rounded headers agree to this; beyond it the frames' own times decide.
HEADER_TOLERANCE = 1e-4
CAMERA_TICK_S = 1e-6
# With more missing frames than this per frame in the file, the stamps are not those of the recording.
ABSENT_PER_FRAME = 100


@dataclass(frozen=True)
class TimeAxis:
    """Provenance of a recording's time axis.

    Attributes
    ----------
    source : str
        "user" (``--fps`` or ``experiment.toml``), "camera header", "time stamps" (uneven presentation times, used
        directly), "container" (the playback rate of the file: usually not the recorded rate of high-speed footage).
    fps_recorded, fps_container : Fraction or None
        Frames per second at which the scene was recorded (None when times are uneven), and at which the file plays.
    notes : tuple of str
        What the user must know about the time axis, each a full sentence.
    rate_sd_ppm : float
        Relative standard deviation of the rate, in parts per million: an error common to all frequencies.
    """

    source: TimeSource
    fps_recorded: Fraction | None
    fps_container: Fraction | None = None
    notes: tuple[str, ...] = ()
    rate_sd_ppm: float = 0.0

    @property
    def is_playback_guess(self) -> bool:
        """Whether the time axis is based on the container's rate alone."""
        return self.source == "container"


@dataclass(frozen=True)
class FrameTimes:
    """Time of each frame in s, 0 at the first, and its provenance."""

    time_s: FloatArray
    time_axis: TimeAxis


@dataclass(frozen=True)
class NoTimeAxis:
    """No time axis can be determined: falsy, with the reason."""

    reason: str

    def __bool__(self) -> bool:
        return False


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
    n = len(stamps)
    if user_fps is not None:
        slots, notes = _frame_slots(stamps)
        axis = TimeAxis("user", user_fps, container_rate, (*_ratio_note(user_fps, container_rate), *notes))
        return FrameTimes(_regular(slots, user_fps), axis)
    if header_rate is not None:
        return _camera_times(stamps, time_base, header_rate, container_rate)
    problem = _problem(stamps, time_base)
    if problem is not None or time_base is None:
        return NoTimeAxis(f"{problem}; {GIVE_FPS}")
    ticks = np.array(stamps, dtype=np.int64)
    steps = np.diff(ticks)
    if n > 1 and int(steps.max() - steps.min()) > max(1.0, JITTER * float(np.median(steps))):
        note = (
            f"The time stamps are uneven ({_step_range(steps, time_base)}) and are taken as real times; if they are "
            f"not, {GIVE_FPS}."
        )
        axis = TimeAxis("time stamps", None, container_rate, (note,))
        return FrameTimes((ticks - ticks[0]) * float(time_base), axis)
    rate = container_rate
    if rate is None and n > 1:
        rate = Fraction(n - 1) / (int(ticks[-1] - ticks[0]) * time_base)
    if rate is None:
        return NoTimeAxis(f"the file contains no frame rate; {GIVE_FPS}")
    note = (
        f"The container's {rate_text(rate)} fps is a playback rate: high-speed footage is nearly always stored "
        f"slower than it was recorded, and every frequency scales with it; {GIVE_FPS}."
    )
    return FrameTimes(_regular(np.arange(n), rate), TimeAxis("container", rate, rate, (note,)))


def _camera_times(
    stamps: list[int | None],
    time_base: Fraction | None,
    header_rate: Fraction,
    container_rate: Fraction | None,
) -> FrameTimes:
    """Times from a camera's header, or from the camera's time of each frame where these carry more."""
    n = len(stamps)
    by_header = TimeAxis("camera header", header_rate, container_rate)
    regular = FrameTimes(_regular(np.arange(n), header_rate), by_header)
    if n < 2 or time_base is None or any(pts is None for pts in stamps):
        return regular
    ticks = np.array(stamps, dtype=np.int64)
    steps = np.diff(ticks)
    median = float(np.median(steps))
    broken = np.flatnonzero((steps <= 0) | (steps > LONGEST_GAP * median))
    if broken.size:
        note = (
            f"The camera's frame times jump at frame {int(broken[0]) + 1} and were not used: frames are assumed "
            f"equally spaced at the {rate_text(header_rate)} fps of its header."
        )
        return replace(regular, time_axis=replace(by_header, notes=(note,)))
    quantum = min(1.5 * CAMERA_TICK_S / float(time_base), 0.6 * median)
    if float(np.max(np.abs(steps - median))) > max(EVEN * median, quantum):
        note = f"The camera's frame times are uneven ({_step_range(steps, time_base)}) and are used directly."
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
    return FrameTimes(_regular(np.arange(n), rate), axis)


def rate_text(rate: Fraction) -> str:
    """A rate as text: whole numbers exactly, others to six digits."""
    return str(rate.numerator) if rate.denominator == 1 else f"{float(rate):.6g}"


def _seconds(ticks: int, time_base: Fraction) -> str:
    return f"{float(ticks * time_base):.6g}"


def _step_range(steps: IntArray, time_base: Fraction) -> str:
    return f"steps of {_seconds(int(steps.min()), time_base)} to {_seconds(int(steps.max()), time_base)} s"


def _regular(slots: IntArray, rate: Fraction) -> FloatArray:
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
    """Why the stamps cannot give a time axis, or None."""
    if time_base is None:
        return "the file has no time base"
    missing = sum(pts is None for pts in stamps)
    if missing:
        return f"{missing} of {len(stamps)} frames have no time stamp"
    steps = np.diff(np.array(stamps, dtype=np.int64))
    wrong = int(np.count_nonzero(steps <= 0))
    coarse = f"the time stamps' ticks of {_seconds(1, time_base)} s are too coarse for the frame rate"
    if wrong and steps.min() == 0 and steps.sum() < 2 * steps.size:
        return f"{coarse} ({wrong} of {steps.size} steps are zero)"
    if wrong:
        where = int(np.flatnonzero(steps <= 0)[0]) + 1
        return f"the time stamps do not increase ({wrong} of {steps.size} steps, first at frame {where})"
    if steps.size and time_base > Fraction(1, 100_000_000) and steps.mean() < 2 and steps.max() > 1:
        return coarse
    return None


def _frame_slots(stamps: list[int | None]) -> tuple[IntArray, tuple[str, ...]]:
    """Index of each frame in units of the frame interval: gaps of whole steps in the stamps count."""
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
        return plain, (
            "The file's time stamps are uneven; they are ignored because the recorded rate is given.",
        )
    absent = int(slots[-1]) + 1 - n
    if absent > ABSENT_PER_FRAME * n:
        return plain, ("The file's time stamps jump; they are ignored because the recorded rate is given.",)
    note = f"The time stamps show gaps of {absent} frames that are not in the file; times allow for them."
    return slots, (note,)

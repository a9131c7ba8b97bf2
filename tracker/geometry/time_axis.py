"""Time axis of a recording: from the user, the camera's header, the time stamps, or the container, with notes.

A rolling shutter is brought to one time; the exposure attenuates a vibration.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Literal

import numpy as np

from tracker.arrays import BoolArray, FloatArray, IntArray
from tracker.checks import Failure, checked
from tracker.columns import TUNING as COLUMNS
from tracker.geometry import stamps as ticking


@dataclass(frozen=True)
class Tuning:
    """Which times and rates are believed, and limits of the corrections for the shutter."""

    #: [ppm] largest standard deviation of a rate that can be given
    #: convention: a rate that is known to less than a tenth gives no frequency
    max_rate_sd_ppm: float = 100_000.0
    #: [1] a given rate is that of a part of the file where their rates differ by less than this share
    named: float = 0.02
    #: [1] without such a part, it is that of the part with at least this share of the frames
    main_part: float = 0.75
    #: [1] a step this many times the median means damaged time stamps, not frames that were not saved
    longest_gap: int = 1000
    #: [1] steps within this share of the median count as even
    #: convention: camera time stamps have a resolution of about 1 us
    even: float = 0.1
    #: [1] agreement of a camera's header with the frames' own times; beyond it these decide
    #: physics: quartz oscillators and rounded headers agree to this
    header_tolerance: float = 1e-4
    #: [s] resolution of a camera's time stamps
    #: physics: that of the formats that are read
    camera_tick_s: float = 1e-6
    #: [1] a file with more missing frames than this share has real time stamps
    few_gaps: float = 0.1
    #: [1] the container's rate is kept where the stamps agree with it to this
    #: convention: a mean over gaps differs by more
    same_rate: float = 1e-3
    #: [ticks] by which even steps may differ
    #: physics: two stamps are rounded
    camera_ticks: float = 1.5
    #: [1] share of the median step by which they may differ at most
    coarse: float = 0.6
    #: [1] product of frequency and exposure beyond which an amplitude is not corrected
    #: convention: the factor is 0.50 there and falls to zero at 1
    largest_product: float = 0.6


TUNING = Tuning()

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

GIVE_FPS = "give the recorded rate with --fps or [camera] fps"


@dataclass(frozen=True)
class TimeAxis:
    """Provenance of a recording's time axis.

    Attributes
    ----------
    source : str
        "user" (``--fps`` or ``experiment.toml``), "camera header", "time stamps" (uneven presentation times, used
        directly), "container" (the playback rate of the file: usually not the recorded rate of high-speed footage),
        "unknown" (times of a table).
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

    @property
    def known_fps(self) -> float | None:
        """Frames per second at which the scene was recorded; None where times are uneven or only a guess."""
        return None if self.fps_recorded is None or self.is_playback_guess else float(self.fps_recorded)


@dataclass(frozen=True)
class FrameTimes:
    """Time of each frame in s, 0 at the first, and its provenance.

    Where the rate changes inside the file, `used` is False for frames at another rate than that of most frames, or of
    those whose rate the user gave; None where all are used.
    """

    time_s: FloatArray
    time_axis: TimeAxis
    used: BoolArray | None = None


def rate_text(rate: Fraction) -> str:
    """A rate as text: whole numbers exactly, others to six digits."""
    return str(rate.numerator) if rate.denominator == 1 else f"{float(rate):.6g}"


def regular(slots: IntArray, rate: Fraction) -> FloatArray:
    """Times in s of frames at whole frame intervals."""
    # Multiplying before dividing keeps whole seconds exact.
    return np.asarray(slots, dtype=np.float64) * rate.denominator / rate.numerator


def given_rate(
    stamps: list[int | None], time_base: Fraction | None, container_rate: Fraction | None, fps: Fraction
) -> FrameTimes | Failure:
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
    jump = ticking.jump(steps, time_base)
    if jump is not None:
        return Failure(jump)
    segments = ticking.rate_segments(steps)
    if segments and time_base is not None:
        return _changing_rate(ticks, time_base, segments, fps, axis)
    return _with_gaps(ticks, time_base, counts, fps, plain)


def _with_gaps(
    ticks: IntArray, time_base: Fraction | None, counts: IntArray | None, fps: Fraction, plain: FrameTimes
) -> FrameTimes | Failure:
    """The evenly spaced times of `plain`, with gaps where the stamps show missing frames (`counts` if known)."""
    steps: IntArray = np.diff(ticks)
    if counts is None:
        found = ticking.whole_steps(steps)
        counts = None if found is None else found[0]
    if counts is not None:
        slots, note = _with_absent(counts)
        return _noted(replace(plain, time_s=regular(slots, fps)), note) if note else plain
    if ticking.evenly_spaced(ticks) or np.median(steps) < ticking.TUNING.least_ticks:
        note = "The file's time stamps are uneven; they are ignored because the recorded rate is given."
        return _noted(plain, note)
    spread = f"steps of {int(steps.min())} to {int(steps.max())} ticks"
    if time_base is not None:
        spread = ticking.step_range(steps, time_base)
    return Failure(
        f"the time stamps contradict the constant rate that is given: their {spread} are not whole multiples of one "
        "frame interval; leave out fps to use the time stamps as real times, or export the frames without them (FFV1 "
        "in AVI) if they are wrong"
    )


def _with_absent(counts: IntArray) -> tuple[IntArray, str]:
    """Places of the frames, from the frame intervals between them, and a note where frames are missing."""
    slots = np.concatenate([[0], np.cumsum(counts)])
    absent = int(slots[-1]) + 1 - slots.size
    note = f"The time stamps show gaps of {absent} frames that are not in the file; times allow for them."
    return slots, note if absent else ""


def _changing_rate(
    ticks: IntArray,
    time_base: Fraction,
    segments: tuple[ticking.RateSegment, ...],
    fps: Fraction,
    axis: TimeAxis,
) -> FrameTimes | Failure:
    """Times of a file whose rate changes, at the user's rate in the part that has it or that is most of the file."""
    seen = f"rate changes inside the file: {ticking.listed(segments, time_base)} by the time stamps"

    def off(segment: ticking.RateSegment) -> float:
        return abs(segment.step * float(time_base * fps) - 1.0)

    chosen = min(segments, key=off)
    if off(chosen) > TUNING.named:
        most = ticking.most_frames(segments)
        if sum(s.frames for s in most) < TUNING.main_part * ticks.size:
            return Failure(
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
    broken = np.flatnonzero((steps <= 0) | (steps > TUNING.longest_gap * median))
    if broken.size:
        note = (
            f"The camera's frame times jump at frame {int(broken[0]) + 1} and were not used: frames are assumed "
            f"equally spaced at the {rate_text(header_rate)} fps of its header."
        )
        return replace(by_header_rate, time_axis=replace(by_header, notes=(note,)))
    quantum = min(TUNING.camera_ticks * TUNING.camera_tick_s / float(time_base), TUNING.coarse * median)
    if float(np.max(np.abs(steps - median))) > max(TUNING.even * median, quantum):
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
    spread_s = float(int(steps.max() - steps.min()) * time_base) or TUNING.camera_tick_s
    tolerance = max(TUNING.header_tolerance, spread_s / float(length))
    if abs(float(length * rate / (n - 1)) - 1.0) > tolerance:
        rate = Fraction(n - 1) / length
        notes.append(
            f"The camera's frame times give {rate_text(rate)} fps, which is used: its header's "
            f"{rate_text(header_rate)} fps is a rounded setting."
        )
    axis = TimeAxis("camera header", rate.limit_denominator(10**6), container_rate, tuple(notes))
    return FrameTimes(regular(np.arange(n), rate), axis)


def resolve_time_axis(
    stamps: list[int | None],
    *,
    time_base: Fraction | None,
    container_rate: Fraction | None,
    header_rate: Fraction | None,
    user_fps: Fraction | None,
    rate_sd_ppm: float | None = None,
) -> FrameTimes | Failure:
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
    if isinstance(times, Failure):
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
) -> FrameTimes | Failure:
    if user_fps is not None:
        return given_rate(stamps, time_base, container_rate, user_fps)
    if header_rate is not None:
        return camera_times(stamps, time_base, header_rate, container_rate)
    return _file_times(stamps, time_base, container_rate)


def _file_times(
    stamps: list[int | None], time_base: Fraction | None, container_rate: Fraction | None
) -> FrameTimes | Failure:
    """Times from the time stamps where they carry more than a playback rate, else from the container's rate."""
    n = len(stamps)
    counts = None
    if time_base is not None and n > 1 and not any(pts is None for pts in stamps):
        whole = np.array(stamps, dtype=np.int64)
        counts = ticking.whole_frames(np.diff(whole), time_base, container_rate)
    trouble = None if counts is not None else ticking.problem(stamps, time_base)
    if trouble is not None or time_base is None:
        return Failure(f"{trouble}; {GIVE_FPS}")
    ticks = np.array(stamps, dtype=np.int64)
    steps = np.diff(ticks)
    gaps: tuple[str, ...] = ()
    slots = np.arange(n)
    if counts is not None or not ticking.is_regular(steps):
        jump = ticking.jump(steps, time_base)
        if jump is not None:
            return Failure(jump)
        segments = ticking.rate_segments(steps)
        found = (counts, 1.0) if counts is not None else ticking.whole_steps(steps, exact=True)
        if segments or found is None or np.mean(found[0] > 1) > TUNING.few_gaps:
            return _real_times(ticks, time_base, container_rate, segments, found)
        slots, gap = _with_absent(found[0])
        gaps = (gap,) if gap else ()
        container_rate = _known_rate(found[1] * float(time_base), container_rate)
    rate = container_rate
    if rate is None and n > 1:
        rate = Fraction(n - 1) / (int(ticks[-1] - ticks[0]) * time_base)
    if rate is None:
        return Failure(f"the file contains no frame rate; {GIVE_FPS}")
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
    if container_rate is not None and abs(float(container_rate) * interval_s - 1.0) < TUNING.same_rate:
        return container_rate
    return Fraction(1.0 / interval_s).limit_denominator(1001)


# Samples of the interpolating polynomial of degree 4, in steps from the shifted one.
_NODES = np.arange(-2.0, 3.0)


def row_delay_s(y_px: FloatArray, height_px: int, readout_s: float) -> FloatArray:
    """Delay of a row relative to the middle row; shape of `y_px`. Negative readout: from the bottom."""
    return readout_s * (y_px - 0.5 * (height_px - 1)) / max(height_px - 1, 1)


def to_common_time(
    time_s: FloatArray, values: FloatArray, sd: FloatArray, delay_s: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Values at `time_s` of k channels that were exposed `delay_s` later, and their sd; shapes (n,), (n, k), (k,).

    NaN where a required neighbour is missing: two on each side at even steps, one at uneven ones.

    Notes
    -----
    At even steps a polynomial of degree 4 through five samples is evaluated `delay_s` earlier; at uneven ones a line
    along the central difference. At a tenth of the sampling rate and a delay of half a step, the error of the
    polynomial is 0.12 % of the amplitude. A marker's row is assumed constant: its own motion across rows, which shifts
    its time by displacement times readout over height, is neglected.
    """
    if time_s.size < _NODES.size:
        return np.full(values.shape, np.nan), np.full(values.shape, np.nan)
    steps = np.diff(time_s)
    step = float(np.mean(steps))
    if float(np.max(np.abs(steps - step))) > COLUMNS.uneven * step:
        velocity = np.gradient(values, time_s, axis=0)
        return values - delay_s * velocity, sd * np.sqrt(1.0 + 0.5 * (delay_s / step) ** 2)
    weights = _lagrange(-delay_s / step)
    windows = np.lib.stride_tricks.sliding_window_view(values, _NODES.size, axis=0)
    moved = np.full(values.shape, np.nan)
    moved[2:-2] = np.einsum("nkj,kj->nk", windows, weights)
    return moved, sd * np.sqrt(np.sum(weights**2, axis=1))


def _lagrange(at: FloatArray) -> FloatArray:
    """Weights of the nodes' values at positions `at` of shape (k,), in steps; shape (k, 5)."""
    weights = np.ones((at.size, _NODES.size))
    for j, node in enumerate(_NODES):
        for other in _NODES[node != _NODES]:
            weights[:, j] *= (at - other) / (node - other)
    return weights


def exposure_attenuation(frequency_hz: float, exposure_s: float) -> float:
    """Observed over true amplitude of a sinusoid that each frame averages over its exposure.

    sin(pi f T) / (pi f T): 1 for zero exposure, 0 for a whole period, negative beyond.

    Raises
    ------
    ValueError
        If either is negative or not finite.

    Notes
    -----
    The mean of exp(i omega t) over T about the middle of the exposure. The registered position of a blurred marker is
    this mean, whether or not the template includes the blur, because the blur is symmetric about it. Biased where the
    motion within one exposure deviates strongly from a straight line and the blur is wider than the marker's details.
    """
    checked("frequency_hz", frequency_hz, at_least=0.0)
    checked("exposure_s", exposure_s, at_least=0.0)
    phase = math.pi * frequency_hz * exposure_s
    return math.sin(phase) / phase if phase > 0.0 else 1.0

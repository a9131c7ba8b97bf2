"""Time axis of a recording: times of its frames, the source of their rate, and notes for the user."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Literal

import numpy as np

from tracker.arrays import BoolArray, FloatArray, IntArray

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


@dataclass(frozen=True)
class NoTimeAxis:
    """No time axis can be determined: falsy, with the reason."""

    reason: str

    def __bool__(self) -> bool:
        return False


def rate_text(rate: Fraction) -> str:
    """A rate as text: whole numbers exactly, others to six digits."""
    return str(rate.numerator) if rate.denominator == 1 else f"{float(rate):.6g}"


def regular(slots: IntArray, rate: Fraction) -> FloatArray:
    """Times in s of frames at whole frame intervals."""
    # Multiplying before dividing keeps whole seconds exact.
    return np.asarray(slots, dtype=np.float64) * rate.denominator / rate.numerator

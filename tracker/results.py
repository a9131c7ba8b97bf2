"""The series that leave the tracker: marker positions, and displacements of channels.

Conventions: pixel centres at integers, x right, y down in pixels; in mm x right, y up. Time is 0 at the
first frame. Missing is NaN. Every position stands beside its standard deviation.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from fractions import Fraction
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tracker.arrays import FlagArray, FloatArray
from tracker.geometry.lens import Lens
from tracker.geometry.plane import PlaneMap
from tracker.geometry.view import Positions, seen_through

ClockSource = Literal["user", "camera header", "time stamps", "container", "unknown"]


@dataclass(frozen=True)
class Clock:
    """Where a recording's time axis came from.

    Attributes
    ----------
    source : str
        "user" (``--fps`` or ``experiment.toml``), "camera header", "time stamps" (uneven presentation
        times, used as they are), "container" (the playback rate of the file: usually not the recorded
        rate of high-speed footage).
    fps_recorded : Fraction or None
        Frames per second at which the scene was recorded; None when times are uneven.
    fps_container : Fraction or None
        The rate that the file claims.
    notes : tuple of str
        What the user must know about the time axis, each a full sentence.
    """

    source: ClockSource
    fps_recorded: Fraction | None
    fps_container: Fraction | None = None
    notes: tuple[str, ...] = ()

    @property
    def is_playback_guess(self) -> bool:
        """Whether the time axis rests on the container's rate alone."""
        return self.source == "container"


@dataclass(frozen=True)
class DecodeReport:
    """What the decoder met: frame counts, picture size and depth.

    ``frames_declared`` is 0 where the container does not say. ``frames_corrupt`` are kept as rows of NaN.
    """

    codec: str
    pixel_format: str
    width_px: int
    height_px: int
    bit_depth: int
    frames_declared: int
    frames_decoded: int
    frames_corrupt: int
    lossy: bool


@dataclass(frozen=True)
class Scale:
    """Millimetres per pixel in the plane of the beam, with its standard deviation.

    The scale's error is common to all samples: it is not part of ``sd_x_mm``.
    """

    mm_per_px: float
    sd_mm_per_px: float
    source: str


@dataclass(frozen=True)
class FrameStrip:
    """Small pictures of a few frames across a recording, for people to look at.

    Attributes
    ----------
    frame : int array, shape (k,)
        Index of each frame, increasing.
    images : uint8 array, shape (k, height, width)
    shrink : float
        Pixels of the recording in a pixel of `images`.
    """

    frame: NDArray[np.int64]
    images: NDArray[np.uint8]
    shrink: float


@dataclass(frozen=True)
class MarkerTracks:
    """Positions of all markers in all frames of one recording.

    Attributes
    ----------
    recording : str
        Name shown to people: the path relative to the folder that was given.
    markers : tuple of str, length m
        Names of the markers, in order along the beam where that is known.
    frame : int array, shape (n,)
        Index of each frame, every frame present.
    time_s : array, shape (n,)
        Time of each frame, 0 at the first.
    x_px, y_px, sd_x_px, sd_y_px : array, shape (n, m)
        Centre of each marker and its standard deviation; NaN where missing. Positions are as seen;
        nothing is subtracted.
    flags : uint32 array, shape (n, m)
        Bits of `tracker.flags`.
    positions_mm : array, shape (m,)
        Distance of each marker from the clamp along the beam; NaN where unknown.
    scale : Scale or None
        None when neither the user nor a marker of known size gives one.
    clock, decode :
        Provenance of the time axis and of the frames.
    reference : tuple of str
        Markers that do not move and are subtracted from the others' displacement.
    first_frame : uint8 array or None, shape (height, width)
        The first good frame, stretched to 8 bit, for people to look at.
    notes : tuple of str
        What the user must know, each a full sentence.
    strip : FrameStrip or None
        Small pictures of frames across the recording.
    lens : Lens or None
        Distortion that is taken out of positions in mm and of displacements; not out of `x_px` and `y_px`.
    plane : PlaneMap or None
        Map of an oblique view to mm in the plane of the beam; None where `scale` is the same everywhere.
    readout_s : float or None
        Time from the exposure of the first row to that of the last, for a rolling shutter.
    """

    recording: str
    markers: tuple[str, ...]
    frame: NDArray[np.int64]
    time_s: FloatArray
    x_px: FloatArray
    y_px: FloatArray
    sd_x_px: FloatArray
    sd_y_px: FloatArray
    flags: FlagArray
    positions_mm: FloatArray
    scale: Scale | None
    clock: Clock
    decode: DecodeReport
    reference: tuple[str, ...] = ()
    first_frame: NDArray[np.uint8] | None = None
    notes: tuple[str, ...] = ()
    strip: FrameStrip | None = None
    lens: Lens | None = None
    plane: PlaneMap | None = None
    readout_s: float | None = None

    def positions(self, unit: Literal["mm", "px"]) -> Positions:
        """Positions free of distortion, y up, and their sd without the common error of the scale; shapes (n, m).

        In px the picture stays as oblique as it is seen; in mm all are NaN without a scale.
        """
        seen = Positions(self.x_px, self.y_px, self.sd_x_px, self.sd_y_px)
        if unit == "px":
            return seen_through(seen, self.lens, None, 1.0)
        return seen_through(seen, self.lens, self.plane, self._mm_per_px)

    @property
    def x_mm(self) -> FloatArray:
        """Position to the right in mm, NaN without a scale; shape (n, m)."""
        return self.positions("mm").x

    @property
    def y_mm(self) -> FloatArray:
        """Position upwards in mm, NaN without a scale; shape (n, m)."""
        return self.positions("mm").y

    @property
    def sd_x_mm(self) -> FloatArray:
        """Standard deviation of `x_mm` without the common error of the scale."""
        return self.positions("mm").sd_x

    @property
    def sd_y_mm(self) -> FloatArray:
        """Standard deviation of `y_mm` without the common error of the scale."""
        return self.positions("mm").sd_y

    @property
    def _mm_per_px(self) -> float:
        return self.scale.mm_per_px if self.scale is not None else float("nan")


@dataclass(frozen=True)
class FailedTracking:
    """A recording that could not be tracked: falsy, with the reason.

    ``first_frame`` shows what was seen, when anything was; ``seen_px``, shape (c, 2), where candidates for markers
    were in it.
    """

    recording: str
    reason: str
    first_frame: NDArray[np.uint8] | None = None
    seen_px: FloatArray | None = None

    def __bool__(self) -> bool:
        return False


@dataclass(frozen=True)
class DisplacementSeries:
    """Displacements of k channels at n times: what `modal_id` identifies modes from.

    Attributes
    ----------
    name : str
        The recording or file it came from.
    time_s : array, shape (n,)
        Strictly increasing; steps may be uneven.
    channels : tuple of str, length k
    values : array, shape (n, k)
        Displacement, or any quantity proportional to the motion; NaN where missing.
    sd : array, shape (n, k)
        Standard deviation of each value; NaN where unknown.
    unit : str
        Of `values` and `sd`: "mm", "px", "m/s^2", ...
    positions_mm : array, shape (k,)
        Distance from the clamp along the beam; NaN where unknown.
    direction : tuple of float
        Unit vector of the displacement in the picture (x right, y up); (nan, nan) where it has none.
    base, base_sd : array, shape (n,), or None
        Motion of the reference markers, which was subtracted from the channels, and its standard deviation: a base's
        stop is the onset of the decay. None where nothing was subtracted.
    """

    name: str
    time_s: FloatArray
    channels: tuple[str, ...]
    values: FloatArray
    sd: FloatArray
    unit: str
    positions_mm: FloatArray
    direction: tuple[float, float] = (float("nan"), float("nan"))
    notes: tuple[str, ...] = field(default=())
    base: FloatArray | None = None
    base_sd: FloatArray | None = None

    def __post_init__(self) -> None:
        n, k = self.time_s.size, len(self.channels)
        shapes = {"values": self.values.shape, "sd": self.sd.shape}
        for name, shape in shapes.items():
            if shape != (n, k):
                msg = (
                    f"{name} must have shape ({n}, {k}), one row a time and one column a channel; got {shape}"
                )
                raise ValueError(msg)
        for name, column in (("base", self.base), ("base_sd", self.base_sd)):
            if column is not None and column.shape != (n,):
                msg = f"{name} must have shape ({n},), one value a time, got {column.shape}"
                raise ValueError(msg)
        if self.positions_mm.shape != (k,):
            msg = f"positions_mm must have shape ({k},), got {self.positions_mm.shape}"
            raise ValueError(msg)
        if not np.all(np.isfinite(self.time_s)) or np.any(np.diff(self.time_s) <= 0.0):
            msg = "time_s must be finite and strictly increasing"
            raise ValueError(msg)

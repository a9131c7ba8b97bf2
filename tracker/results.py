"""Results of the tracker: marker positions, and the displacement series derived from them.

Conventions: pixel centres at integers, x right, y down in pixels; in mm x right, y up. Time is 0 at the first frame.
Missing values are NaN. Every position has a standard deviation.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracker.arrays import FlagArray, FloatArray, IntArray
from tracker.checks import Failure
from tracker.columns import Column, data_frame, dataset, fields_of, signals_of, table_row
from tracker.flags import format_flags
from tracker.geometry import Lens, PlaneMap, Positions, Scale, TimeAxis, median_over_time, rectified
from tracker.position_errors import PositionErrors
from tracker.scale_change import ScaleChange

if TYPE_CHECKING:
    import pandas as pd
    import xarray


@dataclass(frozen=True)
class Tuning:
    """When a file is cut off."""

    #: [1] share of the declared frames below which missing ones are no alert
    #: statistics: they change no standard deviation by more than 1.5 times this share: that of a damping ratio grows
    #: with the length of the record to the power of -1.5
    worth_an_alert: float = 0.01
    #: [frames] and this many
    #: convention: containers miscount by one or two
    miscounted: float = 2.0


TUNING = Tuning()


class _Part(NamedTuple):
    """Some frames of the tracks: the table has a row for each of them and each marker."""

    tracks: MarkerTracks
    mm: Positions
    rows: slice
    flag_names: dict[int, str]

    def each_frame(self, values: NDArray[Any]) -> NDArray[Any]:
        return np.repeat(values[self.rows], len(self.tracks.markers))

    def each(self, values: NDArray[Any]) -> NDArray[Any]:
        return values[self.rows].ravel()

    def marker(self) -> NDArray[Any]:
        return np.tile(np.array(self.tracks.markers, dtype=object), self.tracks.frame[self.rows].size)

    def flags(self) -> list[str]:
        return [self.flag_names[int(value)] for value in self.each(self.tracks.flags)]


# Of `MarkerTracks.to_dataframe` and of the tracks file.
TRACK_COLUMNS = (
    Column("frame", "1", "number of the frame, from 0", lambda part: part.each_frame(part.tracks.frame)),
    Column("time_s", "s", "time of the frame", lambda part: part.each_frame(part.tracks.time_s)),
    Column("marker", "", "name of the marker", _Part.marker),
    Column("x_px", "px", "position, to the right", lambda part: part.each(part.tracks.x_px)),
    Column("y_px", "px", "position, downwards", lambda part: part.each(part.tracks.y_px)),
    Column("sd_x_px", "px", "standard deviation of x", lambda part: part.each(part.tracks.sd_x_px)),
    Column("sd_y_px", "px", "standard deviation of y", lambda part: part.each(part.tracks.sd_y_px)),
    Column("x_mm", "mm", "position, to the right", lambda part: part.each(part.mm.x)),
    Column("y_mm", "mm", "position, upwards", lambda part: part.each(part.mm.y)),
    Column("sd_x_mm", "mm", "standard deviation of x", lambda part: part.each(part.mm.sd_x)),
    Column("sd_y_mm", "mm", "standard deviation of y", lambda part: part.each(part.mm.sd_y)),
    Column("flags", "", "names of the flags, joined by a vertical bar", _Part.flags),
)
# Only where the errors of x and y are not independent.
CORRELATION_COLUMN = Column(
    "correlation_xy",
    "1",
    "only of a line, measured across it: +1 or -1, the errors of x and y are one",
    lambda part: part.each(part.tracks.correlation_xy),
)

# Predictive codecs whose decoder reports damage. Codecs that store the parts of a frame that change: damage stays.
_SHOW_DAMAGE = frozenset({"h264", "mpeg2video", "wmv2"})
_PARTS_OF_FRAMES = frozenset({"apng", "gif"})


@dataclass(frozen=True)
class DecodeReport:
    """Outcome of decoding; 0 frames are declared where the file does not state it, corrupt ones are rows of NaN.

    ``predictive`` codecs construct frames from others, and from later ones where frames are stored ``reordered``.
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
    predictive: bool = False
    reordered: bool = False

    @property
    def shows_damage(self) -> bool:
        """Whether a damaged frame is recognised, by its decoder or by its neighbours (see docs/bad_inputs.md)."""
        return self.codec in _SHOW_DAMAGE or not (self.predictive or self.codec in _PARTS_OF_FRAMES)

    def cut_off(self, frames_per_s: float | None) -> str:
        """Clause that says how much of the declared recording is in the file; empty where no more than 1 % is missing.

        With the times that these frames take where their rate is given.
        """
        declared, read = self.frames_declared, self.frames_decoded + self.frames_corrupt
        if declared - read <= max(TUNING.miscounted, TUNING.worth_an_alert * declared):
            return ""
        lasts = f", {read / frames_per_s:.3g} s of {declared / frames_per_s:.4g} s" if frames_per_s else ""
        return f"the file is cut off: {read} of the {declared} frames that it declares could be read{lasts}"


@dataclass(frozen=True)
class FrameStrip:
    """Thumbnails, shape (k, height, width), of the frames of these indices, each pixel `shrink` px of the recording."""

    frame: IntArray
    images: NDArray[np.uint8]
    shrink: float


class _Facts(ABC):
    """Display of a result by a few facts, as text and in notebooks."""

    @abstractmethod
    def _facts(self) -> dict[str, str]:
        """Names and values."""

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}({', '.join(f'{name}={value}' for name, value in self._facts().items())})"
        )

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<tr><th>{name}</th><td>{escape(text)}</td></tr>" for name, text in self._facts().items()
        )
        return f"<table><caption>{type(self).__name__}</caption>{rows}</table>"


@dataclass(frozen=True, repr=False)
class MarkerTracks(_Facts):
    """Positions of all markers in all frames of one recording.

    Attributes
    ----------
    recording : str
        Name shown in results: the path relative to the given folder.
    markers : tuple of str, length m
        Names of the markers, in order along the beam where that is known.
    frame, time_s : array, shape (n,)
        Index and time of each frame, every frame included; time is 0 at the first.
    x_px, y_px, sd_x_px, sd_y_px : array, shape (n, m)
        Centre of each marker in the image and its standard deviation; NaN where missing. Nothing is subtracted or
        corrected.
    flags : uint32 array, shape (n, m)
        Bits of `tracker.flags`.
    positions_mm : array, shape (m,)
        Distance of each marker from the clamp along the beam; NaN where unknown.
    scale : Scale or None
        None when neither the user nor a marker of known size gives one.
    reference : tuple of str
        Fixed markers, whose motion is subtracted from the displacement of the others.
    input : tuple of str
        Markers on the clamp, whose motion is the measured input of the others.
    first_frame : uint8 array or None, shape (height, width)
        The first good frame, stretched to 8 bit, for display.
    notes : tuple of str
        What the user must know, each a full sentence.
    lens : Lens or None
        Distortion that is corrected in positions in mm and in displacements, not in `x_px` and `y_px`.
    plane : PlaneMap or None
        Map of an oblique view to mm in the plane of the beam; None where `scale` is the same everywhere.
    readout_s : float or None
        Time from the exposure of the first row to that of the last, for a rolling shutter.
    kind : str
        Kind of the markers, a name in `tracker.markers.registry.MARKER_KINDS`; empty where it is not known.
    correlation_xy : array, shape (n, m), or None
        Correlation of the errors of `x_px` and `y_px`; +1 or -1 where only one component is measured. None where they
        are independent.
    ends_sd_mm : tuple of float or None
        Of a line, the standard deviations of its clamped end and its free end along the beam, between which
        `positions_mm` are.
    fixed_points_px : array, shape (2, m), or None
        Where the scale of the image changes, markers move like these points, x and y from their centres.
    """

    recording: str
    markers: tuple[str, ...]
    frame: IntArray
    time_s: FloatArray
    x_px: FloatArray
    y_px: FloatArray
    sd_x_px: FloatArray
    sd_y_px: FloatArray
    flags: FlagArray
    positions_mm: FloatArray
    scale: Scale | None
    time_axis: TimeAxis
    decode: DecodeReport
    reference: tuple[str, ...] = ()
    input: tuple[str, ...] = ()
    first_frame: NDArray[np.uint8] | None = None
    notes: tuple[str, ...] = ()
    strip: FrameStrip | None = None
    lens: Lens | None = None
    plane: PlaneMap | None = None
    readout_s: float | None = None
    kind: str = ""
    correlation_xy: FloatArray | None = None
    ends_sd_mm: tuple[float, float] | None = None
    fixed_points_px: FloatArray | None = None

    def positions(self, unit: Literal["mm", "px"]) -> Positions:
        """Positions corrected for lens distortion, y up, and their sd without the common error of the scale.

        All arrays have shape (n, m). In px an oblique view is not rectified; in mm all are NaN without a scale.
        """
        mm_per_px = 1.0 if unit == "px" else float("nan") if self.scale is None else self.scale.mm_per_px
        seen = Positions(self.x_px, self.y_px, self.sd_x_px, self.sd_y_px, self.correlation_xy)
        return rectified(seen, self.lens, None if unit == "px" else self.plane, mm_per_px)

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

    def to_dataframe(self) -> pd.DataFrame:
        """Long table, one row per frame and marker with the columns `TRACK_COLUMNS`; NaN where missing.

        ``flags`` holds the names of the flags joined by ``|``. A last column ``correlation_xy`` is added where the
        errors of x and y are not independent.
        """
        (table,) = self.tables(max(self.frame.size, 1))
        return table

    def tables(self, frames_each: int) -> Iterator[pd.DataFrame]:
        """The table of `to_dataframe` in parts of `frames_each` frames: whole, it takes several times the memory."""
        mm = self.positions("mm")
        text = {int(value): format_flags(int(value)) for value in np.unique(self.flags)}
        columns = TRACK_COLUMNS if self.correlation_xy is None else (*TRACK_COLUMNS, CORRELATION_COLUMN)
        for first in range(0, max(self.frame.size, 1), frames_each):
            part = _Part(self, mm, slice(first, first + frames_each), text)
            yield data_frame(table_row(columns, part), columns)

    def plot(self, ax: Any = None) -> Any:
        """Motion of each marker about its median, in x and y, over time; returns the matplotlib Axes."""
        unit: Literal["mm", "px"] = "px" if self.scale is None else "mm"
        seen = self.positions(unit)
        motion = {"x": seen.x - median_over_time(seen.x), "y": seen.y - median_over_time(seen.y)}
        lines = {f"{name} {c}": motion[c][:, k] for k, name in enumerate(self.markers) for c in motion}
        return _plot_lines(ax, self.time_s, lines, f"position about the median ({unit})")

    def _facts(self) -> dict[str, str]:
        found = np.isfinite(self.x_px)
        return {
            "recording": self.recording,
            "markers": str(len(self.markers)),
            "frames": str(self.frame.size),
            "duration": f"{self.time_s[-1]:.4g} s" if self.time_s.size else "0 s",
            "scale": "none" if self.scale is None else f"{self.scale.mm_per_px:.5g} mm/px",
            "found": f"{100.0 * found.mean():.1f} %" if found.size else "0 %",
        }


@dataclass(frozen=True)
class FailedTracking(Failure):
    """A recording that could not be tracked; `where` is its name.

    ``seen_px``, shape (c, 2), holds the positions of marker candidates in the first good frame, when there is one;
    ``proposed_px``, shape (k, 2), points of it with texture that moves, which could be followed as patches.
    """

    first_frame: NDArray[np.uint8] | None = None
    seen_px: FloatArray | None = None
    proposed_px: FloatArray | None = None


@dataclass(frozen=True, repr=False, eq=False)
class KnownInput:
    """Measured motion of the base, or force, that drives the channels of a series.

    Attributes
    ----------
    name : str
    values : array, shape (n,)
        At the times of the series; NaN where missing.
    unit : str
        A motion of the base has the quantity and unit of the channels.
    is_force : bool
        Whether it is a force on the structure instead of the motion of its base.
    sd : float
        Standard deviation of its noise; NaN where unknown.
    """

    name: str
    values: FloatArray
    unit: str
    is_force: bool = False
    sd: float = float("nan")


@dataclass(frozen=True, repr=False)
class DisplacementSeries(_Facts):
    """Displacements of k channels at n times: the input from which `modal_id` identifies modes.

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
        Unit of `values` and `sd`: "mm", "px", "m/s^2", ...
    positions_mm : array, shape (k,)
        Distance from the clamp along the beam; NaN where unknown.
    direction : tuple of float
        Unit vector of the displacement in the image (x right, y up); (nan, nan) where it has none.
    base, base_sd : array, shape (n,), or None
        Motion of the reference markers, which was subtracted from the channels, and its standard deviation: the decay
        begins when the base stops. None where nothing was subtracted.
    rate_sd_ppm : float
        Relative standard deviation of the rate of `time_s` in parts per million: an error common to all frequencies.
    position_errors : PositionErrors or None
        Errors of tracked positions that return with the motion; None for other sensors.
    scale_change : ScaleChange or None
        Change of the image's scale for which `values` are corrected; None where there is none.
    misleading : tuple of (str, str)
        Channels that must not be fitted although they have values, each with the reason.
    known_input : KnownInput or None
        What drives the channels, where it was measured: the modes are then those of the response to it.
    """

    name: str
    time_s: FloatArray
    channels: tuple[str, ...]
    values: FloatArray
    sd: FloatArray
    unit: str
    positions_mm: FloatArray
    direction: tuple[float, float] = (float("nan"), float("nan"))
    notes: tuple[str, ...] = ()
    base: FloatArray | None = None
    base_sd: FloatArray | None = None
    rate_sd_ppm: float = 0.0
    position_errors: PositionErrors | None = None
    scale_change: ScaleChange | None = None
    misleading: tuple[tuple[str, str], ...] = ()
    known_input: KnownInput | None = None

    def __post_init__(self) -> None:
        n, k = self.time_s.size, len(self.channels)
        if self.known_input is not None and self.known_input.values.shape != (n,):
            msg = (
                f"the input {self.known_input.name} must have one value at each of the {n} times of the channels, got "
                f"shape {self.known_input.values.shape}; bring both to the same clock and length first"
            )
            raise ValueError(msg)
        expected = {"values": (n, k), "sd": (n, k), "base": (n,), "base_sd": (n,), "positions_mm": (k,)}
        for name, shape in expected.items():
            array = getattr(self, name)
            if array is not None and array.shape != shape:
                msg = f"{name} must have shape {shape} for {n} times and {k} channels, got {array.shape}"
                raise ValueError(msg)
        if not np.all(np.isfinite(self.time_s)) or np.any(np.diff(self.time_s) <= 0.0):
            msg = "time_s must be finite and strictly increasing"
            raise ValueError(msg)

    @classmethod
    def from_sep005(cls, signals: Mapping[str, Any] | Sequence[Mapping[str, Any]]) -> DisplacementSeries:
        """Series of signals of SEP 005, the time series of SDyPy, one channel each; None and NaN are missing.

        A field ``sd`` is the standard deviation of ``data``. ValueError if a required field is absent, or signals
        differ in their unit or their times.
        """
        fields = fields_of(signals)
        return cls(name="series", positions_mm=np.full(len(fields["channels"]), np.nan), **fields)

    def to_sep005(self) -> list[dict[str, Any]]:
        """Signals of SEP 005, one for each channel, with ``time``; ``fs`` for even times, ``sd`` where it is known."""
        return signals_of(self.time_s, self.channels, self.values, self.sd, self.unit)

    def to_dataframe(self) -> pd.DataFrame:
        """Wide table of ``time_s``, ``<channel>_<unit>`` and ``sd_<channel>_<unit>``; NaN where missing."""
        columns: dict[str, FloatArray] = {"time_s": self.time_s}
        for k, channel in enumerate(self.channels):
            columns[f"{channel}_{self.unit}"] = self.values[:, k]
            columns[f"sd_{channel}_{self.unit}"] = self.sd[:, k]
        return data_frame(columns, {**dict.fromkeys(columns, self.unit), "time_s": "s"})

    def to_xarray(self) -> xarray.Dataset:
        """``series`` and ``sd`` over time and channel, with their units; ImportError without xarray."""
        dims, of_unit = ("time", "channel"), {"units": self.unit}
        places = {
            "time": ("time", self.time_s, {"units": "s"}),
            "channel": list(self.channels),
            "position": ("channel", self.positions_mm, {"units": "mm"}),
        }
        arrays = {"series": (dims, self.values, of_unit), "sd": (dims, self.sd, of_unit)}
        return dataset(arrays, places, {"recording": self.name})

    def plot(self, ax: Any = None) -> Any:
        """Displacement of each channel over time; returns the matplotlib Axes."""
        lines = {channel: self.values[:, k] for k, channel in enumerate(self.channels)}
        return _plot_lines(ax, self.time_s, lines, f"displacement ({self.unit})")

    def _facts(self) -> dict[str, str]:
        largest = np.nanmax(np.abs(self.values)) if np.isfinite(self.values).any() else np.nan
        return {
            "name": self.name,
            "channels": str(len(self.channels)),
            "samples": str(self.time_s.size),
            "duration": f"{np.ptp(self.time_s):.4g} s" if self.time_s.size else "0 s",
            "largest": f"{largest:.4g} {self.unit}",
        }


def _plot_lines(ax: Any, time_s: FloatArray, lines: dict[str, FloatArray], label: str) -> Any:
    if ax is None:
        from matplotlib import pyplot as plt  # noqa: PLC0415 - slow to load, and only plots need it

        ax = plt.figure().add_subplot()
    for name, values in lines.items():
        ax.plot(time_s, values, label=name, linewidth=0.8)
    ax.set(xlabel="time (s)", ylabel=label)
    ax.legend(fontsize="small")
    return ax

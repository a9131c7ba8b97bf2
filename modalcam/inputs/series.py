"""Series from a table, that of the tracker or any with ``time_s`` and channels, and from a universal file (UFF)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from modal_id.response import at_other_times
from modalcam.common import InputError, readable_bytes, shown
from modalcam.config import ExperimentConfig, RecordingConfig
from modalcam.inputs.stated import unit_in_names
from modalcam.inputs.table import MAX_BYTES, Table, read_table
from modalcam.inputs.table_readers import UFF_ENDINGS
from modalcam.pipeline import Limits, RecordingResult, TaskFailure, worker_pool
from tracker import (
    LOSSY,
    TRACK_COLUMNS,
    DecodeReport,
    DisplacementSeries,
    Failure,
    FloatArray,
    KnownInput,
    MarkerTracks,
    Scale,
    TimeAxis,
    parse_flags,
)


@dataclass(frozen=True)
class Tuning:
    """Which numbers of a table are taken."""

    #: [samples] a shorter series is refused
    #: convention: More than the six unknowns of one mode with offset and drift.
    least_samples: int = 8
    #: [1] a ratio of mm to px that varies by a larger share is more than a scale
    #: convention: Files hold about nine digits.
    proportional: float = 1e-5
    #: [1] a smaller largest value is refused
    #: physics: Its square cannot be represented.
    smallest: float = 1e-100
    #: [1] a larger value is refused
    #: physics: Products of squares cannot be represented.
    largest: float = 1e100
    #: [s] a shorter series is refused
    #: physics: A few samples of a clock of picoseconds.
    shortest: float = 1e-12
    #: [s] a longer series is refused
    #: physics: 30 000 years.
    longest: float = 1e12


TUNING = Tuning()
_CLOCK_NOTE = (
    "The times are those of the tracks file, whose time axis has no record of its source: if the footage was tracked "
    "without its recorded rate, every frequency is wrong by the same factor."
)


def is_tracks(table: Table) -> bool:
    """Whether the table was written by the tracker."""
    return {column.name for column in TRACK_COLUMNS} <= set(table.columns.columns)


def series_from_table(
    read: Table, *, name: str, unit: str, positions_mm: tuple[float, ...] | None = None
) -> DisplacementSeries:
    """Channels of a plain table: every numeric column but ``time_s``; empty cells are missing samples.

    A column ``sd_<channel>`` is the standard deviation of ``<channel>``. Rows without a time are omitted; the times may
    be unevenly spaced. InputError if there is no channel, a column is not numeric, times do not increase, positions and
    channels differ in number, or a standard deviation is not positive.
    """
    table = read.columns
    sd_names = {c for c in table.columns if c.startswith("sd_") and c[3:] in table.columns}
    channels = [c for c in table.columns if c != "time_s" and c not in sd_names]
    if not channels:
        msg = f"{name}: expected at least one channel column in addition to time_s, found none"
        raise InputError(msg)
    positions = channel_positions(positions_mm, len(channels), f"{name}: {len(channels)} channels")
    rows, count = table.shape
    where = name
    if count > rows:
        where += f" ({rows} rows, {count} columns; transposed? Write a row for each time and a column for each channel)"
    time_s = _numbers(table, "time_s", where)
    keep = np.isfinite(time_s)
    time_s = time_s[keep]
    values = np.column_stack([_numbers(table, c, where)[keep] for c in channels])
    unknown = np.full(time_s.size, np.nan)
    sd = np.column_stack(
        [_numbers(table, f"sd_{c}", where)[keep] if f"sd_{c}" in sd_names else unknown for c in channels]
    )
    if np.any(sd <= 0.0):
        msg = f"{where}: standard deviations must be positive, found {np.nanmin(sd):g}; leave unknown ones empty"
        raise InputError(msg)
    check_time(time_s, where)
    check_size(values, where)
    notes = list(read.notes)
    if not keep.all():
        notes.append(f"{np.count_nonzero(~keep)} rows without a time were omitted.")
    return DisplacementSeries(
        name=name,
        time_s=time_s,
        channels=tuple(channels),
        values=np.where(np.isfinite(values), values, np.nan),
        sd=sd,
        unit=unit,
        positions_mm=positions,
        notes=tuple(notes),
    )


def with_known_input(motion: dict[str, Any], channel: str, unit: str | None) -> dict[str, Any]:
    """The motion of a file with one of its channels as the input that drives the others; InputError if it has none.

    Its noise is the median of its stated standard deviations, unknown where none is stated.
    """
    series = motion.get("series")
    if series is None:
        msg = "--input takes a channel of a series; of tracks, write the displacements of markers and base to a table"
        raise InputError(msg)
    if channel not in series.channels or len(series.channels) < 2:
        found = ", ".join(series.channels)
        msg = f"{series.name}: --input {shown(channel)}: expected one of at least two channels, found {shown(found)}"
        raise InputError(msg)
    at = series.channels.index(channel)
    others = np.arange(len(series.channels)) != at
    names = tuple(name for name in series.channels if name != channel)
    of_outputs = unit_in_names(names) or series.unit
    own = unit or unit_in_names([channel]) or of_outputs
    return {
        "series": replace(
            series,
            channels=names,
            unit=of_outputs,
            values=series.values[:, others],
            sd=series.sd[:, others],
            positions_mm=series.positions_mm[others],
            known_input=_known_input(series, at, series.values[:, at], own, of_outputs),
        )
    }


def _known_input(
    read: DisplacementSeries, at: int, values: NDArray[np.float64], unit: str, of_outputs: str
) -> KnownInput:
    """The channel at this index, with these values, as input."""
    sd = read.sd[np.isfinite(read.sd[:, at]), at]
    noise = float(np.median(sd)) if sd.size else float("nan")
    return KnownInput(read.channels[at], values, unit, is_force=unit != of_outputs, sd=noise)


def with_input_file(
    series: DisplacementSeries, path: Path, column: str | None, unit: str
) -> DisplacementSeries:
    """The series with a column of another file as its input, low-passed to the times of the series.

    InputError if the file cannot be read, has no such column, or was recorded at a lower rate; or if the series has an
    input already.
    """
    if series.known_input is not None:
        other = f"the input is {series.known_input.name} already"
        msg = f"{series.name}: {other}, and input_file names another: give one of the two"
        raise InputError(msg)
    where = shown(path.name)
    read = series_from_table(read_table(path), name=where, unit=unit)
    if (column is None and len(read.channels) > 1) or (column is not None and column not in read.channels):
        expected = "one column beside the times" if column is None else f"the column {shown(column)}"
        msg = (
            f"{where}: expected {expected}, found {shown(', '.join(read.channels))}: name it by input_column"
        )
        raise InputError(msg)
    at = read.channels.index(column) if column is not None else 0
    values = at_other_times(read.time_s, read.values[:, at], series.time_s)
    if isinstance(values, Failure):
        msg = f"{where}: {values}"
        raise InputError(msg)
    known = _known_input(read, at, values, unit, series.unit)
    rates = np.median(np.diff(read.time_s)) / np.median(np.diff(series.time_s))
    note = f"The input {shown(known.name)} is that of {where}, low-passed to the rate of the channels."
    notes = (*series.notes, note, *read.notes)
    return replace(series, known_input=replace(known, sd=known.sd * float(np.sqrt(rates))), notes=notes)


def with_recorded_input(config: ExperimentConfig, recording: RecordingResult) -> RecordingResult:
    """The recording with the input of its `input_file`, or why it cannot be used."""
    given = config.for_recording(recording.file)
    if given.input_file is None or recording.series is None or recording.path is None:
        return recording
    try:
        path = recording.path.parent / given.input_file
        series = with_input_file(recording.series, path, given.input_column, given.input_unit)
    except InputError as error:
        return replace(recording, identification=Failure(str(error), recording.name))
    return replace(recording, series=series)


def channel_positions(positions_mm: tuple[float, ...] | None, count: int, found: str) -> NDArray[np.float64]:
    """Positions as configured, NaN where none are given; an error begins with what was `found`."""
    if positions_mm is None:
        return np.full(count, np.nan)
    if len(positions_mm) != count:
        msg = f"{found} but {len(positions_mm)} markers.positions_mm"
        raise InputError(msg)
    return np.array(positions_mm)


def tracks_from_table(
    read: Table, *, name: str, positions_mm: tuple[float, ...] | None, reference: tuple[str, ...]
) -> MarkerTracks:
    """Marker tracks from a tracks file, which does not record how the frames were decoded.

    InputError if rows are missing or duplicated: every marker must have one row in every frame.
    """
    table = read.columns
    if not len(table):
        msg = f"{name}: expected at least {TUNING.least_samples} frames, found none"
        raise InputError(msg)
    markers = tuple(str(marker) for marker in pd.unique(table["marker"]))
    n, m = len(table) // max(len(markers), 1), len(markers)
    frame = _numbers(table, "frame", name)
    if not np.all((frame >= 0.0) & (frame < 2.0**53) & (frame == np.floor(frame))):
        msg = f"{name}: column frame: expected the numbers of frames, found others"
        raise InputError(msg)
    in_order = len(table) == n * m and np.array_equal(
        table["marker"].to_numpy().astype(str), np.tile(np.array(markers), n)
    )
    if not in_order or np.any(frame.reshape(n, m) != frame.reshape(n, m)[:, :1]):
        msg = f"{name}: expected one row per frame and marker, in the order the tracker writes them"
        raise InputError(msg)
    positions = channel_positions(positions_mm, m, f"{name}: {m} markers")

    def grid(column: str) -> NDArray[np.float64]:
        return _numbers(table, column, name).reshape(n, m)

    time_s = grid("time_s")[:, 0]
    check_time(time_s, name)
    ratio = grid("x_mm") / grid("x_px")
    known = ratio[np.isfinite(ratio)]
    scale = Scale(float(np.median(known)), float("nan"), "tracks file") if known.size else None
    columns = {c: grid(c) for c in ("x_px", "y_px", "sd_x_px", "sd_y_px")}
    if known.size and float(np.ptp(known)) > TUNING.proportional * abs(float(np.median(known))):
        # A lens or an oblique view was corrected: the mm of the file are kept, as pixels of a millimetre, y down.
        scale = Scale(1.0, float("nan"), "tracks file, rectified")
        columns = {c: grid(c.replace("px", "mm")) for c in columns}
        columns["y_px"] = -columns["y_px"]
    # Without any flag, the column is read as numbers.
    text = table["flags"].astype(object).fillna("").astype(str)
    check_size(np.stack(list(columns.values())), name)
    try:
        values = {flags: parse_flags(flags) for flags in pd.unique(text)}
    except ValueError as error:
        msg = f"{name}: column flags: {shown(str(error))}"
        raise InputError(msg) from error
    # The file does not say which codec: the wider error of those that predict frames from others.
    lossy = any(value & LOSSY.value for value in values.values())
    return MarkerTracks(
        recording=name,
        markers=markers,
        frame=frame.reshape(n, m)[:, 0].astype(np.int64),
        time_s=time_s,
        x_px=columns["x_px"],
        y_px=columns["y_px"],
        sd_x_px=columns["sd_x_px"],
        sd_y_px=columns["sd_y_px"],
        flags=text.map(values).to_numpy().astype(np.uint32).reshape(n, m),
        positions_mm=positions,
        scale=scale,
        time_axis=TimeAxis("unknown", None, None, (_CLOCK_NOTE,)),
        decode=DecodeReport("", "", 0, 0, 0, 0, n, 0, lossy=lossy, predictive=lossy),
        reference=reference,
        correlation_xy=grid("correlation_xy") if "correlation_xy" in table.columns else None,
    )


def check_size(values: NDArray[np.float64], name: str) -> None:
    """InputError for values so large or small that a computation with them overflows; NaN and 0 pass."""
    largest = float(np.max(np.abs(values), where=np.isfinite(values), initial=0.0))
    if largest and not TUNING.smallest < largest < TUNING.largest:
        limits = f"{TUNING.smallest:g} and {TUNING.largest:g}"
        msg = f"{name}: expected values between {limits} in size, found {largest:g}; change the unit"
        raise InputError(msg)


def _numbers(table: pd.DataFrame, column: str, name: str) -> NDArray[np.float64]:
    try:
        return np.asarray(pd.to_numeric(table[column]), dtype=np.float64)
    except (ValueError, TypeError) as error:
        msg = f"{name}: column {shown(str(column))} is not numeric ({error}); write decimals with a point"
        raise InputError(msg) from error


def check_time(time_s: NDArray[np.float64], name: str) -> None:
    """InputError for too few samples, and for times that do not increase or are not in seconds."""
    if time_s.size < TUNING.least_samples:
        msg = f"{name}: expected at least {TUNING.least_samples} samples, found {time_s.size}"
        raise InputError(msg)
    steps = np.diff(time_s)
    if np.any(steps <= 0.0):
        row = int(np.flatnonzero(steps <= 0.0)[0]) + 1
        msg = (
            f"{name}: time_s must increase; at row {row + 1} it goes from "
            f"{time_s[row - 1]:.9g} to {time_s[row]:.9g} s"
        )
        raise InputError(msg)
    span_s = float(time_s[-1] - time_s[0])
    if not TUNING.shortest <= span_s <= TUNING.longest:
        msg = f"{name}: expected time_s in seconds, found a record of {span_s:.3g} s; change the unit of the times"
        raise InputError(msg)


_TIME_RESPONSE, _UNKNOWN_FUNCTION = 1, 0
_TIME_AXIS = 17
_KINDS = {8: "displacement", 11: "velocity", 12: "acceleration"}


def read_uff(
    path: Path, *, name: str, unit: str, positions_mm: tuple[float, ...] | None = None
) -> DisplacementSeries:
    """Time responses (dataset 58) of a universal file as one series, in `unit` if the file names none.

    A channel is named after its entity or node; it is NaN at times at which it has no sample. InputError if the file
    cannot be read, holds no time response, or its responses differ in unit or kind.
    """
    where = shown(str(path))
    responses = [one for one in _datasets(path) if _is_time_response(one)]
    if not responses:
        msg = f"{where}: expected a time response (dataset 58, function type 1), found none"
        raise InputError(msg)
    units = {_unit(one, unit) for one in responses}
    kinds = {int(one.get("ordinate_spec_data_type", 0)) for one in responses}
    if len(units) > 1 or len(kinds) > 1:
        found = ", ".join(sorted(units)) + "; " + ", ".join(sorted(_KINDS.get(k, f"type {k}") for k in kinds))
        msg = f"{where}: expected time responses of one unit and kind, found {found}; split the file"
        raise InputError(msg)
    positions = channel_positions(positions_mm, len(responses), f"{where}: {len(responses)} time responses")
    time_s, values = _joined([_samples(one, where) for one in responses], where)
    check_time(time_s, where)
    check_size(values, where)
    kind = _KINDS.get(kinds.pop(), "an unknown quantity")
    return DisplacementSeries(
        name=name,
        time_s=time_s,
        channels=_names(responses),
        values=values,
        sd=np.full(values.shape, np.nan),
        unit=units.pop(),
        positions_mm=positions,
        notes=(f"{len(responses)} time responses of {kind} were read from a universal file.",),
    )


def _datasets(path: Path) -> list[dict[str, Any]]:
    where = shown(str(path))
    try:
        import pyuff  # noqa: PLC0415 - optional
    except ImportError:
        msg = f"{where}: reading a universal file needs pyuff; install it with pip install pyuff"
        raise InputError(msg) from None
    readable_bytes(path, MAX_BYTES)
    try:
        file = pyuff.UFF(str(path))
        kinds = [int(kind) for kind in file.get_set_types()]
        return [dict(file.read_sets(index)) for index, kind in enumerate(kinds) if kind == 58]
    except Exception as error:
        msg = f"{where}: expected a universal file (UFF), found: {error}"
        raise InputError(msg) from error


def _is_time_response(dataset: dict[str, Any]) -> bool:
    kind = int(dataset.get("func_type", -1))
    on_time = int(dataset.get("abscissa_spec_data_type", 0)) == _TIME_AXIS
    return (kind == _TIME_RESPONSE or (kind == _UNKNOWN_FUNCTION and on_time)) and not np.iscomplexobj(
        dataset["data"]
    )


def _unit(dataset: dict[str, Any], otherwise: str) -> str:
    label = str(dataset.get("ordinate_axis_units_lab", "")).strip()
    return otherwise if label in ("", "NONE", "none") else label


def _names(responses: list[dict[str, Any]]) -> tuple[str, ...]:
    names: list[str] = []
    for one in responses:
        entity = str(one.get("rsp_ent_name", "")).strip()
        node, direction = int(one.get("rsp_node", 0)), int(one.get("rsp_dir", 0))
        name = entity if entity not in ("", "NONE") else f"node{node}"
        if name in names:
            name = f"{name}_{node}_{direction}"
        names.append(name if name not in names else f"{name}_{len(names) + 1}")
    return tuple(names)


def _samples(dataset: dict[str, Any], where: str) -> tuple[FloatArray, FloatArray]:
    time_s, values = np.asarray(dataset["x"], dtype=float), np.asarray(dataset["data"], dtype=float)
    if time_s.shape != values.shape or time_s.size < TUNING.least_samples:
        msg = f"{where}: expected at least {TUNING.least_samples} samples a channel, found {values.size}"
        raise InputError(msg)
    if not np.all(np.isfinite(time_s)) or np.any(np.diff(time_s) <= 0.0):
        msg = f"{where}: expected times that increase, found a time response whose times do not"
        raise InputError(msg)
    return time_s, values


def _joined(samples: list[tuple[FloatArray, FloatArray]], where: str) -> tuple[FloatArray, FloatArray]:
    """All channels on the union of their times; times closer than a thousandth of a step are merged."""
    step = min(float(np.min(np.diff(time_s))) for time_s, _ in samples)
    every = np.sort(np.concatenate([time_s for time_s, _ in samples]))
    first = np.concatenate([[True], np.diff(every) > 1e-3 * step])
    time_s = every[first]
    values = np.full((time_s.size, len(samples)), np.nan)
    for k, (own, y) in enumerate(samples):
        rows = np.searchsorted(time_s, own + 5e-4 * step, side="right") - 1
        if np.unique(rows).size != own.size:
            msg = f"{where}: the channels' times interleave more finely than a thousandth of their step"
            raise InputError(msg)
        values[rows, k] = y
    return time_s, values


# MATLAB and HDF5; a small workbook may hold any number of cells.
_FRAGILE = (".mat", ".h5", ".hdf5", ".nc", ".xlsx")


def motion_of(
    path: Path, name: str, given: RecordingConfig, limits: Limits, *, unit: str, rate_hz: float | None
) -> dict[str, Any]:
    """Series or tracks of a file, as the field of a `RecordingResult`; the table that they are made from is not kept.

    `unit` is that of channels that do not state it, `rate_hz` the samples per second of a table without times.
    """
    positions_mm = given.positions_mm
    motion: dict[str, Any] = {}
    if path.suffix.lower() in UFF_ENDINGS:
        if rate_hz is not None:
            msg = f"{shown(str(path))}: a universal file holds its times; --rate is for tables without times"
            raise InputError(msg)
        motion["series"] = read_uff(path, name=name, unit=unit, positions_mm=positions_mm)
    elif is_tracks(table := _table(path, rate_hz, limits)):
        reference = given.reference or ()
        tracks = tracks_from_table(table, name=name, positions_mm=positions_mm, reference=reference)
        motion["tracks"] = replace(tracks, input=given.input or ())
    else:
        motion["series"] = series_from_table(
            _told(table, unit), name=name, unit=table.unit or unit, positions_mm=positions_mm
        )
    return _with_rate_sd(given.fps_tolerance_ppm or 0.0, motion)


def _told(table: Table, unit: str) -> Table:
    """The table with a note where it states another unit than the one given, "1" where none is."""
    if table.unit in ("", unit) or unit == "1":
        return table
    note = f"The channels state {table.unit} as their unit; --unit {unit} was not used."
    return replace(table, notes=(*table.notes, note))


def _table(path: Path, rate_hz: float | None, limits: Limits) -> Table:
    """Columns of a file; those of which a damaged one ends its reader, in another process."""
    if path.suffix.lower() not in _FRAGILE:
        return read_table(path, rate_hz)
    with worker_pool(1, limits) as pool:
        (found,) = pool.map(partial(read_table, rate_hz=rate_hz), [path])
    if isinstance(found, TaskFailure):
        msg = f"{shown(str(path))}: {found.reason}"
        raise InputError(msg)
    return found


def _with_rate_sd(ppm: float, motion: dict[str, Any]) -> dict[str, Any]:
    """The motion with the relative standard deviation of its rate; a table has no source of a rate to take it from."""
    if "tracks" in motion:
        axis = replace(motion["tracks"].time_axis, rate_sd_ppm=ppm)
        return {"tracks": replace(motion["tracks"], time_axis=axis)}
    return {"series": replace(motion["series"], rate_sd_ppm=ppm)}

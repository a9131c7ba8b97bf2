"""Motion from a table, an array or a universal file instead of a recording."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from modalcam.common import InputError, shown
from modalcam.config import RecordingConfig
from modalcam.inputs.series import is_tracks, read_uff, series_from_table, tracks_from_table
from modalcam.inputs.table import Table, read_table
from modalcam.inputs.table_readers import UFF_ENDINGS
from modalcam.pipeline import Limits, TaskFailure, worker_pool

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

"""Tables of channels over time, from the files that recorders and other programs write."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd

from modalcam.common import InputError, readable_bytes, shown
from modalcam.inputs.array_files import TUNING as TIME_AXIS
from modalcam.inputs.array_files import samples_by_channels
from modalcam.inputs.stated import unit_in_names
from modalcam.inputs.table_readers import TABLE_READERS, UFF_ENDINGS
from modalcam.inputs.text_table import read_text
from tracker.video import recording_suffixes

MAX_BYTES = 2_000_000_000
TIME = "time_s"
_SECONDS = {"": 1.0, "s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9}
_SECONDS |= {"\u03bcs": 1e-6, "min": 60.0}
# As NetCDF writes them.
_SECONDS |= {"milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9, "minutes": 60.0}
_TIME_NAMES = {"time", "t", "x_value", "elapsed time", "zeit", "temps", "tiempo", "tempo"}
_COUNTER_NAMES = {"frame", "frames", "frame number", "sample", "index"}
# A name with its unit: Time (s), Time [ms], t/s, time_ms.
_WITH_UNIT = re.compile(r"^(?P<name>.*?)\s*(?:\[(?P<a>[^\]]*)\]|\((?P<b>[^)]*)\)|[/_](?P<c>[^/_]*))$")


@dataclass(frozen=True)
class Table:
    """Columns of a file, one of them ``time_s``; sentences on what was taken for what, if the file left it open.

    `unit` is that of all channels, empty where the file states none.
    """

    columns: pd.DataFrame
    notes: tuple[str, ...] = ()
    unit: str = ""


def read_table(path: Path, rate_hz: float | None = None) -> Table:
    """Columns of a text table (CSV, TSV, ...) or of a file of one of the formats in `TABLE_READERS`.

    A plugin adds others by `register_table_reader`.

    Parameters
    ----------
    rate_hz : float or None
        Samples per second of a file without times.

    Returns
    -------
    Table
        Times in seconds. In a file that names no column ``time_s``, the column called time (in any unit of time) holds
        them, or a first column without a name that always increases.

    Raises
    ------
    InputError
        The file cannot be read as its ending says, or has no times and no rate is given, or has times and a rate.
    """
    readable_bytes(path, MAX_BYTES)
    where, suffix = shown(str(path)), path.suffix.lower()
    if suffix in set(recording_suffixes()) - set(TABLE_READERS):
        msg = f"{where}: expected a series of samples, found a recording: give it to modalcam run"
        raise InputError(msg)
    try:
        columns, notes = TABLE_READERS.get(suffix, read_text)(path)
        table = _with_times(*_upright(columns, notes), rate_hz, where)
        unit = str(columns.attrs.get("unit", "")) or unit_in_names(map(str, table.columns.columns[1:]))
        return replace(table, unit=unit)
    except OSError as error:
        msg = f"{where}: cannot be read ({error.strerror or error})"
        raise InputError(msg) from error
    except UnicodeDecodeError as error:
        msg = (
            f"{where}: expected text in UTF-8, or a file ending in one of {', '.join((*TABLE_READERS, *UFF_ENDINGS))}; "
            "found other bytes. Export the series as CSV in UTF-8, or register a reader (register_table_reader)"
        )
        raise InputError(msg) from error
    except (ValueError, pd.errors.ParserError) as error:
        msg = f"{where}: expected a table of numbers with a header row, found: {error}"
        raise InputError(msg) from error


def _upright(columns: pd.DataFrame, notes: list[str]) -> tuple[pd.DataFrame, list[str]]:
    """A table without names whose rows are longer than its columns, with time along its columns."""
    rows, count = columns.shape
    known = any(note.endswith("axis is time.") for note in notes)
    if known or count <= rows or list(columns.columns) != _numbered_columns(count):
        return columns, notes
    numbers = columns.apply(pd.to_numeric, errors="coerce").to_numpy(dtype=np.float64)
    turned, taken = samples_by_channels(numbers)
    notes = [*notes, f"The table has {rows} rows and {count} columns: {taken}"]
    return pd.DataFrame(turned, columns=_numbered_columns(turned.shape[1])), notes


def _numbered_columns(count: int) -> list[str]:
    return [f"column {k + 1}" for k in range(count)]


def _with_times(columns: pd.DataFrame, notes: list[str], rate_hz: float | None, where: str) -> Table:
    """Table with the column ``time_s`` first, from whatever holds the times."""
    if TIME in columns.columns:
        chosen, seconds = TIME, 1.0
    else:
        chosen, seconds = _time_column(columns, where)
    if chosen and rate_hz is not None:
        msg = f"{where}: column {shown(chosen)} holds the times; --rate is for tables without times"
        raise InputError(msg)
    if not chosen and rate_hz is None:
        found = ", ".join(shown(str(name)) for name in columns.columns[:8])
        orientation = "".join(f" ({note.rstrip('.')})" for note in notes if note.endswith("axis is time."))
        msg = (
            f"{where}: expected a column time_s (seconds), found columns {found}; give --rate if it has no times"
            f"{orientation}"
        )
        raise InputError(msg)
    if chosen == TIME:
        return Table(columns, tuple(notes))
    counter = next((name for name in columns.columns if str(name).strip().lower() in _COUNTER_NAMES), None)
    if chosen:
        times = pd.to_numeric(columns[chosen]) * seconds
        named = shown(chosen) if chosen.startswith("column ") else f"column {shown(chosen)}"
        source = f"{named} holds the times in {'s' if seconds == 1.0 else f'{seconds:g} s'}"
    elif counter is not None:
        times, chosen = pd.to_numeric(columns[counter]) / float(rate_hz or 1.0), str(counter)
        source = f"column {shown(chosen)} counts samples at {rate_hz:g} per second"
    else:
        times = pd.Series(np.arange(len(columns)) / float(rate_hz or 1.0))
        source = f"times are those of {rate_hz:g} samples per second"
    channels = columns.drop(columns=[chosen] if chosen else [])
    listed = ", ".join(shown(str(name)) for name in channels.columns[:8])
    more = " and others" if channels.shape[1] > 8 else ""
    notes = [*notes, f"The file names no {TIME}: {source}; channels are {listed}{more}."]
    return Table(pd.concat([times.rename(TIME), channels], axis=1), tuple(notes))


def _time_column(columns: pd.DataFrame, where: str) -> tuple[str, float]:
    """Name of the column of times, and its unit in seconds; empty if there is none."""
    found = [(str(name), seconds) for name in columns.columns if (seconds := _seconds(str(name)))]
    if len(found) > 1:
        msg = f"{where}: expected one column of times, found {', '.join(shown(name) for name, _ in found)}"
        raise InputError(msg)
    if found:
        return found[0]
    first = str(columns.columns[0])
    # Columns of an array without names are numbered after its variable.
    return (first, 1.0) if first.endswith(" 1") and _increases(columns[first]) else ("", 1.0)


def _seconds(name: str) -> float:
    """Unit, in seconds, of a column called time; 0 for any other column."""
    text = name.strip().lower()
    if text in _TIME_NAMES:
        return 1.0
    match = _WITH_UNIT.match(text)
    if match is None or match["name"] not in _TIME_NAMES:
        return 0.0
    return _SECONDS.get((match["a"] or match["b"] or match["c"] or "").strip(), 0.0)


def _increases(column: pd.Series) -> bool:
    """Whether the values always increase, as times do: equal neighbours may be rounded."""
    steps = np.diff(pd.to_numeric(column, errors="coerce").to_numpy(dtype=np.float64))
    even = steps.size > 0 and np.ptp(steps) < np.abs(np.mean(steps))
    grows = bool(np.all(steps >= 0.0)) and 2 * np.count_nonzero(steps) > steps.size
    return grows and bool(even or steps.size >= TIME_AXIS.least_times)

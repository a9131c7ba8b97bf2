"""Forms in which results leave: columns of a table, each declared next to the result that it shows, and signals.

Signals are those of SEP 005, the time series that the packages of SDyPy exchange: a list with a dictionary for each
channel. Fields by the validator of the standard, https://github.com/OWI-Lab/sdypy-sep005-compliance: ``name``,
``data``, ``unit_str``, and ``time`` in s or ``fs`` in Hz; further fields are allowed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from tracker.arrays import FloatArray

if TYPE_CHECKING:
    import pandas as pd
    import xarray


@dataclass(frozen=True)
class Tuning:
    """Which times are those of a rate."""

    #: [steps] largest distance of a time from that of the rate
    #: convention: A thousandth of a sample shifts a phase by less than 0.2 degrees.
    uneven: float = 1e-3


TUNING = Tuning()


@dataclass(frozen=True)
class Column:
    """One column of a table.

    Attributes
    ----------
    name : str
        Heading in CSV files and data frames, key in JSON.
    unit : str
        As printed; ``1`` for a number without unit, empty for text and truth values.
    text : str
        What it holds, for docs/columns.md.
    get : callable or None
        Value from that of which the table has a row; None for its attribute `name`.
    """

    name: str
    unit: str
    text: str
    get: Callable[[Any], Any] | None = None

    def of(self, row: object) -> Any:
        """Value of a row."""
        return getattr(row, self.name) if self.get is None else self.get(row)


def table_row(columns: Iterable[Column], row: object) -> dict[str, Any]:
    """Values of a row by the names of the columns."""
    return {column.name: column.of(row) for column in columns}


def data_frame(values: Any, units: Iterable[Column] | Mapping[str, str]) -> pd.DataFrame:
    """Table of `values`; ``attrs["units"]`` has the unit of each column, or the name of the column that holds it."""
    import pandas as pd  # noqa: PLC0415 - slow to import, and only tables need it

    table = pd.DataFrame(values)
    named = units if isinstance(units, Mapping) else {column.name: column.unit for column in units}
    table.attrs["units"] = {name: unit for name, unit in named.items() if unit and name in table}
    return table


def dataset(*parts: Mapping[str, Any]) -> xarray.Dataset:
    """Dataset of variables, coordinates and attributes; ImportError that names xarray where it is absent."""
    try:
        import xarray  # noqa: PLC0415 - optional
    except ImportError as error:
        msg = "to_xarray needs xarray; install it with pip install xarray"
        raise ImportError(msg) from error
    return xarray.Dataset(*parts)


def signals_of(
    time_s: FloatArray, channels: Sequence[str], values: FloatArray, sd: FloatArray, unit: str
) -> list[dict[str, Any]]:
    """One signal for each channel, ``data`` NaN where missing; ``fs`` for even times; ``sd`` where it is known."""
    clock: dict[str, Any] = {"time": time_s.tolist()}
    if time_s.size > 1:
        step = (time_s[-1] - time_s[0]) / (time_s.size - 1)
        if np.max(np.abs(time_s - time_s[0] - step * np.arange(time_s.size))) < TUNING.uneven * step:
            clock["fs"] = float(1.0 / step)
    return [
        {"name": name, "data": values[:, k].copy(), "unit_str": unit, **clock}
        | ({"sd": sd[:, k].copy()} if np.isfinite(sd[:, k]).any() else {})
        for k, name in enumerate(channels)
    ]


def fields_of(signals: Mapping[str, Any] | Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Fields ``time_s``, ``channels``, ``values``, ``sd`` and ``unit`` of a series; ValueError as `from_sep005`."""
    given = [signals] if isinstance(signals, Mapping) else list(signals)
    for k, signal in enumerate(given, 1):
        absent = [name for name in ("name", "data", "unit_str") if name not in signal]
        absent += ["time or fs"] if signal.get("time") is None and signal.get("fs") is None else []
        if absent:
            msg = f"signal {k} of {len(given)} has no {', no '.join(absent)}, which SEP 005 requires"
            raise ValueError(msg)
    # None is missing in lists.
    data = [np.asarray(signal["data"], dtype=np.float64) for signal in given]
    times = [
        np.arange(y.size) / float(s["fs"])
        if s.get("time") is None
        else np.asarray(s["time"], dtype=np.float64)
        for s, y in zip(given, data, strict=True)
    ]
    starts, units = {s.get("start_timestamp") for s in given}, {str(s["unit_str"]) for s in given}
    if len(units) != 1:
        msg = f"expected signals of one unit, found {', '.join(sorted(units)) or 'no signal'}; choose those of one"
        raise ValueError(msg)
    if len(starts) > 1 or any(
        y.shape != times[0].shape or not np.array_equal(t, times[0]) for t, y in zip(times, data, strict=True)
    ):
        msg = "expected signals with the same times, found others; bring them to one clock and length first"
        raise ValueError(msg)
    names = [str(signal["name"]) for signal in given]
    unknown = np.full(times[0].shape, np.nan)
    return {
        "time_s": times[0],
        "channels": tuple(n if names.count(n) == 1 else f"{n} {k}" for k, n in enumerate(names, 1)),
        "values": np.column_stack(data),
        "sd": np.column_stack([np.asarray(signal.get("sd", unknown), dtype=np.float64) for signal in given]),
        "unit": units.pop(),
    }

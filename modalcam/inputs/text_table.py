"""Tables in text files: separator, decimal sign and header row are found from the text itself."""

from __future__ import annotations

import io
import re
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from modalcam.inputs.program_tables import PROGRAMS, of_motion

# Header, preamble and a few rows of numbers: enough to see how a file is written.
_HEAD_BYTES = 65_536
_SEPARATORS = {";": "semicolons", "\t": "tabs", ",": "commas", r"\s+": "blanks"}
_NUMBER = re.compile(
    r"^[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?$|^[+-]?(nan|inf|infinity)$|^$", re.IGNORECASE
)
_TIME_UNITS = {"s", "ms", "us", "µs", "ns", "sec", "seconds"}
_END_OF_HEADER = "***End_of_Header***"


@dataclass(frozen=True)
class _Layout:
    """How a text file holds its table: rows before the numbers, names of the columns, separator, decimal sign."""

    skipped: int
    names: list[str]
    separator: str
    decimal: str


def read_text(path: Path) -> tuple[pd.DataFrame, list[str]]:
    """Columns of a text table, and what was found out about it; ValueError if it is no table of numbers."""
    encoding = "utf-16" if _head(path)[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    # As pandas divides them: other signs at which Python ends a line are part of it.
    lines = re.split(r"\r\n|\r|\n", _head(path).decode(encoding, errors="replace"))
    # The last line may have been cut.
    lines = lines[:-1] if len(_head(path)) == _HEAD_BYTES else lines
    for beginning, read in PROGRAMS.items():
        if lines and lines[0].startswith(beginning):
            return read(path)
    first = next((line for line in lines if line.strip() and not line.startswith("#")), "")
    layout = None if "time_s" in [name.strip() for name in first.split(",")] else _layout(lines)
    if layout is None:
        return _read_csv(path, comment="#", encoding=encoding), []
    table = _read_csv(
        path,
        sep=layout.separator,
        decimal=layout.decimal,
        skiprows=layout.skipped,
        names=layout.names,
        header=None,
        encoding=encoding,
        encoding_errors="replace",
    )
    table, left_out = of_motion(table)
    return table, [*_described(layout), *left_out]


def _read_csv(source: Path | io.StringIO, **how: Any) -> pd.DataFrame:
    """Columns by pandas, which by itself takes the first cells of rows that are longer than the header for names."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", pd.errors.ParserWarning)
        try:
            # A small compressed file may hold any number of rows: none is decompressed.
            return pd.read_csv(source, skipinitialspace=True, compression=None, index_col=False, **how)
        except pd.errors.ParserWarning as warning:
            msg = "rows of more cells than the header has names"
            raise ValueError(msg) from warning


def _head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(_HEAD_BYTES)


def _described(layout: _Layout) -> list[str]:
    if layout.separator == "," and layout.decimal == "." and layout.skipped <= 1:
        return []
    decimal = "commas" if layout.decimal == "," else "points"
    return [f"The table is read with columns between {_SEPARATORS[layout.separator]} and decimal {decimal}."]


def _layout(lines: list[str]) -> _Layout | None:
    """Layout of the table that the last lines belong to; None where they hold no numbers."""
    rows = [(index, line) for index, line in enumerate(lines) if line.strip()]
    for separator in _SEPARATORS:
        cells = [_cells(line, separator) for _, line in rows]
        if not cells or len(cells[-1]) < 2 or not _is_numeric(cells[-1], separator):
            continue
        start = len(cells)
        while start and len(cells[start - 1]) == len(cells[-1]) and _is_numeric(cells[start - 1], separator):
            start -= 1
        return _Layout(
            rows[start][0], _names(cells, rows, start, separator), separator, _decimal(cells[start:])
        )
    if rows and _is_numeric([rows[-1][1].strip()], ";"):
        return _one_column(rows)
    return None


def _one_column(rows: list[tuple[int, str]]) -> _Layout:
    cells = [[line.strip()] for _, line in rows]
    start = len(cells)
    while start and _is_numeric(cells[start - 1], ";"):
        start -= 1
    names = [cells[start - 1][0].lstrip("# ")] if start else ["column 1"]
    return _Layout(rows[start][0], names, ";", _decimal(cells[start:]))


def _cells(line: str, separator: str) -> list[str]:
    parts = line.split() if separator == r"\s+" else line.split(separator)
    return [part.strip().strip('"') for part in parts]


def _is_numeric(cells: list[str], separator: str) -> bool:
    numbers = all(_NUMBER.match(cell) and not (separator == "," and "," in cell) for cell in cells)
    return numbers and any(cells)


def _names(cells: list[list[str]], rows: list[tuple[int, str]], start: int, separator: str) -> list[str]:
    """Names from the row above the numbers, which may be a comment; ``column 1`` and so on where there is none."""
    width = len(cells[start])
    if start:
        above = _cells(rows[start - 1][1].lstrip("# "), separator)
        if start > 1 and len(cells[start - 2]) == width and above[0].strip("()[]").lower() in _TIME_UNITS:
            # units stand in a row of their own
            above = [
                f"{name} [{unit.strip('()[]')}]" for name, unit in zip(cells[start - 2], above, strict=False)
            ]
        if len(above) == width and len(set(above)) == width and all(above):
            return above
    return [f"column {k + 1}" for k in range(width)]


def _decimal(cells: list[list[str]]) -> str:
    return "," if any("," in cell for row in cells for cell in row) else "."


def read_lvm(path: Path) -> tuple[pd.DataFrame, list[str]]:
    """Channels of a LabVIEW measurement file with one segment and one column of times, or none.

    ValueError if it has several segments, a column of times for every channel, or channels of different rates.
    """
    text = path.read_text("utf-8", errors="replace")
    parts = text.split(_END_OF_HEADER)
    if not text.startswith("LabVIEW Measurement") or len(parts) < 3:
        msg = "no LabVIEW measurement with two headers; export it as CSV"
        raise ValueError(msg)
    if len(parts) > 3:
        msg = f"{len(parts) - 2} segments; export one of them"
        raise ValueError(msg)
    separator = "," if "Separator,Comma" in parts[0] else "\t"
    header = _lvm_header(parts[0], separator) | _lvm_header(parts[1], separator)
    times = header.get("X_Columns", ["One"])[0]
    if times == "Multi":
        msg = "a column of times for each channel; write it with one, or none"
        raise ValueError(msg)
    found = header.get("Decimal_Separator", ["."])
    decimal = found[0] or "."
    # A comma between commas, as which the header is divided, is two empty cells.
    if separator == "," and found[:2] == ["", ""]:
        msg = "a comma between columns and in numbers; write it with tabs"
        raise ValueError(msg)
    first, _, body = parts[2].lstrip("\t,\r\n").partition("\n")
    names = [name for name in first.strip("\r").split(separator) if name and name != "Comment"]
    if not names or not body.strip():
        msg = "no row of numbers below the headers"
        raise ValueError(msg)
    numbers = {"sep": separator, "decimal": decimal, "header": None, "usecols": range(len(names))}
    values = _read_csv(io.StringIO(body), **numbers).set_axis(names, axis=1)
    if times == "No":
        steps = {float(step.replace(decimal, ".")) for step in header.get("Delta_X", []) if step}
        if len(steps) != 1:
            msg = f"channels of {len(steps)} different rates; export those of one rate"
            raise ValueError(msg)
        values[names[0]] = steps.pop() * np.arange(len(values))
    return values, ["The table is a LabVIEW measurement."]


def _lvm_header(text: str, separator: str) -> dict[str, list[str]]:
    rows = [line.split(separator) for line in text.splitlines() if line.strip()]
    return {row[0]: row[1:] for row in rows if len(row) > 1}

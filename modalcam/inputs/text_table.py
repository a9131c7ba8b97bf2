"""Tables in text files: separator, decimal sign and header row are found from the text itself."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

# Header, preamble and a few rows of numbers: enough to see how a file is written.
_HEAD_BYTES = 65_536
_SEPARATORS = {";": "semicolons", "\t": "tabs", ",": "commas", r"\s+": "blanks"}
_NUMBER = re.compile(
    r"^[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?$|^[+-]?(nan|inf|infinity)$|^$", re.IGNORECASE
)
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
    lines = _head(path).decode(encoding, errors="replace").splitlines()
    # The last line may have been cut.
    lines = lines[:-1] if len(_head(path)) == _HEAD_BYTES else lines
    first = next((line for line in lines if line.strip() and not line.startswith("#")), "")
    layout = None if "time_s" in [name.strip() for name in first.split(",")] else _layout(lines)
    if layout is None:
        # A small compressed file may hold any number of rows: none is decompressed.
        return pd.read_csv(path, comment="#", skipinitialspace=True, compression=None, encoding=encoding), []
    table = pd.read_csv(
        path,
        sep=layout.separator,
        decimal=layout.decimal,
        skiprows=layout.skipped,
        names=layout.names,
        header=None,
        skipinitialspace=True,
        compression=None,
        encoding=encoding,
        encoding_errors="replace",
    )
    return table, _described(layout)


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
    if header.get("X_Columns", ["One"])[0] == "Multi":
        msg = "a column of times for each channel; write it with one, or none"
        raise ValueError(msg)
    decimal = header.get("Decimal_Separator", ["."])[0]
    lines = parts[2].lstrip("\t,\r\n").splitlines()
    names = [name for name in lines[0].split(separator) if name and name != "Comment"]
    cells = [line.split(separator)[: len(names)] for line in lines[1:] if line.strip()]
    values = pd.DataFrame(cells, columns=names).apply(lambda c: pd.to_numeric(c.str.replace(decimal, ".")))
    if header.get("X_Columns", ["One"])[0] == "No":
        steps = {float(step.replace(decimal, ".")) for step in header.get("Delta_X", []) if step}
        if len(steps) != 1:
            msg = f"channels of {len(steps)} different rates; export those of one rate"
            raise ValueError(msg)
        values[names[0]] = steps.pop() * np.arange(len(values))
    return values, ["The table is a LabVIEW measurement."]


def _lvm_header(text: str, separator: str) -> dict[str, list[str]]:
    rows = [line.split(separator) for line in text.splitlines() if line.strip()]
    return {row[0]: row[1:] for row in rows}

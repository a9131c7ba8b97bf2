"""What a column of a table is: declared once, next to the result that it shows."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any


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

"""What a column of a table is: declared once, next to the result that it shows."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd
    import xarray


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

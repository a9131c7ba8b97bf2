"""Tables that apps and plugins write.

In a module of its own: a run that is up to date loads plugins, but not the results whose columns `columns` collects.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from tracker import Column

if TYPE_CHECKING:
    from modalcam.pipeline import RunResult


Rows = Callable[["RunResult"], Sequence[dict[str, Any]]]


@dataclass(frozen=True)
class RegisteredTable:
    """Columns of a table; of one that a run writes where it has rows, what it holds and its rows."""

    columns: tuple[Column, ...]
    about: str = ""
    rows: Rows | None = None


#: Each table by the name of its file.
REGISTERED: dict[str, RegisteredTable] = {}


def register_table(name: str, columns: tuple[Column, ...], about: str = "", rows: Rows | None = None) -> None:
    """Add a table of an app or a plugin, as in `RegisteredTable`; ValueError if another one has the name."""
    if REGISTERED.setdefault(name, made := RegisteredTable(columns, about, rows)) != made:
        msg = f"a table named {name!r} is registered already; choose another name"
        raise ValueError(msg)

"""Tables that apps and plugins write.

In a module of its own: a run that is up to date loads plugins, but not the results whose columns `columns` collects.
"""

from __future__ import annotations

from tracker import Column

#: Columns of each table that is registered, by the name of its file.
REGISTERED: dict[str, tuple[Column, ...]] = {}


def register_table(name: str, columns: tuple[Column, ...]) -> None:
    """Add the columns of a table that an app or a plugin writes; ValueError if another one has registered the name."""
    if REGISTERED.setdefault(name, columns) is not columns:
        msg = f"a table named {name!r} is registered already; choose another name"
        raise ValueError(msg)

"""What an output format is, and the tables that apps and plugins write.

Few imports: a run that is up to date loads plugins, but not the results whose columns `columns` collects.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from modalcam.config import ExperimentConfig
from modalcam.pipeline import RunResult, Workspace
from tracker import Column

if TYPE_CHECKING:
    from modalcam.pipeline import RunResult


@dataclass(frozen=True)
class Output:
    """A file of OUT and the function that writes it, again only when the results that it shows or the code changed.

    `about` says in the report what the file holds: the description of its writer.
    """

    path: Path
    shows: object
    write: Callable[[Path], object]
    about: str = ""


@dataclass(frozen=True)
class Writer:
    """One output format.

    Attributes
    ----------
    files : str
        Path pattern in OUT, such as ``tracks/<recording>.csv``.
    description : str
        Content of a file, for docs/files.md.
    outputs : callable
        Of workspace, result of the run and configuration: the files to write.
    libraries : tuple of str
        Optional modules that the format needs, which are named as their packages are.
    """

    name: str
    files: str
    description: str
    outputs: Callable[[Workspace, RunResult, ExperimentConfig], Iterable[Output]]
    libraries: tuple[str, ...] = ()

    @property
    def missing(self) -> str:
        """Sentence about the libraries that the format lacks; empty if it can be written."""
        absent = [name for name in self.libraries if importlib.util.find_spec(name) is None]
        if not absent:
            return ""
        return (
            f"{self.files} was not written: {' and '.join(absent)} not installed; "
            f"install with pip install {' '.join(absent)}."
        )


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

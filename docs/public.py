"""Write docs/public.txt, everything that a release promises to keep, one item a line: `python docs/public.py`.

Run once per release. docs/stability.md says what the lines mean; tests/test_packaging.py compares them with the code.
"""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer

import modalcam
from modal_id import FrequencyResponse, Identification, IdentifiedMode
from modalcam.cli import app
from modalcam.common import ExitCode
from modalcam.config import sections
from modalcam.pipeline import RunResult
from modalcam.plugins import load_apps
from modalcam.tables import REGISTERED, TABLES
from tracker import DisplacementSeries, MarkerTracks

RESULTS = (DisplacementSeries, FrequencyResponse, Identification, IdentifiedMode, MarkerTracks, RunResult)


def public() -> list[str]:
    """Lines of the file, sorted."""
    load_apps("plugin")
    return sorted({*_python(), *_commands(), *_configuration(), *_files()})


def _python() -> Iterator[str]:
    for name in modalcam.__all__:
        yield f"python {name}"
        value = getattr(modalcam, name)
        if callable(value) and not _is_error(value):
            yield from (f"python {name}({argument})" for argument in _arguments(value))
    for one in RESULTS:
        names = {*dir(one), *(field.name for field in dataclasses.fields(one))}
        yield from (f"python {one.__name__}.{name}" for name in names if not name.startswith("_"))


def _is_error(value: Any) -> bool:
    return isinstance(value, type) and issubclass(value, Exception)


def _arguments(value: Any) -> Iterator[str]:
    for argument in inspect.signature(value).parameters.values():
        optional = argument.default is not argument.empty or argument.kind is argument.VAR_KEYWORD
        yield argument.name + ("" if optional else ", required")


def _commands() -> Iterator[str]:
    for name, command in typer.main.get_command(app).commands.items():  # type: ignore[attr-defined]  # the application is a group of commands
        yield f"command {name}"
        for parameter in command.params:
            is_option = parameter.param_type_name == "option"
            names = [*parameter.opts, *parameter.secondary_opts] if is_option else [parameter.name.upper()]
            yield from (f"command {name} {one}" for one in names)
    yield from (f"exit {code.value} {code.name}" for code in ExitCode)


def _configuration() -> Iterator[str]:
    for section in sections():
        yield from (f"configuration {section.path or 'top'}.{one.key}" for one in section.options())


def _files() -> Iterator[str]:
    for table, columns in {**TABLES, **{name: one.columns for name, one in REGISTERED.items()}}.items():
        yield from (f"column {table} {one.name} [{one.unit}]" for one in columns)


if __name__ == "__main__":
    Path(__file__).with_suffix(".txt").write_text("\n".join(public()) + "\n", encoding="utf-8")

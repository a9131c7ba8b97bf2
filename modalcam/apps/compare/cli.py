"""``modalcam compare``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from modalcam.cli import Replace, register_command, results_console
from modalcam.common import check_new, shown


def compare(
    outs: Annotated[
        list[Path], typer.Argument(metavar="OUT1 OUT2 ...", help="Folders of earlier runs of the same beam.")
    ],
    to: Annotated[
        Path | None,
        typer.Option("-o", "--out", help="Folder for compare.html, compare.csv and compare.json."),
    ] = None,
    same_camera: Annotated[
        bool, typer.Option("--same-camera", help="The error of the frame rate is the same in all runs.")
    ] = False,
    small_amplitude: Annotated[
        bool,
        typer.Option("--small-amplitude", help="Compare values at small amplitude, which are less precise."),
    ] = False,
    force: Replace = False,
) -> None:
    """Compare the modes of a beam in several runs."""
    from modalcam.apps.compare.compare import FILES, compare_runs, show, write_files

    if to is not None:
        for name in FILES:
            check_new(to / name, force=force)
    comparison = compare_runs(outs, same_camera=same_camera, small_amplitude=small_amplitude)
    show(comparison, results_console(None if sys.stdout.isatty() else 100))
    if to is not None:
        write_files(comparison, to)
        typer.echo(shown(str(to / FILES[-1])))


register_command(compare)

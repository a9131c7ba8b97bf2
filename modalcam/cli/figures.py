"""``modalcam figures``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from modalcam.cli.options import Replace
from modalcam.common import check_new, shown


def figures(
    out: Annotated[Path, typer.Argument(help="Folder of an earlier run.")],
    to: Annotated[Path, typer.Option("-o", "--out", help="Folder for the figures.")],
    columns: Annotated[
        int,
        typer.Option(
            min=1, max=2, help="Style of a journal: letters and width for 1 column (89 mm) or 2 (183 mm)."
        ),
    ] = 2,
    force: Replace = False,
) -> None:
    """Write the figures of the report as SVG and PDF, with data."""
    check_new(to / "captions.txt", force=force)
    from modalcam.pipeline import load_run
    from modalcam.report import write_figures

    written = write_figures(load_run(out), to, columns=columns)
    typer.echo(f"{len(written)} files in {shown(str(to))}")

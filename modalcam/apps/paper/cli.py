"""``modalcam paper``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from modalcam.cli import PIPELINE, Json, Out, Verbose, console, register_command, run_options, takes


@takes(*PIPELINE)
def paper(
    folder: Annotated[Path, typer.Argument(help="Folder of recordings, such as sample_videos.")],
    out: Out,
    common: dict[str, Any],
    json_: Json = False,
    verbose: Verbose = 0,
) -> None:
    """Reproduce the tables and figures of the paper.

    Runs the whole pipeline, then writes Tables 1 to 3 and Figures 2 to 4 to OUT/paper.html.
    """
    from modalcam import commands
    from modalcam.apps.paper.page import numbers, show, write_paper
    from modalcam.common import shown
    from modalcam.console import listener, problems
    from modalcam.pipeline import Workspace

    options = run_options(out, **common)
    with listener(console(), verbose) as progress:
        result = commands.run(folder, options, progress)
        page = write_paper(result, folder, out, force=common["force"], progress=progress)
    show(page, console())
    summary = json.loads(Workspace(out).summary.read_text("utf-8"))
    code = problems(console(), summary, result.internal_errors)
    typer.echo(json.dumps(numbers(page), indent=1) if json_ else shown(str(out / "paper.html")))
    raise typer.Exit(code)


register_command(paper)

"""``modalcam report``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from modalcam.cli.options import Jobs, Json, Verbose, conclude, console, run_options


def report(
    out: Annotated[Path, typer.Argument(help="Folder of an earlier run.")],
    jobs: Jobs = None,
    json_: Json = False,
    verbose: Verbose = 0,
) -> None:
    """Write the files of OUT, report.html above all, again from its saved results."""
    from modalcam import commands
    from modalcam.console import listener

    options = run_options(out, jobs=jobs)
    with listener(console(), verbose) as progress:
        result = commands.report(options, progress)
    conclude(result, out, as_json=json_)

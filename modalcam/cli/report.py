"""``modalcam report``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from modalcam.cli.options import Jobs, Json, Verbose, console, run_options


def report(
    out: Annotated[Path, typer.Argument(help="Folder of an earlier run.")],
    jobs: Jobs = None,
    json_: Json = False,
    verbose: Verbose = 0,
) -> None:
    """Write the files of OUT, report.html above all, again from its saved results."""
    from modalcam import run as commands
    from modalcam.console import finish, listener

    options = run_options(out, None, None, 0, jobs, force=False, follow_symlinks=False)
    with listener(console(), verbose) as progress:
        result = commands.report(options, progress)
    finish(console(), result, out, as_json=json_)
    raise typer.Exit(commands.exit_code(result.recordings, result.internal_errors))

"""``modalcam simulate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from modalcam.cli.options import Config, Jobs, Json, Seed, Verbose, console, run_options


def simulate(
    out: Annotated[Path, typer.Argument(help="Folder of an earlier run.")],
    config: Config = None,
    seed: Seed = 0,
    jobs: Jobs = None,
    json_: Json = False,
    verbose: Verbose = 0,
) -> None:
    """Match the beam and compare damping models again from the modes saved in OUT."""
    from modalcam import run as commands
    from modalcam.console import finish, listener

    options = run_options(out, config, None, seed, jobs, force=False, follow_symlinks=False)
    with listener(console(), verbose) as progress:
        result = commands.simulate(options, progress)
    finish(console(), result, out, as_json=json_)
    raise typer.Exit(commands.exit_code(result.recordings, result.internal_errors))

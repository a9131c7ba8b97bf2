"""``modalcam run``, and ``simulate`` and ``report`` on the saved results of a run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from modalcam.cli.options import PIPELINE, Json, Out, Verbose, conclude, console, run_options, takes

SavedRun = Annotated[Path, typer.Argument(help="Folder of an earlier run.")]


@takes(*PIPELINE)
def run(
    folder: Annotated[Path, typer.Argument(help="Folder of recordings, with or without experiment.toml.")],
    out: Out,
    common: dict[str, Any],
    json_: Json = False,
    verbose: Verbose = 0,
) -> None:
    """Track, identify, simulate and report all recordings."""
    from modalcam import commands
    from modalcam.console import listener

    options = run_options(out, **common)
    with listener(console(), verbose) as progress:
        result = commands.run(folder, options, progress)
    conclude(result, out, as_json=json_)


@takes("config", "seed", "jobs", "scheduler", "time_limit", "memory_limit", "plugins")
def simulate(out: SavedRun, common: dict[str, Any], json_: Json = False, verbose: Verbose = 0) -> None:
    """Update the beam and compare damping models again."""
    from modalcam import commands
    from modalcam.console import listener

    options = run_options(out, **common)
    with listener(console(), verbose) as progress:
        result = commands.simulate(options, progress)
    conclude(result, out, as_json=json_)


@takes("jobs", "plugins")
def report(out: SavedRun, common: dict[str, Any], json_: Json = False, verbose: Verbose = 0) -> None:
    """Write the report and the other files of OUT again."""
    from modalcam import commands
    from modalcam.console import listener

    options = run_options(out, **common)
    with listener(console(), verbose) as progress:
        result = commands.report(options, progress)
    conclude(result, out, as_json=json_)

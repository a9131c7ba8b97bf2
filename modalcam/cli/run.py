"""``modalcam run``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from modalcam.cli.options import (
    TIME_LIMIT_S,
    Config,
    Force,
    Fps,
    Jobs,
    Json,
    Links,
    MemoryLimit,
    Out,
    Scheduler,
    Seed,
    TimeLimit,
    Verbose,
    conclude,
    console,
    run_options,
)


def run(
    folder: Annotated[Path, typer.Argument(help="Folder of recordings, with or without experiment.toml.")],
    out: Out,
    config: Config = None,
    fps: Fps = None,
    seed: Seed = 0,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    time_limit: TimeLimit = TIME_LIMIT_S,
    memory_limit: MemoryLimit = None,
    force: Force = False,
    follow_symlinks: Links = False,
    json_: Json = False,
    verbose: Verbose = 0,
) -> None:
    """Track, identify, simulate and report every recording of FOLDER."""
    from modalcam import commands
    from modalcam.console import listener

    options = run_options(
        out,
        config=config,
        fps=fps,
        seed=seed,
        jobs=jobs,
        force=force,
        follow_symlinks=follow_symlinks,
        scheduler=scheduler,
        time_limit_s=time_limit,
        memory_limit_gb=memory_limit,
    )
    with listener(console(), verbose) as progress:
        result = commands.run(folder, options, progress)
    conclude(result, out, as_json=json_)

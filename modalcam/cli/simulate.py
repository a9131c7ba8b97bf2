"""``modalcam simulate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from modalcam.cli.options import (
    TIME_LIMIT_S,
    Config,
    Jobs,
    Json,
    MemoryLimit,
    Scheduler,
    Seed,
    TimeLimit,
    Verbose,
    conclude,
    console,
    run_options,
)


def simulate(
    out: Annotated[Path, typer.Argument(help="Folder of an earlier run.")],
    config: Config = None,
    seed: Seed = 0,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    time_limit: TimeLimit = TIME_LIMIT_S,
    memory_limit: MemoryLimit = None,
    json_: Json = False,
    verbose: Verbose = 0,
) -> None:
    """Match the beam and compare damping models again from the modes saved in OUT."""
    from modalcam import commands
    from modalcam.console import listener

    options = run_options(
        out,
        config=config,
        seed=seed,
        jobs=jobs,
        scheduler=scheduler,
        time_limit_s=time_limit,
        memory_limit_gb=memory_limit,
    )
    with listener(console(), verbose) as progress:
        result = commands.simulate(options, progress)
    conclude(result, out, as_json=json_)

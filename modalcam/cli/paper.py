"""``modalcam paper``."""

from __future__ import annotations

import json
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
    console,
    run_options,
)


def paper(
    folder: Annotated[Path, typer.Argument(help="Folder of recordings, such as sample_videos.")],
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
    """Rebuild the paper's Tables 1 to 3 and Figures 2 to 4 from FOLDER: runs what `run` does, writes OUT/paper.html."""
    from modalcam import commands
    from modalcam.console import listener, problems
    from modalcam.names import shown
    from modalcam.paper.page import numbers, show, write_paper

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
        page = write_paper(result, folder, out, force=force, progress=progress)
    show(page, console())
    problems(console(), result)
    typer.echo(json.dumps(numbers(page), indent=1) if json_ else shown(str(out / "paper.html")))
    raise typer.Exit(commands.exit_code(result.recordings, result.internal_errors))

"""``modalcam track``."""

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
    Links,
    MemoryLimit,
    Out,
    Scheduler,
    TimeLimit,
    Verbose,
    console,
    run_options,
)


def track(
    target: Annotated[
        Path, typer.Argument(metavar="FILE|FOLDER", help="Recording, or folder of recordings.")
    ],
    out: Out,
    config: Config = None,
    fps: Fps = None,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    time_limit: TimeLimit = TIME_LIMIT_S,
    memory_limit: MemoryLimit = None,
    force: Force = False,
    follow_symlinks: Links = False,
    preview: Annotated[
        Path | None, typer.Option("--preview", help="Also write FILE's footage with the tracks drawn in.")
    ] = None,
    verbose: Verbose = 0,
) -> None:
    """Only follow the markers: writes OUT/tracks."""
    from modalcam import commands
    from modalcam.console import listener, tracked
    from modalcam.video.track_preview import check_preview, write_preview
    from tracker.results import MarkerTracks

    if preview is not None:
        check_preview(preview, target, out)
    options = run_options(
        out,
        config=config,
        fps=fps,
        jobs=jobs,
        force=force,
        follow_symlinks=follow_symlinks,
        scheduler=scheduler,
        time_limit_s=time_limit,
        memory_limit_gb=memory_limit,
    )
    with listener(console(), verbose) as progress:
        recordings, internal_errors = commands.track(target, options, progress)
    if preview is not None and isinstance(recordings[0].tracks, MarkerTracks):
        write_preview(preview, target, recordings[0].tracks)
    tracked(console(), recordings, out)
    raise typer.Exit(commands.exit_code(recordings, internal_errors))

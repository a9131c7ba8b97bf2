"""``modalcam track``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from modalcam.cli.options import Out, Verbose, console, run_options, takes


@takes(
    "config", "fps", "jobs", "scheduler", "time_limit", "memory_limit", "plugins", "force", "follow_symlinks"
)
def track(
    target: Annotated[
        Path, typer.Argument(metavar="FILE|FOLDER", help="Recording, or folder of recordings.")
    ],
    out: Out,
    common: dict[str, Any],
    preview: Annotated[
        Path | None,
        typer.Option("--preview", help="Also write the footage of FILE with the tracks drawn in."),
    ] = None,
    verbose: Verbose = 0,
) -> None:
    """Track the markers only and write OUT/tracks."""
    from modalcam import commands
    from modalcam.console import listener, tracked
    from modalcam.video.track_preview import check_preview, write_preview
    from tracker.results import MarkerTracks

    if preview is not None:
        check_preview(preview, target, out)
    options = run_options(out, **common)
    with listener(console(), verbose) as progress:
        recordings, internal_errors = commands.track(target, options, progress)
    if preview is not None and isinstance(recordings[0].tracks, MarkerTracks):
        write_preview(preview, target, recordings[0].tracks)
    tracked(console(), recordings, out)
    raise typer.Exit(commands.exit_code(recordings, internal_errors))

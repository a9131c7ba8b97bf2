"""Options that several commands share."""

from __future__ import annotations

import os
import sys
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console

from modalcam.errors import ModalcamError

if TYPE_CHECKING:
    from modalcam.run import Options

Out = Annotated[Path, typer.Option("-o", "--out", help="Folder for the results.")]
Config = Annotated[
    Path | None, typer.Option("-c", "--config", help="Configuration instead of the one found.")
]
Fps = Annotated[
    str | None,
    typer.Option("--fps", help="Recorded rate in frames per second, over everything else: 1000, 30000/1001."),
]
Seed = Annotated[int, typer.Option("--seed", min=0, help="Seed of all random numbers.")]
Jobs = Annotated[
    int | None, typer.Option("--jobs", min=1, help="Worker processes; default: one per processor.")
]
Force = Annotated[bool, typer.Option("--force", help="Compute everything anew.")]
Links = Annotated[bool, typer.Option("--follow-symlinks", help="Also read recordings behind links.")]
Json = Annotated[bool, typer.Option("--json", help="Print a summary for programs on standard output.")]
Verbose = Annotated[int, typer.Option("-v", "--verbose", count=True, help="Say more.")]


def console() -> Console:
    """Where messages go: standard error."""
    # A log has no width of its own: nothing in it may be cut.
    return Console(stderr=True, width=None if sys.stderr.isatty() else 160)


def run_options(
    out: Path,
    config: Path | None,
    fps: str | None,
    seed: int,
    jobs: int | None,
    force: bool,
    follow_symlinks: bool,
) -> Options:
    """What the commands that run the pipeline were asked for."""
    from modalcam.run import Options

    return Options(
        out=out,
        config=config,
        fps=_fps(fps),
        seed=seed,
        jobs=jobs or os.cpu_count() or 1,
        force=force,
        follow_symlinks=follow_symlinks,
    )


def _fps(text: str | None) -> Fraction | None:
    from modalcam.config import parse_fps

    if text is None:
        return None
    try:
        return parse_fps(text)
    except ValueError as error:
        msg = f"--fps: {error}"
        raise ModalcamError(msg) from None

"""``modalcam demo``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from modalcam.cli.options import Jobs, Seed, Verbose, conclude, console, run_options
from modalcam.errors import ModalcamError


def demo(
    out: Annotated[Path, typer.Argument(help="Folder for the footage and the results.")],
    modes: Annotated[str, typer.Option(help="Modes to film, separated by commas.")] = "2,3",
    seed: Seed = 0,
    jobs: Jobs = None,
    verbose: Verbose = 0,
) -> None:
    """Film a simulated beam and take the footage through everything."""
    from modalcam import commands
    from modalcam.console import listener
    from modalcam.video.film_beam import film_demo

    with listener(console(), verbose) as progress:
        folder = film_demo(out / "videos", _mode_list(modes), seed, progress)
        options = run_options(out / "results", seed=seed, jobs=jobs)
        result = commands.run(folder, options, progress)
    conclude(result, out / "results")


def _mode_list(text: str) -> tuple[int, ...]:
    parts = [part.strip() for part in text.split(",")]
    if not all(part.isdecimal() and 1 <= int(part) <= 5 for part in parts):
        msg = f"--modes: expected mode numbers from 1 to 5 separated by commas, found {text!r}"
        raise ModalcamError(msg)
    return tuple(sorted({int(part) for part in parts}))

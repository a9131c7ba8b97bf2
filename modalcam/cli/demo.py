"""``modalcam demo``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from modalcam.cli.options import Verbose, conclude, console, run_options, takes
from modalcam.errors import ModalcamError


@takes("seed", "jobs")
def demo(
    out: Annotated[Path, typer.Argument(help="Folder for the footage and the results.")],
    common: dict[str, Any],
    modes: Annotated[str, typer.Option(help="Modes to excite, separated by commas.")] = "2,3",
    verbose: Verbose = 0,
) -> None:
    """Render footage of a simulated beam and run the whole pipeline."""
    from modalcam import commands
    from modalcam.console import listener
    from modalcam.video.film_beam import film_demo

    with listener(console(), verbose) as progress:
        folder = film_demo(out / "videos", _mode_list(modes), common["seed"], progress)
        options = run_options(out / "results", **common)
        result = commands.run(folder, options, progress)
    conclude(result, out / "results")


def _mode_list(text: str) -> tuple[int, ...]:
    parts = [part.strip() for part in text.split(",")]
    if not all(part.isdecimal() and 1 <= int(part) <= 5 for part in parts):
        msg = f"--modes: expected mode numbers from 1 to 5 separated by commas, found {text!r}"
        raise ModalcamError(msg)
    return tuple(sorted({int(part) for part in parts}))

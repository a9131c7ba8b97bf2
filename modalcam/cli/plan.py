"""``modalcam plan``."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from modalcam.cli.options import Jobs, Seed, Verbose, console


def plan(
    config: Annotated[
        Path,
        typer.Argument(
            help="experiment.toml with beam, camera and markers; its section \\[plan] says what is meant."
        ),
    ],
    out: Annotated[Path | None, typer.Option("-o", "--out", help="HTML file to write as well.")] = None,
    simulate: Annotated[
        int, typer.Option(min=0, help="Render and identify each mode so many times, to see what comes out.")
    ] = 0,
    seed: Seed = 0,
    jobs: Jobs = None,
    verbose: Verbose = 0,
) -> None:
    """Predict the intervals that an experiment would give, before it is filmed."""
    from modalcam.console import listener
    from modalcam.planning.make import make_plan
    from modalcam.planning.page import plan_html, show
    from modalcam.storage.atomic import write_text

    with listener(console(), verbose) as progress:
        made = make_plan(
            config, trials=simulate, seed=seed, jobs=jobs or os.cpu_count() or 1, progress=progress
        )
    show(made, Console(width=None if sys.stdout.isatty() else 160))
    if out is not None:
        write_text(out, plan_html(made))
        typer.echo(str(out))

"""``modalcam plan``."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from modalcam.cli import Jobs, Replace, Seed, Verbose, console, register_command, results_console
from modalcam.common import check_new


def plan(
    config: Annotated[
        Path,
        typer.Argument(
            help="experiment.toml with beam, camera and markers; \\[plan] sets modes, amplitudes and camera noise."
        ),
    ],
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Also write the plan to this HTML file.")
    ] = None,
    simulate: Annotated[
        int, typer.Option(min=0, help="Number of recordings to render, track and identify for each mode.")
    ] = 0,
    seed: Seed = 0,
    jobs: Jobs = None,
    force: Replace = False,
    verbose: Verbose = 0,
) -> None:
    """Predict the uncertainty of a planned experiment."""
    from modalcam.apps.plan.page import plan_html, show
    from modalcam.apps.plan.plan import plan as make_plan
    from modalcam.console import listener
    from modalcam.pipeline import write_text

    if out is not None:
        check_new(out, force=force)
    with listener(console(), verbose) as progress:
        made = make_plan(
            config, trials=simulate, seed=seed, jobs=jobs or os.cpu_count() or 1, progress=progress
        )
    show(made, results_console(None if sys.stdout.isatty() else 160))
    if out is not None:
        write_text(out, plan_html(made))
        typer.echo(str(out))


register_command(plan, "Before a run")

"""``modalcam render``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from modalcam.cli.options import Out, Seed, Verbose, console


def render(
    config: Annotated[
        Path, typer.Argument(help="experiment.toml with its sections beam, camera and markers.")
    ],
    out: Out,
    mode: Annotated[int, typer.Option(min=1, help="Mode to shake.")] = 1,
    tip_amplitude_mm: Annotated[float, typer.Option(min=0.0, help="Steady amplitude of the tip.")] = 1.0,
    damping_ratio: Annotated[
        float, typer.Option(min=0.0, max=0.5, help="Damping ratio of every mode.")
    ] = 0.003,
    shake_s: Annotated[float, typer.Option(min=0.0, help="Steady shaking before the stop.")] = 0.5,
    decay_s: Annotated[float, typer.Option(min=0.0, help="Free decay after the stop.")] = 3.0,
    seed: Seed = 0,
    verbose: Verbose = 0,
) -> None:
    """Film a simulated beam as the camera of the configuration would see it."""
    from modalcam.console import listener
    from modalcam.filming import Shot, film_config

    shot = Shot(mode, tip_amplitude_mm * 1e-3, damping_ratio, shake_s, decay_s)
    with listener(console(), verbose) as progress:
        film_config(config, out, shot, seed, progress)
    typer.echo(str(out))

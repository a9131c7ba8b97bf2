"""``modalcam render``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from modalcam.cli.options import Seed, Verbose, console, run_options
from modalcam.errors import ModalcamError


def render(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="CONFIG|OUT",
            help="experiment.toml with its sections beam, camera and markers; or the folder of a finished run.",
        ),
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="Video to write.")],
    recording: Annotated[
        str | None, typer.Option(help="Of a finished run: which decay is simulated and filmed as it was.")
    ] = None,
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
    """Film a simulated beam: as a configuration's camera would see it, or the updated beam as a recording shows it.

    From a finished run, the beam decays from the state fitted to the recording, under the identified damping; the
    options of the shaking are for configurations.
    """
    from modalcam.console import listener
    from modalcam.render import film_run
    from modalcam.video.film_beam import Shot, film_config

    if source.is_dir():
        options = run_options(source, seed=seed, jobs=1)
        with listener(console(), verbose) as progress:
            film_run(options, recording, out, progress)
        typer.echo(str(out))
        return
    if recording is not None:
        msg = f"--recording: expected the folder of a finished run, found {source}"
        raise ModalcamError(msg)
    shot = Shot(mode, tip_amplitude_mm * 1e-3, damping_ratio, shake_s, decay_s)
    with listener(console(), verbose) as progress:
        film_config(source, out, shot, seed, progress)
    typer.echo(str(out))

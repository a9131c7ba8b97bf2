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
            help="experiment.toml with beam, camera and markers; or the folder of a finished run.",
        ),
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="Video to write.")],
    recording: Annotated[
        str | None, typer.Option(help="Recording of a finished run to simulate and render.")
    ] = None,
    mode: Annotated[int, typer.Option(min=1, help="Mode to excite.")] = 1,
    tip_amplitude_mm: Annotated[float, typer.Option(min=0.0, help="Steady amplitude of the tip.")] = 1.0,
    damping_ratio: Annotated[
        float, typer.Option(min=0.0, max=0.5, help="Damping ratio of every mode.")
    ] = 0.003,
    shake_s: Annotated[float, typer.Option(min=0.0, help="Steady excitation before the stop.")] = 0.5,
    decay_s: Annotated[float, typer.Option(min=0.0, help="Free decay after the stop.")] = 3.0,
    seed: Seed = 0,
    verbose: Verbose = 0,
) -> None:
    """Render footage of a simulated beam.

    With a configuration, the beam is excited in one mode and then released, in front of the configured camera. With a
    finished run, the updated beam decays from the state fitted to a recording, with the identified damping; the
    options of the excitation do not apply.
    """
    from modalcam.console import listener
    from modalcam.render import film_run
    from modalcam.video.film_beam import film_config
    from sim.render.recording import RecordingPlan

    if source.is_dir():
        options = run_options(source, seed=seed, jobs=1)
        with listener(console(), verbose) as progress:
            film_run(options, recording, out, progress)
        typer.echo(str(out))
        return
    if recording is not None:
        msg = f"--recording: expected the folder of a finished run, found {source}"
        raise ModalcamError(msg)
    plan = RecordingPlan(
        mode_number=mode, tip_amplitude_m=1e-3 * tip_amplitude_mm, shake_s=shake_s, decay_s=decay_s
    )
    with listener(console(), verbose) as progress:
        film_config(source, out, plan, damping_ratio, seed, progress)
    typer.echo(str(out))

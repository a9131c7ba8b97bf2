"""``modalcam identify``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from modalcam.cli.options import Config, Force, Json, Out, Seed, Verbose, conclude, console, run_options
from modalcam.errors import ModalcamError


def identify(
    csv: Annotated[Path, typer.Argument(help="A tracks file, any CSV of time_s and channels, or a .uff.")],
    out: Out,
    config: Config = None,
    mode: Annotated[int | None, typer.Option(min=1, help="Mode that was excited.")] = None,
    frequency: Annotated[
        float | None, typer.Option("--target-hz", min=0.0, help="Frequency of the mode wanted.")
    ] = None,
    onset: Annotated[
        float | None, typer.Option("--onset-s", min=0.0, help="Start of the free decay.")
    ] = None,
    unit: Annotated[str, typer.Option(help="Unit of the channels of a plain CSV.")] = "1",
    seed: Seed = 0,
    force: Force = False,
    json_: Json = False,
    verbose: Verbose = 0,
) -> None:
    """Identify modes from a table of displacements, accelerations or any motion."""
    from modalcam import commands
    from modalcam.config.schema import RecordingConfig
    from modalcam.console import listener

    if mode is not None and frequency is not None:
        msg = "give either --mode or --target-hz, not both"
        raise ModalcamError(msg)
    recording = RecordingConfig(file=csv.name, mode=mode, target_frequency_hz=frequency, onset_s=onset)
    options = run_options(out, config=config, seed=seed, jobs=1, force=force)
    with listener(console(), verbose) as progress:
        result = commands.identify(csv, options, progress, unit=unit, recording=recording)
    conclude(result, out, as_json=json_)

"""``modalcam identify``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from modalcam.cli.options import CONFIG_HELP, Json, Out, Verbose, conclude, console, run_options, takes
from modalcam.errors import ModalcamError


@takes("config", "seed", "force", "plugins")
def identify(
    csv: Annotated[
        Path, typer.Argument(help="Tracks file, CSV of time_s and channels, or universal file (.uff).")
    ],
    out: Out,
    common: dict[str, Any],
    mode: Annotated[int | None, typer.Option(min=1, help=f"{CONFIG_HELP}recordings.mode")] = None,
    frequency: Annotated[
        float | None,
        typer.Option("--target-hz", min=0.0, help=f"{CONFIG_HELP}recordings.target_frequency_hz"),
    ] = None,
    onset: Annotated[
        float | None, typer.Option("--onset-s", min=0.0, help=f"{CONFIG_HELP}recordings.onset_s")
    ] = None,
    unit: Annotated[str, typer.Option(help="Unit of the channels, if the file names none.")] = "1",
    json_: Json = False,
    verbose: Verbose = 0,
) -> None:
    """Identify modes from a table of displacements or other motion."""
    from modalcam import commands
    from modalcam.config.schema import RecordingConfig
    from modalcam.console import listener

    if mode is not None and frequency is not None:
        msg = "give either --mode or --target-hz, not both"
        raise ModalcamError(msg)
    recording = RecordingConfig(file=csv.name, mode=mode, target_frequency_hz=frequency, onset_s=onset)
    options = run_options(out, jobs=1, **common)
    with listener(console(), verbose) as progress:
        result = commands.identify(csv, options, progress, unit=unit, recording=recording)
    conclude(result, out, as_json=json_)

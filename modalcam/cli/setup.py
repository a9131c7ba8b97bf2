"""``modalcam init``, ``check-config`` and ``info``: the configuration and the installation."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from modalcam.cli.options import Replace
from modalcam.files import check_new


def init(
    folder: Annotated[Path, typer.Argument(help="Folder of recordings.")],
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="File to write; default: standard output.")
    ] = None,
    force: Replace = False,
) -> None:
    """Write a commented experiment.toml for a folder of recordings."""
    from modalcam.inputs.probe import starter_config

    text = starter_config(folder)
    if out is None:
        typer.echo(text, nl=False)
        return
    from modalcam.storage.atomic import write_text

    check_new(out, force=force)
    write_text(out, text)


def check_config(config: Annotated[Path, typer.Argument(help="An experiment.toml.")]) -> None:
    """Check a configuration and print it as modalcam reads it."""
    from modalcam.config.toml import dump_config, load_config

    typer.echo(dump_config(load_config(config)), nl=False)


def info() -> None:
    """Print versions and number of processors, for a bug report."""
    import os

    from modalcam.storage.provenance import opencv_wheels, versions

    for name, version in versions():
        typer.echo(f"{name} {version}")
    typer.echo(f"processors {os.cpu_count()}")
    wheels = opencv_wheels()
    if len(wheels) > 1:
        typer.echo(
            f"warning: several OpenCV packages are installed ({', '.join(wheels)}); keep one", err=True
        )

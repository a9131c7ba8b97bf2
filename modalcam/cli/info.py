"""``modalcam info``."""

from __future__ import annotations

import os

import typer


def info() -> None:
    """Print versions and what this machine offers, for a bug report."""
    from modalcam.storage.provenance import opencv_wheels, versions

    for name, version in versions():
        typer.echo(f"{name} {version}")
    typer.echo(f"processors {os.cpu_count()}")
    wheels = opencv_wheels()
    if len(wheels) > 1:
        typer.echo(
            f"warning: several OpenCV packages are installed ({', '.join(wheels)}); keep one", err=True
        )

"""``modalcam init``, ``check-config``, ``verify`` and ``info``: configuration, results and installation."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from modalcam.cli.options import Replace
from modalcam.errors import ConfigError, ExitCode
from modalcam.files import check_new
from modalcam.names import for_terminal, shown


def init(
    folder: Annotated[Path, typer.Argument(help="Folder of recordings.")],
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="File to write; default: standard output.")
    ] = None,
    force: Replace = False,
) -> None:
    """Write a commented experiment.toml for a folder of recordings."""
    from modalcam.execution import worker_pool
    from modalcam.inputs import starter_config

    with worker_pool(1) as pool:
        text = starter_config(folder, each=pool.map)
    if out is None:
        typer.echo(text, nl=False)
        return
    from modalcam.storage import write_text

    check_new(out, force=force)
    write_text(out, text)


def check_config(config: Annotated[Path, typer.Argument(help="An experiment.toml.")]) -> None:
    """Check a configuration and print it as modalcam reads it."""
    from modalcam.config import dump_config, load_config, unusable_recordings

    read = load_config(config)
    typer.echo(dump_config(read), nl=False)
    if unusable := unusable_recordings(read):
        msg = f"{shown(str(config))}: {'; '.join(unusable)}"
        raise ConfigError(msg)


def verify(
    out: Annotated[Path, typer.Argument(help="Folder of results.")],
    folder: Annotated[
        Path | None,
        typer.Argument(metavar="[FOLDER]", help="Folder of the recordings, to compare them, too."),
    ] = None,
) -> None:
    """Compare OUT, and the recordings, with the hashes of the run."""
    from modalcam.storage import changed_files, changed_recordings

    number, changes = changed_files(out)
    if folder is not None:
        more, others = changed_recordings(out, folder)
        number, changes = number + more, [*changes, *others]
    for change in changes:
        typer.echo(for_terminal(change))
    typer.echo(f"{number - len(changes)} of {number} files are those of the run")
    raise typer.Exit(ExitCode.PARTIAL if changes else ExitCode.OK)


def info() -> None:
    """Print versions, processor and BLAS, for a bug report."""
    import os

    from modalcam.storage import opencv_wheels, processor, versions

    for name, version in (*versions(), *processor()):
        typer.echo(f"{name} {version}")
    typer.echo(f"processors {os.cpu_count()}")
    wheels = opencv_wheels()
    if len(wheels) > 1:
        typer.echo(
            f"warning: several OpenCV packages are installed ({', '.join(wheels)}); keep one", err=True
        )

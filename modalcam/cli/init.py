"""``modalcam init``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from modalcam.errors import ModalcamError


def init(
    folder: Annotated[Path, typer.Argument(help="Folder of recordings.")],
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="File to write; default: standard output.")
    ] = None,
) -> None:
    """Write an experiment.toml with every option explained and what the recordings tell."""
    from modalcam.inputs.starter import starter_config

    text = starter_config(folder)
    if out is None:
        typer.echo(text, nl=False)
        return
    from modalcam.storage.atomic import write_text

    if out.exists():
        msg = f"{out}: exists already; give another file with -o"
        raise ModalcamError(msg)
    write_text(out, text)

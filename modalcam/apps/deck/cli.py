"""``modalcam deck``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from modalcam.cli import Replace, ToFile, register_command, takes
from modalcam.common import check_new, shown


@takes("plugins")
def deck(
    source: Annotated[Path, typer.Argument(metavar="OUT", help="Folder of a finished run.")],
    code: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="abaqus, ansys, calculix, chrono, code_aster, exudyn, mbdyn, nastran, opensees or optistruct.",
        ),
    ],
    common: dict[str, Any],
    out: ToFile = None,
    force: Replace = False,
) -> None:
    """Print the damping as input of a simulation code."""
    from modalcam.apps.deck.codes import deck as written
    from modalcam.apps.deck.damping import damping_of
    from modalcam.pipeline import load_run, write_text

    if out is not None:
        check_new(out, force=force)
    text = written(damping_of(load_run(source, tuple(common["plugins"] or ()))), code)
    if out is None:
        typer.echo(text, nl=False)
    else:
        write_text(out, text)
        typer.echo(shown(str(out)))


register_command(deck)

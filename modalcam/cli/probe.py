"""``modalcam probe``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from modalcam.cli.options import Json, Links
from modalcam.errors import ExitCode


def probe(
    folder: Annotated[
        Path, typer.Argument(metavar="FILE|FOLDER", help="Recording, or folder of recordings.")
    ],
    follow_symlinks: Links = False,
    json_: Json = False,
) -> None:
    """Tell what the recordings are, without tracking them."""
    from modalcam.inputs.probe import probe_folder, show_probes

    probes = probe_folder(folder, follow_symlinks=follow_symlinks)
    show_probes(probes, Console(), as_json=json_)
    raise typer.Exit(ExitCode.OK if all(p.problem == "" for p in probes) else ExitCode.PARTIAL)

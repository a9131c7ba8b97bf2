"""``modalcam studio`` and ``modalcam pick``: markers set by clicks in the browser."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from modalcam.cli import NamedOut, register_command, results_folder
from modalcam.common import InputError, ModalcamError, for_terminal, shown

NoBrowser = Annotated[
    bool, typer.Option("--no-browser", help="Only print the address, without opening the browser.")
]


def studio(
    folder: Annotated[Path, typer.Argument(help="Folder of recordings.")],
    out: NamedOut = None,
    no_browser: NoBrowser = False,
) -> None:
    """Set markers, run and read the report in the browser."""
    _check_installed()
    from modalcam.apps.studio.server import serve
    from modalcam.apps.studio.session import Studio, pools
    from modalcam.apps.studio.views import build_page

    results = out or results_folder(folder)
    with pools() as processes:
        session = Studio(folder, results, processes)
        typer.echo(f"results in {shown(str(results))}; Ctrl-C ends the studio", err=True)
        try:
            serve(session, build_page, typer.echo, browser=not no_browser)
        finally:
            session.runner.close()
    if session.draft.is_changed:
        typer.echo("unsaved changes are kept in the folder of the results", err=True)


def pick(
    file: Annotated[Path, typer.Argument(help="Recording.")],
    out: Annotated[
        Path | None,
        typer.Option(
            "-o", "--out", help="experiment.toml to edit; default: the points are printed at the end."
        ),
    ] = None,
    no_browser: NoBrowser = False,
) -> None:
    """Set the markers of one recording by clicks in the browser."""
    _check_installed()
    from modalcam.apps.studio.server import serve
    from modalcam.apps.studio.session import Studio, pools
    from modalcam.apps.studio.views import build_pick_page

    if not file.exists():
        msg = f"{shown(str(file))}: no such file; give a recording"
        raise InputError(msg)
    with pools() as processes:
        session = Studio(file.absolute().parent, None, processes, only=file.name, config=out)
        # Standard output is for the points alone.
        serve(session, build_pick_page, partial(typer.echo, err=True), browser=not no_browser)
    if out is None:
        typer.echo(session.draft.text, nl=False)
    elif session.draft.is_changed:
        typer.echo(f"not saved in {shown(str(out))}:\n{for_terminal(session.draft.difference())}", err=True)


def _check_installed() -> None:
    try:
        import nicegui  # noqa: F401 - whether it can be imported
        import tomlkit  # noqa: F401
    except ImportError as error:
        msg = f"the studio needs the package {error.name}; install it with pip install nicegui tomlkit"
        raise ModalcamError(msg) from None


register_command(studio, "Before a run")
register_command(pick, "Before a run")

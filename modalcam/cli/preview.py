"""``modalcam preview``: the line of a recording in an identified mode, its motion exaggerated."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from modalcam.cli.options import Replace
from modalcam.errors import InputError, ModalcamError
from modalcam.files import check_new


def preview(
    source: Annotated[Path, typer.Argument(metavar="OUT", help="Folder of a finished run.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Film to write: .mp4, .mkv or .mov.")],
    recording: Annotated[str | None, typer.Option(help="Recording of the run, if it holds several.")] = None,
    mode: Annotated[int | None, typer.Option(min=1, help="Number of the mode; default: the target.")] = None,
    exaggerate: Annotated[
        float | None,
        typer.Option(
            min=1e-3,
            max=1e6,
            metavar="FACTOR",
            help="Factor on the motion at the start of the fit; default: up to 8 % of the line's length.",
        ),
    ] = None,
    force: Replace = False,
) -> None:
    """Film a beam in an identified mode, its motion exaggerated.

    The recording is one of a line (kind = "line").
    """
    from modal_id import Identification
    from modalcam.pipeline import load_run
    from modalcam.render import chosen_recording
    from modalcam.report.derived import shown_mode
    from modalcam.report.style import mode_name
    from modalcam.video import ExaggeratedFilm, check_suffix, exaggerated_film, write_film
    from tracker import MarkerTracks

    check_suffix(out, "--out")
    check_new(out, force=force)
    one = chosen_recording(load_run(source).recordings, recording, source)
    found, tracks = one.identification, one.tracks
    if not isinstance(found, Identification) or not isinstance(tracks, MarkerTracks):
        msg = f"{one.name}: {one.failure or 'it was not recorded with a camera'}"
        raise ModalcamError(msg)
    picked = shown_mode(found) if mode is None else next((m for m in found.modes if m.number == mode), None)
    if picked is None:
        numbers = (
            ", ".join(str(m.number) for m in found.modes if m.number is not None) or "none with a number"
        )
        msg = f"{one.name}: mode {mode or ''} was not identified; its modes are {numbers}"
        raise InputError(msg)
    made = exaggerated_film(tracks, found, picked, exaggerate)
    if not isinstance(made, ExaggeratedFilm):
        msg = f"{one.name}: {made.reason}"
        raise ModalcamError(msg)
    write_film(out, made, mode_name(picked))
    typer.echo(f"{out}: motion x {made.factor:g}")

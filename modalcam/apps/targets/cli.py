"""``modalcam markers`` and ``modalcam calibrate``: markers to print, and the lens from images of a printed board."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from modalcam.cli import Replace, register_command
from modalcam.common import check_new

Dictionary = Annotated[str, typer.Option(help="ArUco dictionary of OpenCV.")]
SquareSide = Annotated[float, typer.Option(help="Side of a square of the board.")]
MarkerSide = Annotated[float, typer.Option(help="Side of a marker of the board.")]


def markers(
    out: Annotated[Path, typer.Option("-o", "--out", help="File to write: .svg of one page, or .pdf.")],
    ids: Annotated[str, typer.Option(help="ArUco ids, such as 0-5,8.")] = "0-9",
    dots: Annotated[
        int | None, typer.Option(min=1, max=10_000, help="Number of dots, instead of ArUco markers.")
    ] = None,
    size_mm: Annotated[float, typer.Option(help="Side of the black square, or diameter of a dot.")] = 20.0,
    dictionary: Dictionary = "DICT_4X4_50",
    quiet_mm: Annotated[
        float | None, typer.Option(help="White border; default: 1.5 cells, or half a diameter.")
    ] = None,
    page: Annotated[str, typer.Option(help="Paper size: a4 or letter.")] = "a4",
    board: Annotated[
        str | None, typer.Option(help="ChArUco board for calibrate, squares across x down: 7x5.")
    ] = None,
    square_mm: SquareSide = 30.0,
    marker_mm: MarkerSide = 22.0,
    force: Replace = False,
) -> None:
    """Write markers or a calibration board to print at true scale."""
    from modalcam.apps.targets.targets import (
        aruco_pages,
        board_page,
        dot_pages,
        parse_ids,
        parse_squares,
        save_pages,
    )
    from tracker.geometry import Board

    check_new(out, force=force)
    if board is not None:
        across, down = parse_squares(board, "--board")
        pages = [board_page(Board(across, down, square_mm, marker_mm, dictionary), page)]
    elif dots is None:
        pages = aruco_pages(parse_ids(ids), size_mm, dictionary, quiet_mm, page)
    else:
        pages = dot_pages(dots, size_mm, quiet_mm, page)
    save_pages(out, pages)
    typer.echo(str(out))


def calibrate(
    folder: Annotated[Path, typer.Argument(help="Folder of images of a ChArUco board.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="File to write, such as camera.toml.")],
    squares: Annotated[str, typer.Option(help="Squares of the board, across x down.")] = "7x5",
    square_mm: SquareSide = 30.0,
    marker_mm: MarkerSide = 22.0,
    dictionary: Dictionary = "DICT_4X4_50",
    force: Replace = False,
) -> None:
    """Determine the lens distortion from images of a board."""
    from functools import partial

    from modalcam.apps.targets.targets import calibrate_folder, lines, parse_squares, write_lens
    from modalcam.common import InputError
    from modalcam.pipeline import TaskFailure, worker_pool
    from tracker.geometry import Board

    check_new(out, force=force)
    across, down = parse_squares(squares)
    board = Board(across, down, square_mm, marker_mm, dictionary)
    # In another process: an image may be made to need any time or memory.
    with worker_pool(1) as pool:
        (found,) = pool.map(partial(calibrate_folder, board=board), [folder])
    if isinstance(found, TaskFailure):
        raise InputError(found.reason)
    write_lens(out, found)
    for line in lines(found):
        typer.echo(line)


register_command(markers, "Before a run")
register_command(calibrate, "Before a run")

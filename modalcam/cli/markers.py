"""``modalcam markers``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def markers(
    out: Annotated[Path, typer.Option("-o", "--out", help="File to write: .svg, or .pdf for any number.")],
    ids: Annotated[str, typer.Option(help="ArUco ids, such as 0-5,8.")] = "0-9",
    dots: Annotated[int | None, typer.Option(min=1, help="So many round dots instead of ArUco.")] = None,
    size_mm: Annotated[float, typer.Option(help="Side of the black square, or diameter of a dot.")] = 20.0,
    dictionary: Annotated[str, typer.Option(help="OpenCV's ArUco dictionary.")] = "DICT_4X4_50",
    quiet_mm: Annotated[
        float | None, typer.Option(help="White border; default: 1.5 cells, or half a dot.")
    ] = None,
    page: Annotated[str, typer.Option(help="Paper: a4 or letter.")] = "a4",
    board: Annotated[
        str | None, typer.Option(help="A ChArUco board for calibrate instead, squares across x down: 7x5.")
    ] = None,
    square_mm: Annotated[float, typer.Option(help="Side of a square of the board.")] = 30.0,
    marker_mm: Annotated[float, typer.Option(help="Side of a marker of the board.")] = 22.0,
) -> None:
    """Write a sheet of markers, or a board for the lens, to print at true scale with a ruler."""
    from modalcam.targets.board import board_page, parse_squares
    from modalcam.targets.markers import aruco_request, dots_request, marker_pages, parse_ids
    from modalcam.targets.sheet import save_pages
    from tracker.geometry.charuco import Board

    if board is not None:
        across, down = parse_squares(board, "--board")
        pages = [board_page(Board(across, down, square_mm, marker_mm, dictionary), page)]
    elif dots is None:
        pages = marker_pages(aruco_request(parse_ids(ids), size_mm, dictionary, quiet_mm, page))
    else:
        pages = marker_pages(dots_request(dots, size_mm, quiet_mm, page))
    save_pages(out, pages)
    typer.echo(str(out))

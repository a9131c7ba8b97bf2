"""``modalcam calibrate``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def calibrate(
    folder: Annotated[Path, typer.Argument(help="Folder of pictures of a ChArUco board.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="File to write, such as camera.toml.")],
    squares: Annotated[str, typer.Option(help="Squares of the board, across x down.")] = "7x5",
    square_mm: Annotated[float, typer.Option(help="Side of a square.")] = 30.0,
    marker_mm: Annotated[float, typer.Option(help="Side of a marker.")] = 22.0,
    dictionary: Annotated[str, typer.Option(help="OpenCV's ArUco dictionary.")] = "DICT_4X4_50",
) -> None:
    """Find the lens distortion from pictures of a ChArUco board, as `modalcam markers --board` prints it."""
    from modalcam.targets.board import parse_squares
    from modalcam.targets.calibrate import calibrate_folder, lines, write_lens
    from tracker.geometry.charuco import Board

    across, down = parse_squares(squares)
    found = calibrate_folder(folder, Board(across, down, square_mm, marker_mm, dictionary))
    write_lens(out, found)
    for line in lines(found):
        typer.echo(line)

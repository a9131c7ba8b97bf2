"""Lens calibration: a ChArUco board to print at true scale, and `modalcam calibrate` from images of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import cv2
import numpy as np
import tomli_w
from matplotlib.axes import Axes
from numpy.typing import NDArray

from modalcam.apps.targets.targets import (
    HEAD_MM,
    MARGIN_MM,
    aruco_dictionary,
    cell_boxes,
    draw_boxes,
    marker_cells,
    new_page,
    paper_size,
)
from modalcam.common import InputError, ModalcamError, shown
from modalcam.pipeline import write_text
from tracker.geometry import Board, LensCalibration, calibrate_lens
from tracker.video import IMAGE_SUFFIXES, ImageFiles, UnreadableVideoError


def check_board(board: Board) -> None:
    """Refuse a board that cannot exist: too few markers or squares, or markers that do not fit in their squares."""
    book = aruco_dictionary(board.dictionary)
    if min(board.squares_x, board.squares_y) < 3:
        msg = f"--squares: expected 3 or more in each direction, found {board.squares_x}x{board.squares_y}"
        raise ModalcamError(msg)
    if not 0.0 < board.marker_mm < board.square_mm < float("inf"):
        msg = (
            f"expected 0 < --marker-mm < --square-mm, found {board.marker_mm:g} mm and {board.square_mm:g} mm"
        )
        raise ModalcamError(msg)
    needed, available = board.squares_x * board.squares_y // 2, book.bytesList.shape[0]
    if needed > available:
        msg = (
            f"--board: {board.squares_x}x{board.squares_y} squares need {needed} markers, {board.dictionary} has "
            f"{available}; give fewer squares or a larger dictionary"
        )
        raise ModalcamError(msg)


def parse_squares(text: str, option: str = "--squares") -> tuple[int, int]:
    """Squares across and down from ``7x5``, the text of an option."""
    parts = text.lower().split("x")
    if len(parts) != 2 or not all(part.isdecimal() and len(part) < 4 for part in parts):
        msg = f"{option}: expected the number of squares across and down, such as 7x5; found {text!r}"
        raise ModalcamError(msg)
    return int(parts[0]), int(parts[1])


def board_page(board: Board, page: str) -> Axes:
    """The board on one page, in landscape format if that is needed; ModalcamError if it does not fit on the paper."""
    check_board(board)
    portrait_mm = np.array(paper_size(page))
    board_mm = np.array([board.squares_x, board.squares_y]) * board.square_mm
    taken_mm = np.array([2.0 * MARGIN_MM, 2.0 * MARGIN_MM + HEAD_MM])
    sheets = [portrait_mm, portrait_mm[::-1]]
    fitting = [sheet for sheet in sheets if np.all(board_mm <= sheet - taken_mm + 1e-9)]
    if not fitting:
        available = " or ".join("{:g} x {:g} mm".format(*(sheet - taken_mm)) for sheet in sheets)
        msg = (
            f"a board of {board_mm[0]:g} x {board_mm[1]:g} mm does not fit on {page.upper()} paper, which holds "
            f"{available}; give a smaller --square-mm"
        )
        raise ModalcamError(msg)
    title = (
        f"ChArUco board --squares {board.squares_x}x{board.squares_y} --square-mm {board.square_mm:g} "
        f"--marker-mm {board.marker_mm:g} --dictionary {board.dictionary}"
    )
    width, height = fitting[0].tolist()
    sheet = new_page(width, height, title, "multiply both lengths")
    draw_boxes(sheet, _board_boxes(board))
    return sheet


def _board_boxes(board: Board) -> list[tuple[float, float, float, float]]:
    """Black squares and the markers between them, at the positions of OpenCV's own board."""
    left_mm, top_mm = MARGIN_MM, MARGIN_MM + HEAD_MM
    book, side = aruco_dictionary(board.dictionary), board.square_mm
    drawn = cv2.aruco.CharucoBoard((board.squares_x, board.squares_y), side, board.marker_mm, book)
    boxes = [
        (left_mm + column * side, top_mm + row * side, side, side)
        for row in range(board.squares_y)
        for column in range(board.squares_x)
        if (row + column) % 2 == 0
    ]
    for marker_id, corners in zip(np.ravel(drawn.getIds()), drawn.getObjPoints(), strict=True):
        x, y = np.min(np.asarray(corners)[:, :2], axis=0).tolist()
        boxes += cell_boxes(marker_cells(book, int(marker_id)), left_mm + x, top_mm + y, board.marker_mm)
    return boxes


def calibrate_folder(folder: Path, board: Board) -> LensCalibration:
    """Lens from the images of a folder.

    ModalcamError if the board cannot exist, InputError if the folder or its images cannot be read or the board is not
    detected well enough.
    """
    check_board(board)
    where = shown(str(folder))
    if not folder.is_dir():
        msg = f"{where}: expected a folder of images of a ChArUco board"
        raise InputError(msg)
    paths = sorted(p for p in folder.iterdir() if p.is_file() and p.suffix.lower() in IMAGE_SUFFIXES)
    if not paths:
        msg = f"{where}: no images ({', '.join(IMAGE_SUFFIXES)}) in it"
        raise InputError(msg)
    found = calibrate_lens(_images(paths), board)
    if not isinstance(found, LensCalibration):
        msg = f"{where}: {found.reason}"
        raise InputError(msg)
    return found


def write_lens(path: Path, found: LensCalibration) -> None:
    """Write the lens as TOML, whole or not at all."""
    lens, sd = found.lens, found.sd
    values = {
        **asdict(lens),
        "focal_sd_px": list(sd[:2]),
        "centre_sd_px": list(sd[2:4]),
        "distortion_sd": list(sd[4:]),
        "pictures": len(found.used),
    }
    head = (
        '# Lens calibration of modalcam: give this file as lens = "..." under [camera] of experiment.toml.\n'
    )
    write_text(path, head + tomli_w.dumps(values))


def lines(found: LensCalibration) -> tuple[str, ...]:
    """Result of the calibration, one line per quantity."""
    lens, sd = found.lens, found.sd
    named = zip(("k1", "k2", "p1", "p2"), lens.distortion, sd[4:], strict=False)
    facts = [
        f"{len(found.used)} images used, rms reprojection error {lens.rms_px:.3g} px",
        f"focal length {lens.focal_px[0]:.2f} ± {sd[0]:.2g}, {lens.focal_px[1]:.2f} ± {sd[1]:.2g} px",
        f"centre {lens.centre_px[0]:.2f} ± {sd[2]:.2g}, {lens.centre_px[1]:.2f} ± {sd[3]:.2g} px",
        *(f"{name} {value:.4g} ± {value_sd:.2g}" for name, value, value_sd in named),
    ]
    if found.left_out:
        facts.append("left out (board not detected well enough): " + ", ".join(map(shown, found.left_out)))
    return tuple(facts)


def _images(paths: list[Path]) -> Iterator[tuple[str, NDArray[np.uint8]]]:
    for path in paths:
        # Each by itself: a folder may mix kinds. An image over the limit of pixels is refused before it is decoded.
        reader = ImageFiles()
        try:
            image = reader.read(path)
        except UnreadableVideoError as error:
            raise InputError(str(error)) from error
        if image is None or reader.kind is None:
            msg = f"{shown(path.name)}: expected an image; remove the file or export it again"
            raise InputError(msg)
        yield path.name, (image >> (reader.kind.bit_depth - 8)).astype(np.uint8)

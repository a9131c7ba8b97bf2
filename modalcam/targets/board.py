"""A ChArUco board to print at true scale, for `modalcam calibrate`."""

from __future__ import annotations

import cv2
import numpy as np
from matplotlib.axes import Axes

from modalcam.errors import ModalcamError
from modalcam.targets.markers import aruco_dictionary, marker_cells
from modalcam.targets.sheet import HEAD_MM, MARGIN_MM, cell_boxes, draw_boxes, new_page, paper_size
from tracker.geometry import Board


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

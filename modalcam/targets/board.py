"""A printable ChArUco board at true scale, for `modalcam calibrate`."""

from __future__ import annotations

import cv2
import numpy as np

from modalcam.errors import ModalcamError
from modalcam.targets.calibrate import check_board
from modalcam.targets.drawing import Box, Item, Page, Shape
from modalcam.targets.markers import HEAD_MM, MARGIN_MM, PAPERS, PaperName, head, marker_cells
from tracker.geometry.charuco import Board


def board_page(board: Board, paper: PaperName) -> Page:
    """The board on one page, on its side where that is what it takes.

    Raises
    ------
    ModalcamError
        If the board cannot be one, needs more markers than its dictionary has, or does not fit on the paper.
    """
    check_board(board)
    book = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    needed = board.squares_x * board.squares_y // 2
    if needed > book.bytesList.shape[0]:
        msg = (
            f"--board: {board.squares_x}x{board.squares_y} squares need {needed} markers, {board.dictionary} has "
            f"{book.bytesList.shape[0]}; give fewer squares or a larger dictionary"
        )
        raise ModalcamError(msg)
    wide, high = board.squares_x * board.square_mm, board.squares_y * board.square_mm
    sheet = next((p for p in _sheets(paper) if _fits(wide, high, p)), None)
    if sheet is None:
        msg = (
            f"a board of {wide:g} x {high:g} mm does not fit on {paper.upper()} paper, which holds "
            f"{' or '.join(f'{w - 2 * MARGIN_MM:g} x {h - 2 * MARGIN_MM - HEAD_MM:g} mm' for w, h in _sheets(paper))}; "
            "give a smaller --square-mm"
        )
        raise ModalcamError(msg)
    title = (
        f"ChArUco board --squares {board.squares_x}x{board.squares_y} --square-mm {board.square_mm:g} "
        f"--marker-mm {board.marker_mm:g} --dictionary {board.dictionary}"
    )
    items: list[Item] = head(title, "multiply both lengths")
    items.append(Shape(_board_boxes(board)))
    return Page(*sheet, tuple(items))


def _sheets(paper: PaperName) -> tuple[tuple[float, float], tuple[float, float]]:
    width, height = PAPERS[paper]
    return (width, height), (height, width)


def _fits(wide_mm: float, high_mm: float, sheet_mm: tuple[float, float]) -> bool:
    room = sheet_mm[0] - 2.0 * MARGIN_MM + 1e-9, sheet_mm[1] - 2.0 * MARGIN_MM - HEAD_MM + 1e-9
    return wide_mm <= room[0] and high_mm <= room[1]


def _board_boxes(board: Board) -> tuple[Box, ...]:
    """Black squares and the markers between them, where OpenCV's own board has them."""
    book = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    drawn = cv2.aruco.CharucoBoard((board.squares_x, board.squares_y), board.square_mm, board.marker_mm, book)
    left, top, side = MARGIN_MM, MARGIN_MM + HEAD_MM, board.square_mm
    boxes = [
        Box(left + col * side, top + row * side, side, side)
        for row in range(board.squares_y)
        for col in range(board.squares_x)
        if (row + col) % 2 == 0
    ]
    for marker_id, corners in zip(np.ravel(drawn.getIds()), drawn.getObjPoints(), strict=True):
        x, y = (float(v) for v in np.min(np.asarray(corners)[:, :2], axis=0))
        boxes += marker_cells(board.dictionary, int(marker_id), left + x, top + y, board.marker_mm)
    return tuple(boxes)

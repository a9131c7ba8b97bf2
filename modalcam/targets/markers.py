"""Sheets of ArUco markers or dots to print at true scale."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from modalcam.errors import ModalcamError
from modalcam.targets.sheet import (
    HEAD_MM,
    MARGIN_MM,
    cell_boxes,
    draw_boxes,
    draw_disc,
    draw_frame,
    new_page,
    paper_size,
    write_text,
)
from tracker.markers.aruco import dictionary_names

LABEL_MM = 3.0
MAX_MARKERS = 10_000


@dataclass(frozen=True)
class SheetRequest:
    """Markers to print.

    Attributes
    ----------
    names : tuple of str
        Label under each marker; for ArUco ``id0`` and so on.
    ids : tuple of int or None
        ArUco ids, or None for dots.
    size_mm : float
        Side of the black square, or diameter of a dot.
    quiet_mm : float
        Width of the white border, without which a marker is not detected.
    page : str
        Paper size.
    """

    names: tuple[str, ...]
    ids: tuple[int, ...] | None
    size_mm: float
    quiet_mm: float
    page: str = "a4"
    dictionary: str = "DICT_4X4_50"


def aruco_request(
    ids: tuple[int, ...], size_mm: float, dictionary: str, quiet_mm: float | None, page: str
) -> SheetRequest:
    """Request for ArUco markers; the default quiet zone is a cell and a half.

    Raises
    ------
    ModalcamError
        If the dictionary is unknown or lacks an id.
    """
    book = aruco_dictionary(dictionary)
    count = book.bytesList.shape[0]
    bad = [i for i in ids if not 0 <= i < count]
    if bad:
        msg = f"--ids: {dictionary} has ids 0 to {count - 1}, found {', '.join(map(str, bad))}"
        raise ModalcamError(msg)
    quiet = 1.5 * size_mm / (book.markerSize + 2) if quiet_mm is None else quiet_mm
    return SheetRequest(tuple(f"id{i}" for i in ids), ids, size_mm, quiet, page, dictionary)


def dots_request(count: int, diameter_mm: float, quiet_mm: float | None, page: str) -> SheetRequest:
    """Request for dots; the default quiet zone is half a diameter."""
    quiet = 0.5 * diameter_mm if quiet_mm is None else quiet_mm
    return SheetRequest(tuple(f"m{k + 1}" for k in range(count)), None, diameter_mm, quiet, page)


def parse_ids(text: str) -> tuple[int, ...]:
    """Ids from ``0-5,8``: in the order given, each once.

    Raises
    ------
    ModalcamError
        If the text is not such a list.
    """
    ids: list[int] = []
    for part in text.split(","):
        ends = part.strip().split("-")
        numbers = all(end.isdecimal() and len(end) < 6 for end in ends)
        if len(ends) > 2 or not numbers or int(ends[-1]) < int(ends[0]):
            msg = f"--ids: expected numbers and ranges such as 0-5,8; found {text!r}"
            raise ModalcamError(msg)
        ids += range(int(ends[0]), int(ends[-1]) + 1)
    return tuple(dict.fromkeys(ids))


def aruco_dictionary(name: str) -> cv2.aruco.Dictionary:
    """Dictionary of OpenCV.

    Raises
    ------
    ModalcamError
        If the name is unknown.
    """
    if name not in dictionary_names():
        msg = f"--dictionary: expected one of {', '.join(dictionary_names())}; found {name!r}"
        raise ModalcamError(msg)
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def marker_cells(book: cv2.aruco.Dictionary, marker_id: int) -> NDArray[np.bool_]:
    """Black cells of an ArUco marker with its border."""
    return np.asarray(cv2.aruco.generateImageMarker(book, marker_id, book.markerSize + 2)) < 128


def marker_pages(request: SheetRequest) -> list[Axes]:
    """Pages with the markers in rows, as many as they need.

    Raises
    ------
    ModalcamError
        If there is no marker, a size is not positive, or one marker does not fit on the paper.
    """
    _check(request)
    width, height = paper_size(request.page)
    pitch = request.size_mm + 2.0 * request.quiet_mm
    row_mm = pitch + LABEL_MM + 1.5
    columns = math.floor((width - 2.0 * MARGIN_MM + 1e-9) / (pitch + 1.0))
    rows = math.floor((height - 2.0 * MARGIN_MM - HEAD_MM + 1e-9) / row_mm)
    if columns < 1 or rows < 1:
        msg = (
            f"a marker of {request.size_mm:g} mm with a quiet zone of {request.quiet_mm:g} mm does not fit on "
            f"{request.page.upper()} paper; give a smaller --size-mm"
        )
        raise ModalcamError(msg)
    kind = "dots of diameter" if request.ids is None else f"{request.dictionary}, black square of"
    pages = []
    for k in range(len(request.names)):
        row, column = divmod(k % (columns * rows), columns)
        if row == column == 0:
            pages.append(new_page(width, height, f"{kind} {request.size_mm:g} mm", "multiply size_mm"))
        _draw_marker(
            pages[-1], request, k, MARGIN_MM + column * (pitch + 1.0), MARGIN_MM + HEAD_MM + row * row_mm
        )
    return pages


def _check(request: SheetRequest) -> None:
    if not 0 < len(request.names) <= MAX_MARKERS:
        msg = f"expected 1 to {MAX_MARKERS} markers, found {len(request.names)}"
        raise ModalcamError(msg)
    if not 0.0 < request.size_mm < math.inf:
        msg = f"--size-mm: expected a positive length in mm, found {request.size_mm:g}"
        raise ModalcamError(msg)
    if not 0.0 <= request.quiet_mm < math.inf:
        msg = f"--quiet-mm: expected a length of 0 mm or more, found {request.quiet_mm:g}"
        raise ModalcamError(msg)


def _draw_marker(page: Axes, request: SheetRequest, k: int, x_mm: float, y_mm: float) -> None:
    pitch = request.size_mm + 2.0 * request.quiet_mm
    draw_frame(page, x_mm, y_mm, pitch)
    if request.ids is None:
        draw_disc(page, x_mm + 0.5 * pitch, y_mm + 0.5 * pitch, request.size_mm)
    else:
        black = marker_cells(aruco_dictionary(request.dictionary), request.ids[k])
        corner = x_mm + request.quiet_mm, y_mm + request.quiet_mm
        draw_boxes(page, cell_boxes(black, *corner, request.size_mm))
    write_text(page, x_mm, y_mm + pitch + LABEL_MM, request.names[k], size_mm=LABEL_MM)

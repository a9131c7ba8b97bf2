"""Sheets of ArUco markers or dots to print at true scale."""

from __future__ import annotations

import math
from collections.abc import Callable

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, Rectangle
from numpy.typing import NDArray

from modalcam.errors import ModalcamError
from modalcam.targets.sheet import (
    HEAD_MM,
    MARGIN_MM,
    POINTS_PER_MM,
    cell_boxes,
    draw_boxes,
    new_page,
    paper_size,
    write_text,
)
from tracker.markers import dictionary_names

LABEL_MM = 3.0
MAX_MARKERS = 10_000

# Draws one of the markers on a page, at the left and top edge of its black square or disc.
Draw = Callable[[Axes, float, float, int], None]


def aruco_pages(
    ids: tuple[int, ...], size_mm: float, dictionary: str, quiet_mm: float | None = None, page: str = "a4"
) -> list[Axes]:
    """Pages of ArUco markers, labelled ``id0`` and so on.

    `size_mm` is the side of the black square, `quiet_mm` the width of the white border without which a marker is not
    detected, by default a cell and a half. ModalcamError if the dictionary is unknown or lacks an id, a length is out
    of range, or a marker does not fit on the paper.
    """
    book = aruco_dictionary(dictionary)
    count = book.bytesList.shape[0]
    bad = [i for i in ids if not 0 <= i < count]
    if bad:
        msg = f"--ids: {dictionary} has ids 0 to {count - 1}, found {', '.join(map(str, bad))}"
        raise ModalcamError(msg)

    def draw(sheet: Axes, left_mm: float, top_mm: float, k: int) -> None:
        draw_boxes(sheet, cell_boxes(marker_cells(book, ids[k]), left_mm, top_mm, size_mm))

    quiet = 1.5 * size_mm / (book.markerSize + 2) if quiet_mm is None else quiet_mm
    title = f"{dictionary}, black square of {size_mm:g} mm"
    return _pages([f"id{i}" for i in ids], draw, size_mm, quiet, page, title)


def dot_pages(count: int, diameter_mm: float, quiet_mm: float | None = None, page: str = "a4") -> list[Axes]:
    """Pages of dots, labelled ``m1`` and so on; the default white border is half a diameter."""
    radius = 0.5 * diameter_mm

    def draw(sheet: Axes, left_mm: float, top_mm: float, _: int) -> None:
        centre = (left_mm + radius, top_mm + radius)
        sheet.add_patch(Circle(centre, radius, facecolor="black", linewidth=0.0))

    quiet = radius if quiet_mm is None else quiet_mm
    title = f"dots of diameter {diameter_mm:g} mm"
    return _pages([f"m{k + 1}" for k in range(count)], draw, diameter_mm, quiet, page, title)


def parse_ids(text: str) -> tuple[int, ...]:
    """Ids from ``0-5,8``: in the order given, each once."""
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
    """Dictionary of OpenCV; ModalcamError if the name is unknown."""
    if name not in dictionary_names():
        msg = f"--dictionary: expected one of {', '.join(dictionary_names())}; found {name!r}"
        raise ModalcamError(msg)
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def marker_cells(book: cv2.aruco.Dictionary, marker_id: int) -> NDArray[np.bool_]:
    """Black cells of an ArUco marker with its border."""
    return np.asarray(cv2.aruco.generateImageMarker(book, marker_id, book.markerSize + 2)) < 128


def _pages(
    labels: list[str], draw: Draw, size_mm: float, quiet_mm: float, page: str, title: str
) -> list[Axes]:
    """The markers in rows with their labels, on as many pages as they need."""
    if not 0 < len(labels) <= MAX_MARKERS:
        msg = f"expected 1 to {MAX_MARKERS} markers, found {len(labels)}"
        raise ModalcamError(msg)
    if not 0.0 < size_mm < math.inf:
        msg = f"--size-mm: expected a positive length in mm, found {size_mm:g}"
        raise ModalcamError(msg)
    if not 0.0 <= quiet_mm < math.inf:
        msg = f"--quiet-mm: expected a length of 0 mm or more, found {quiet_mm:g}"
        raise ModalcamError(msg)
    width, height = paper_size(page)
    pitch = size_mm + 2.0 * quiet_mm
    row_mm = pitch + LABEL_MM + 1.5
    columns = math.floor((width - 2.0 * MARGIN_MM + 1e-9) / (pitch + 1.0))
    rows = math.floor((height - 2.0 * MARGIN_MM - HEAD_MM + 1e-9) / row_mm)
    if columns < 1 or rows < 1:
        msg = (
            f"a marker of {size_mm:g} mm with a quiet zone of {quiet_mm:g} mm does not fit on {page.upper()} paper; "
            "give a smaller --size-mm"
        )
        raise ModalcamError(msg)
    pages: list[Axes] = []
    for k, label in enumerate(labels):
        row, column = divmod(k % (columns * rows), columns)
        if row == column == 0:
            pages.append(new_page(width, height, title, "multiply size_mm"))
        left, top = MARGIN_MM + column * (pitch + 1.0), MARGIN_MM + HEAD_MM + row * row_mm
        # to cut along
        frame = Rectangle(
            (left, top), pitch, pitch, fill=False, edgecolor="0.73", linewidth=0.1 * POINTS_PER_MM
        )
        pages[-1].add_patch(frame)
        draw(pages[-1], left + quiet_mm, top + quiet_mm, k)
        write_text(pages[-1], left, top + pitch + LABEL_MM, label, size_mm=LABEL_MM)
    return pages

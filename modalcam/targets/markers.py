"""Printable sheets of markers at true scale, with a ruler to measure the printer by."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from modalcam.errors import ModalcamError
from modalcam.storage.atomic import replacing, write_text
from modalcam.targets.drawing import Box, Disc, Frame, Item, Label, Page, Shape, pdf_bytes, svg_text
from tracker.markers.aruco import dictionary_names

PaperName = Literal["a4", "letter"]
PAPERS: dict[str, tuple[float, float]] = {"a4": (210.0, 297.0), "letter": (215.9, 279.4)}
MARGIN_MM = 10.0
RULER_MM = 100.0
# Room for the ruler and its text at the top of each page.
HEAD_MM = 24.0
LABEL_MM = 3.0
MOST_MARKERS = 10_000


@dataclass(frozen=True)
class SheetRequest:
    """What to print.

    Attributes
    ----------
    names : tuple of str
        Under each marker; for ArUco ``id0`` and so on.
    ids : tuple of int or None
        ArUco ids, or None for dots.
    size_mm : float
        Side of the black square, or diameter of a dot.
    quiet_mm : float
        White border on each side: without it a marker is not found.
    """

    names: tuple[str, ...]
    ids: tuple[int, ...] | None
    size_mm: float
    quiet_mm: float
    dictionary: str = "DICT_4X4_50"
    paper: PaperName = "a4"


def aruco_request(
    ids: tuple[int, ...], size_mm: float, dictionary: str, quiet_mm: float | None, paper: PaperName
) -> SheetRequest:
    """A request for ArUco markers; the quiet zone is a cell and a half where none is given.

    Raises
    ------
    ModalcamError
        If the dictionary is unknown or lacks an id.
    """
    if dictionary not in dictionary_names():
        msg = f"--dictionary: expected one of {', '.join(dictionary_names())}; found {dictionary!r}"
        raise ModalcamError(msg)
    book = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    count = book.bytesList.shape[0]
    bad = [i for i in ids if not 0 <= i < count]
    if bad:
        msg = f"--ids: {dictionary} has ids 0 to {count - 1}, found {', '.join(map(str, bad))}"
        raise ModalcamError(msg)
    quiet = 1.5 * size_mm / (book.markerSize + 2) if quiet_mm is None else quiet_mm
    return SheetRequest(tuple(f"id{i}" for i in ids), ids, size_mm, quiet, dictionary, paper)


def dots_request(count: int, diameter_mm: float, quiet_mm: float | None, paper: PaperName) -> SheetRequest:
    """A request for dots; the quiet zone is half a diameter where none is given."""
    quiet = 0.5 * diameter_mm if quiet_mm is None else quiet_mm
    return SheetRequest(tuple(f"m{k + 1}" for k in range(count)), None, diameter_mm, quiet, paper=paper)


def paper_name(text: str) -> PaperName:
    """Name of the paper, in any case.

    Raises
    ------
    ModalcamError
        If it is not known.
    """
    match text.lower():
        case "a4":
            return "a4"
        case "letter":
            return "letter"
    msg = f"--page: expected a4 or letter, found {text!r}"
    raise ModalcamError(msg)


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
        if (
            len(ends) > 2
            or not all(e.isdecimal() and len(e) < 6 for e in ends)
            or int(ends[-1]) < int(ends[0])
        ):
            msg = f"--ids: expected numbers and ranges such as 0-5,8; found {text!r}"
            raise ModalcamError(msg)
        ids += range(int(ends[0]), int(ends[-1]) + 1)
    return tuple(dict.fromkeys(ids))


def marker_pages(request: SheetRequest) -> tuple[Page, ...]:
    """The markers in rows, on as many pages as they need.

    Raises
    ------
    ModalcamError
        If there is none, a size is not positive, or one marker does not fit on the paper.
    """
    _check(request)
    width, height = PAPERS[request.paper]
    pitch = request.size_mm + 2.0 * request.quiet_mm
    row_mm = pitch + LABEL_MM + 1.5
    columns = math.floor((width - 2.0 * MARGIN_MM + 1e-9) / (pitch + 1.0))
    rows = math.floor((height - 2.0 * MARGIN_MM - HEAD_MM + 1e-9) / row_mm)
    if columns < 1 or rows < 1:
        msg = (
            f"a marker of {request.size_mm:g} mm with a quiet zone of {request.quiet_mm:g} mm does not fit on "
            f"{request.paper.upper()} paper; give a smaller --size-mm"
        )
        raise ModalcamError(msg)
    kind = "dots of diameter" if request.ids is None else f"{request.dictionary}, black square of"
    title = f"{kind} {request.size_mm:g} mm"
    pages = []
    for first in range(0, len(request.names), columns * rows):
        items: list[Item] = head(title, "multiply size_mm")
        for place, k in enumerate(range(first, min(first + columns * rows, len(request.names)))):
            x = MARGIN_MM + (place % columns) * (pitch + 1.0)
            y = MARGIN_MM + HEAD_MM + (place // columns) * row_mm
            items += _marker(request, k, x, y)
        pages.append(Page(width, height, tuple(items)))
    return tuple(pages)


def write_sheet(path: Path, pages: tuple[Page, ...]) -> None:
    """Write an .svg of one page or a .pdf of any number, whole or not at all.

    Raises
    ------
    ModalcamError
        If the ending is another, or an SVG would need more than one page.
    """
    ending = path.suffix.lower()
    if ending == ".pdf":
        with replacing(path) as beside:
            beside.write_bytes(pdf_bytes(pages))
        return
    if ending != ".svg":
        msg = f"{path}: expected a name that ends in .svg or .pdf"
        raise ModalcamError(msg)
    if len(pages) > 1:
        msg = f"{path}: {len(pages)} pages are needed, and SVG has one; write a .pdf or ask for fewer markers"
        raise ModalcamError(msg)
    write_text(path, svg_text(pages[0]))


def _check(request: SheetRequest) -> None:
    if not 0 < len(request.names) <= MOST_MARKERS:
        msg = f"expected 1 to {MOST_MARKERS} markers, found {len(request.names)}"
        raise ModalcamError(msg)
    if not (math.isfinite(request.size_mm) and request.size_mm > 0):
        msg = f"--size-mm: expected a positive length in mm, found {request.size_mm:g}"
        raise ModalcamError(msg)
    if not (math.isfinite(request.quiet_mm) and request.quiet_mm >= 0):
        msg = f"--quiet-mm: expected a length of 0 mm or more, found {request.quiet_mm:g}"
        raise ModalcamError(msg)


def head(title: str, wrong_scale: str) -> list[Item]:
    """What the sheet is, and a ruler of 100 mm from the outer edge of one end mark to that of the other.

    Parameters
    ----------
    title : str
    wrong_scale : str
        What to do when the ruler does not measure 100 mm.
    """
    y = MARGIN_MM + 11.0
    boxes = [Box(MARGIN_MM, y, RULER_MM, 0.3)]
    for k in range(11):
        # End marks lie within the ruler's length; the others are centred on their millimetre.
        shift = 0.0 if k == 0 else 0.3 if k == 10 else 0.15
        boxes.append(Box(MARGIN_MM + 10.0 * k - shift, y - (4.0 if k in (0, 5, 10) else 2.5), 0.3, 4.0))
    return [
        Label(MARGIN_MM, MARGIN_MM + 3.0, 3.5, f"modalcam markers: {title}"),
        Shape(tuple(boxes)),
        Label(
            MARGIN_MM,
            y + 5.0,
            3.2,
            "Print at 100 % (no fit to page). This ruler must measure 100 mm, outer edge to outer edge;",
        ),
        Label(MARGIN_MM, y + 9.0, 3.2, f"if it does not, {wrong_scale} by the length measured / 100 mm."),
    ]


def _marker(request: SheetRequest, k: int, x_mm: float, y_mm: float) -> list[Item]:
    pitch = request.size_mm + 2.0 * request.quiet_mm
    left, top = x_mm + request.quiet_mm, y_mm + request.quiet_mm
    if request.ids is None:
        radius = 0.5 * request.size_mm
        body: Item = Disc(left + radius, top + radius, request.size_mm)
    else:
        body = Shape(marker_cells(request.dictionary, request.ids[k], left, top, request.size_mm))
    return [
        Frame(Box(x_mm, y_mm, pitch, pitch)),
        body,
        Label(x_mm, y_mm + pitch + LABEL_MM, LABEL_MM, request.names[k]),
    ]


def marker_cells(
    dictionary: str, marker_id: int, left_mm: float, top_mm: float, size_mm: float
) -> tuple[Box, ...]:
    """Runs of black cells of an ArUco marker, row by row."""
    book = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    cells = book.markerSize + 2
    black = np.asarray(cv2.aruco.generateImageMarker(book, marker_id, cells)) < 128
    cell = size_mm / cells
    boxes = []
    for r in range(cells):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], black[r], [False]]).astype(np.int8)))
        boxes += [
            Box(left_mm + a * cell, top_mm + r * cell, (b - a) * cell, cell)
            for a, b in zip(edges[::2], edges[1::2], strict=True)
        ]
    return tuple(boxes)

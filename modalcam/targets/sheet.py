"""Printable pages at true scale: millimetres on paper, a ruler to check the printer, SVG and PDF by matplotlib."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline
from numpy.typing import NDArray

from modalcam.errors import ModalcamError
from modalcam.storage import replacing

PAPERS = {"a4": (210.0, 297.0), "letter": (215.9, 279.4)}
MARGIN_MM = 10.0
# Height of the title and the ruler at the top of each page.
HEAD_MM = 24.0
RULER_MM = 100.0
POINTS_PER_MM = 72.0 / 25.4
# The same request gives the same bytes: plain text in a font that every viewer has, no dates, fixed identifiers.
_STYLE = {
    "path.simplify": False,
    "pdf.compression": 0,
    "pdf.use14corefonts": True,
    "svg.fonttype": "none",
    "svg.hashsalt": "modalcam",
}


def paper_size(name: str) -> tuple[float, float]:
    """Width and height in mm of a paper size, in upper or lower case."""
    if name.lower() not in PAPERS:
        msg = f"--page: expected {' or '.join(PAPERS)}, found {name!r}"
        raise ModalcamError(msg)
    return PAPERS[name.lower()]


def new_page(width_mm: float, height_mm: float, title: str, correction: str) -> Axes:
    """Page whose axes are in millimetres, x right and y down from the top left corner, with title and ruler.

    `correction` says what to do if the ruler does not measure 100 mm.
    """
    figure = Figure(figsize=(width_mm / 25.4, height_mm / 25.4))
    page = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    page.set(xlim=(0.0, width_mm), ylim=(height_mm, 0.0))
    page.axis("off")
    y = MARGIN_MM + 11.0
    boxes = [(MARGIN_MM, y, RULER_MM, 0.3)]
    for k in range(11):
        # End marks lie within the length of the ruler; the others are centred on their millimetre.
        shift = 0.0 if k == 0 else 0.3 if k == 10 else 0.15
        boxes.append((MARGIN_MM + 10.0 * k - shift, y - (4.0 if k in (0, 5, 10) else 2.5), 0.3, 4.0))
    draw_boxes(page, boxes)
    write_text(page, MARGIN_MM, MARGIN_MM + 3.0, f"modalcam markers: {title}", size_mm=3.5)
    check = (
        f"Print at 100 % (no fit to page). This ruler must measure {RULER_MM:g} mm, outer edge to outer edge;"
    )
    write_text(page, MARGIN_MM, y + 5.0, check)
    write_text(
        page, MARGIN_MM, y + 9.0, f"if it does not, {correction} by the length measured / {RULER_MM:g} mm."
    )
    return page


def draw_boxes(page: Axes, boxes: Sequence[tuple[float, float, float, float]]) -> None:
    """Black boxes (left, top, width, height) as one path, so that no seams show between neighbours."""
    outlines = [
        Outline([(x, y), (x + w, y), (x + w, y + h), (x, y + h), (x, y)], closed=True) for x, y, w, h in boxes
    ]
    page.add_patch(PathPatch(Outline.make_compound_path(*outlines), facecolor="black", linewidth=0.0))


def cell_boxes(
    black: NDArray[np.bool_], left_mm: float, top_mm: float, size_mm: float
) -> list[tuple[float, float, float, float]]:
    """Boxes of the black cells of a square pattern."""
    cell = size_mm / black.shape[0]
    return [(left_mm + x * cell, top_mm + y * cell, cell, cell) for y, x in np.argwhere(black).tolist()]


def write_text(page: Axes, x_mm: float, y_mm: float, text: str, *, size_mm: float = 3.2) -> None:
    """One line of text that starts at x, with its base line at y."""
    page.text(x_mm, y_mm, text, fontsize=size_mm * POINTS_PER_MM, parse_math=False)


def save_pages(path: Path, pages: Sequence[Axes]) -> None:
    """Write an .svg of one page or a .pdf of any number, whole or not at all; ModalcamError for any other name."""
    ending = path.suffix.lower()
    if ending not in (".pdf", ".svg"):
        msg = f"{path}: expected a name that ends in .svg or .pdf"
        raise ModalcamError(msg)
    if ending == ".svg" and len(pages) > 1:
        msg = f"{path}: {len(pages)} pages are needed, and an SVG has one; write a .pdf or ask for fewer markers"
        raise ModalcamError(msg)
    buffer = BytesIO()
    style: Any = _STYLE
    figures: list[Any] = [page.figure for page in pages]
    with mpl.rc_context(style):
        if ending == ".svg":
            figures[0].savefig(buffer, format="svg", metadata={"Date": None})
        else:
            with PdfPages(buffer, metadata={"CreationDate": None}) as pdf:
                for page, figure in zip(pages, figures, strict=True):
                    for text in page.texts:
                        # Helvetica, one of the fonts of every viewer, has this weight only.
                        text.set_fontweight("medium")
                    pdf.savefig(figure)
    data = buffer.getvalue()
    with replacing(path) as temporary:
        temporary.write_bytes(_without_scaling(data) if ending == ".pdf" else data)


def _without_scaling(pdf: bytes) -> bytes:
    """The file with the viewer preference that the print dialog proposes 100 %, as an incremental update."""
    number = {key: int(pdf[pdf.rindex(key) :].split()[1]) for key in (b"/Size", b"/Root", b"startxref")}
    root, start = number[b"/Root"], len(pdf) + 1
    head = b"\n%d 0 obj\n<<" % root
    catalog = pdf[pdf.index(head) + len(head) :].partition(b">>\nendobj")[0]
    update = b"%s%s/ViewerPreferences << /PrintScaling /None >> >>\nendobj\n" % (head, catalog)
    table = b"xref\n%d 1\n%010d 00000 n \n" % (root, start)
    entries = (number[b"/Size"], root, number[b"startxref"], len(pdf + update))
    trailer = b"trailer\n<< /Size %d /Root %d 0 R /Prev %d >>\nstartxref\n%d\n%%%%EOF\n" % entries
    return pdf + update + table + trailer

"""Markers and boards to print at true scale, with a ruler to check the printer, and a lens calibrated with a board."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from io import BytesIO
from pathlib import Path
from typing import Any

import cv2
import matplotlib as mpl
import numpy as np
import tomli_w
from matplotlib.axes import Axes
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure
from matplotlib.patches import Circle, PathPatch, Rectangle
from matplotlib.path import Path as Outline
from numpy.typing import NDArray

from modalcam.common import InputError, ModalcamError, shown
from modalcam.pipeline import replacing, write_text
from tracker import checked
from tracker.geometry import Board, LensCalibration, calibrate_lens
from tracker.markers import dictionary_names
from tracker.video import IMAGE_SUFFIXES, ImageFiles, UnreadableVideoError

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
    draw_text(page, MARGIN_MM, MARGIN_MM + 3.0, f"modalcam markers: {title}", size_mm=3.5)
    check = (
        f"Print at 100 % (no fit to page). This ruler must measure {RULER_MM:g} mm, outer edge to outer edge;"
    )
    draw_text(page, MARGIN_MM, y + 5.0, check)
    draw_text(
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


def draw_text(page: Axes, x_mm: float, y_mm: float, text: str, *, size_mm: float = 3.2) -> None:
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
    try:
        checked("--size-mm", size_mm, positive=True)
        checked("--quiet-mm", quiet_mm, at_least=0.0)
    except ValueError as error:
        raise ModalcamError(str(error)) from None
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
        draw_text(pages[-1], left, top + pitch + LABEL_MM, label, size_mm=LABEL_MM)
    return pages


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

"""Marker sheets: what is printed decodes, at the size that was asked for."""

import re
import shutil
import subprocess
import sys
from xml.etree import ElementTree as ET

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from modalcam import cli
from modalcam.errors import ModalcamError
from modalcam.targets.board import board_page
from modalcam.targets.markers import aruco_pages, dot_pages, parse_ids
from modalcam.targets.sheet import save_pages
from tracker.geometry.charuco import Board

SVG = "{http://www.w3.org/2000/svg}"
PX_PER_MM = 8


def sheet(path, ids="0-5,17", size_mm=20.0, dictionary="DICT_4X4_50", quiet_mm=None, paper="a4"):
    save_pages(path, aruco_pages(parse_ids(ids), size_mm, dictionary, quiet_mm, paper))
    return path


def decode(image, dictionary):
    book = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    corners, ids, _ = cv2.aruco.ArucoDetector(book).detectMarkers(image)
    return {int(i): c.reshape(4, 2) for i, c in zip(ids.ravel(), corners, strict=True)}


def outlines(text, commands):
    """Corners in mm of the closed outlines of a path, in a language whose commands follow or precede the numbers."""
    closed = re.split(r"\bz\b|\bh\b", text)
    number = r"(-?[\d.]+) (-?[\d.]+)"
    pattern = rf"[{commands}] {number}" if commands == "ML" else rf"{number} [{commands}]"
    found = [np.array(re.findall(pattern, part), dtype=float) * 25.4 / 72.0 for part in closed]
    return [corners for corners in found if len(corners)]


def black_paths(svg):
    root = ET.parse(svg).getroot()  # noqa: S314 - our own file
    return [p.get("d") for p in root.iter(f"{SVG}path") if "fill" not in p.get("style", "")]


def paint(svg):
    """The sheet as an independent rasteriser of its boxes sees it."""
    root = ET.parse(svg).getroot()  # noqa: S314 - our own file
    assert root.get("width").endswith("pt")
    width, height = (float(root.get(k).removesuffix("pt")) for k in ("width", "height"))
    assert [float(v) for v in root.get("viewBox").split()] == [0.0, 0.0, width, height]
    size = np.round(np.array([height, width]) * 25.4 / 72.0 * PX_PER_MM).astype(int)
    image = np.full(size, 255, np.uint8)
    for path in black_paths(svg):
        for corners in outlines(path, "ML"):
            (left, top), (right, bottom) = np.round(
                np.array([corners.min(0), corners.max(0)]) * PX_PER_MM
            ).astype(int)
            image[top:bottom, left:right] = 0
    return image


@pytest.mark.parametrize(
    ("dictionary", "size_mm", "paper"),
    [("DICT_4X4_50", 20.0, "a4"), ("DICT_6X6_250", 32.0, "letter"), ("DICT_APRILTAG_36h11", 16.0, "a4")],
)
def test_the_svg_decodes_with_sides_of_the_size_asked_for(tmp_path, dictionary, size_mm, paper):
    found = decode(paint(sheet(tmp_path / "a.svg", "0-5,17", size_mm, dictionary, paper=paper)), dictionary)
    assert sorted(found) == [0, 1, 2, 3, 4, 5, 17]
    for corners in found.values():
        sides = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1) / PX_PER_MM
        # Corners without refinement are whole pixels of an eighth of a millimetre, at both ends of a side.
        assert sides == pytest.approx(size_mm, abs=2 / PX_PER_MM)


@pytest.mark.parametrize("ending", ["pdf", "svg"])
def test_other_programs_print_it_at_true_scale(tmp_path, ending):
    tool = shutil.which("pdftoppm" if ending == "pdf" else "chromium")
    if tool is None:
        pytest.skip(f"no program is installed that rasterises {ending}")
    path = sheet(tmp_path / f"a.{ending}")
    dpi = 203.2 if ending == "pdf" else 96.0
    if ending == "pdf":
        subprocess.run([tool, "-r", "203.2", "-gray", "-singlefile", path, tmp_path / "a"], check=True)
        image = cv2.imread(str(tmp_path / "a.pgm"), cv2.IMREAD_GRAYSCALE)
    else:
        shot = tmp_path / "a.png"
        flags = ["--headless", "--no-sandbox", "--disable-gpu", "--window-size=794,1123"]
        command = [tool, *flags, f"--user-data-dir={tmp_path}", f"--screenshot={shot}", path.as_uri()]
        subprocess.run(command, check=True, capture_output=True, timeout=60)
        image = cv2.imread(str(shot), cv2.IMREAD_GRAYSCALE)
    found = decode(image, "DICT_4X4_50")
    assert sorted(found) == [0, 1, 2, 3, 4, 5, 17]
    sides = [np.linalg.norm(c - np.roll(c, 1, axis=0), axis=1) * 25.4 / dpi for c in found.values()]
    # A pixel at both ends of a side.
    assert np.array(sides) == pytest.approx(20.0, abs=2 * 25.4 / dpi)
    dark = np.flatnonzero((image < 128).any(axis=0))
    assert dark[0] * 25.4 / dpi == pytest.approx(10.0, abs=0.6)


def test_the_ruler_measures_100_mm_on_every_page(tmp_path):
    pages = aruco_pages(parse_ids("0-49"), 30.0, "DICT_4X4_50", 5.0, "letter")
    assert len(pages) == 3
    save_pages(tmp_path / "a.pdf", pages)
    text = (tmp_path / "a.pdf").read_bytes().decode("latin-1")
    # a ruler is one path that begins with its bar, 0.3 mm high
    paths = [outlines(part, "ml") for part in re.split(r"[qQ]\b", text)]
    rulers = [np.concatenate(path) for path in paths if path and np.ptp(path[0][:, 1]) < 0.301]
    assert [np.ptp(r[:, 0]) for r in rulers] == pytest.approx([100.0] * 3, abs=1e-5)
    assert text.count("Print at 100 %") == 3
    assert "/PrintScaling /None" in text
    with pytest.raises(ModalcamError, match="3 pages are needed"):
        save_pages(tmp_path / "a.svg", pages)


def test_dots_have_their_diameter(tmp_path):
    path = tmp_path / "dots.svg"
    save_pages(path, dot_pages(12, 8.0, None, "a4"))
    discs = [d for d in black_paths(path) if "C" in d]
    assert len(discs) == 12
    for disc in discs:
        # the ends of the curves, which lie on the circle
        ends = re.findall(r"(-?[\d.]+) (-?[\d.]+)(?= *[Cz])", disc)
        points = np.array(ends, dtype=float) * 25.4 / 72.0
        assert np.ptp(points, axis=0) == pytest.approx(8.0, abs=1e-4)


def test_the_same_request_gives_the_same_bytes(tmp_path):
    first, second = sheet(tmp_path / "a.pdf").read_bytes(), sheet(tmp_path / "b.pdf").read_bytes()
    assert first == second


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"ids": "0-50"}, "has ids 0 to 49"),
        ({"ids": "5-2"}, "such as 0-5,8"),
        ({"size_mm": 300.0}, "does not fit"),
        ({"size_mm": -1.0}, "positive length"),
        ({"quiet_mm": float("nan")}, "0 mm or more"),
        ({"dictionary": "DICT_9X9"}, "expected one of"),
    ],
)
def test_requests_that_cannot_be_printed(tmp_path, options, words):
    with pytest.raises(ModalcamError, match=words):
        sheet(tmp_path / "a.svg", **options)


def test_the_command_writes_the_file_or_says_why_not(tmp_path, monkeypatch, capsys):
    def call(*args):
        monkeypatch.setattr(sys, "argv", ["modalcam", "markers", *map(str, args)])
        with pytest.raises(SystemExit) as info:
            cli.main()
        return info.value.code or 0

    assert call("--dots", 6, "--size-mm", 12, "-o", tmp_path / "d.pdf", "--page", "Letter") == 0
    assert (tmp_path / "d.pdf").read_bytes().startswith(b"%PDF")
    assert call("-o", tmp_path / "d.png") == 2
    assert "ends in .svg or .pdf" in " ".join(capsys.readouterr().err.split())
    assert call("--page", "a3", "-o", tmp_path / "d.pdf") == 2


@pytest.mark.parametrize(
    ("squares", "square_mm", "marker_mm", "dictionary", "paper"),
    [((7, 5), 30.0, 22.0, "DICT_4X4_50", "a4"), ((5, 7), 25.0, 19.0, "DICT_5X5_100", "letter")],
)
def test_the_board_is_the_one_that_calibrate_looks_for(
    tmp_path, squares, square_mm, marker_mm, dictionary, paper
):
    board = Board(*squares, square_mm, marker_mm, dictionary)
    save_pages(tmp_path / "board.svg", [board_page(board, paper)])
    book = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    detector = cv2.aruco.CharucoDetector(cv2.aruco.CharucoBoard(squares, square_mm, marker_mm, book))
    corners, ids, _, found = detector.detectBoard(paint(tmp_path / "board.svg"))
    assert sorted(ids.ravel()) == list(range((squares[0] - 1) * (squares[1] - 1)))
    assert len(found) == squares[0] * squares[1] // 2
    places = {int(i): c / PX_PER_MM for i, c in zip(ids.ravel(), corners.reshape(-1, 2), strict=True)}
    across = places[squares[0] - 2] - places[0]
    # A corner is good to about a pixel of the raster, an eighth of a millimetre, at both ends.
    assert across == pytest.approx([(squares[0] - 2) * square_mm, 0.0], abs=2 / PX_PER_MM)


def test_the_pdf_is_valid_with_its_update(tmp_path):
    data = sheet(tmp_path / "a.pdf").read_bytes()
    start = int(re.search(rb"startxref\n(\d+)\n%%EOF\n$", data)[1])
    table = re.match(rb"xref\n(\d+) 1\n(\d{10}) 00000 n \ntrailer\n<< .* /Prev (\d+) >>", data[start:])
    assert data[int(table[2]) :].startswith(b"%s 0 obj\n<< /Type /Catalog" % table[1])
    assert data[int(table[3]) :].startswith(b"xref\n0 ")


@pytest.mark.parametrize(
    ("board", "words"),
    [
        (Board(9, 7, 30.0, 22.0, "DICT_4X4_50"), "does not fit on A4"),
        (Board(15, 15, 10.0, 8.0, "DICT_4X4_50"), "need 112 markers"),
        (Board(7, 5, 30.0, 30.0, "DICT_4X4_50"), "--marker-mm < --square-mm"),
    ],
)
def test_a_board_that_cannot_be_printed_says_why(board, words):
    with pytest.raises(ModalcamError, match=words):
        board_page(board, "a4")


def test_the_command_writes_a_board(tmp_path):
    out = tmp_path / "board.pdf"
    result = CliRunner().invoke(cli.app, ["markers", "-o", str(out), "--board", "7x5"])
    assert result.exit_code == 0, result.output
    assert out.read_bytes().startswith(b"%PDF")

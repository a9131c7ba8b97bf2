"""`modalcam calibrate`: a lens from a folder of pictures of a ChArUco board, as a file that `[camera] lens` names."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import tomli_w
from numpy.typing import NDArray

from modalcam.errors import InputError, ModalcamError
from modalcam.names import shown
from modalcam.storage.atomic import write_text
from tracker.geometry.charuco import Board, LensCalibration, calibrate_lens
from tracker.markers.aruco import dictionary_names

SUFFIXES = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".bmp")
# Pictures larger than this are refused before they are decoded whole.
MOST_BYTES = 200_000_000


def calibrate_folder(folder: Path, board: Board) -> LensCalibration:
    """Lens from the pictures of a folder.

    Raises
    ------
    InputError
        If the folder or its pictures cannot be read, or the board is not seen well enough.
    ModalcamError
        If the board cannot be one.
    """
    check_board(board)
    if not folder.is_dir():
        msg = f"{shown(str(folder))}: expected a folder of pictures of a ChArUco board"
        raise InputError(msg)
    paths = sorted(p for p in folder.iterdir() if p.is_file() and p.suffix.lower() in SUFFIXES)
    if not paths:
        msg = f"{shown(str(folder))}: no pictures ({', '.join(SUFFIXES)}) in it"
        raise InputError(msg)
    found = calibrate_lens(_pictures(paths), board)
    if not isinstance(found, LensCalibration):
        msg = f"{shown(str(folder))}: {found.reason}"
        raise InputError(msg)
    return found


def write_lens(path: Path, found: LensCalibration) -> None:
    """Write the lens as TOML, whole or not at all."""
    lens, sd = found.lens, found.sd
    values = {
        "width_px": lens.width_px,
        "height_px": lens.height_px,
        "focal_px": list(lens.focal_px),
        "centre_px": list(lens.centre_px),
        "distortion": list(lens.distortion),
        "rms_px": lens.rms_px,
        "focal_sd_px": list(sd[:2]),
        "centre_sd_px": list(sd[2:4]),
        "distortion_sd": list(sd[4:]),
        "pictures": len(found.used),
    }
    head = (
        '# Lens calibration of modalcam: name this file as lens = "..." under [camera] of experiment.toml.\n'
    )
    write_text(path, head + tomli_w.dumps(values))


def lines(found: LensCalibration) -> tuple[str, ...]:
    """What the calibration found, a line a fact."""
    lens, sd = found.lens, found.sd
    named = zip(("k1", "k2", "p1", "p2"), lens.distortion, sd[4:], strict=False)
    facts = [
        f"{len(found.used)} pictures used, rms reprojection error {lens.rms_px:.3g} px",
        f"focal length {lens.focal_px[0]:.2f} ± {sd[0]:.2g}, {lens.focal_px[1]:.2f} ± {sd[1]:.2g} px",
        f"centre {lens.centre_px[0]:.2f} ± {sd[2]:.2g}, {lens.centre_px[1]:.2f} ± {sd[3]:.2g} px",
        *(f"{name} {value:.4g} ± {value_sd:.2g}" for name, value, value_sd in named),
    ]
    if found.left_out:
        facts.append("left out (board not seen well enough): " + ", ".join(map(shown, found.left_out)))
    return tuple(facts)


def _pictures(paths: list[Path]) -> Iterator[tuple[str, NDArray[np.uint8]]]:
    for path in paths:
        if path.stat().st_size > MOST_BYTES:
            msg = f"{shown(path.name)}: expected a picture of at most {MOST_BYTES} bytes"
            raise InputError(msg)
        # Decoded from bytes, as OpenCV's own reader of files fails on some names.
        data = np.frombuffer(path.read_bytes(), dtype=np.uint8)
        flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION
        picture = cv2.imdecode(data, flags) if data.size else None
        if picture is None:
            msg = f"{shown(path.name)}: not a picture that can be read; remove it or export it again"
            raise InputError(msg)
        yield path.name, np.asarray(picture, dtype=np.uint8)


def check_board(board: Board) -> None:
    """Refuse a board that cannot be one.

    Raises
    ------
    ModalcamError
        If the dictionary is unknown, there are fewer than 3 squares each way or a marker does not fit its square.
    """
    if board.dictionary not in dictionary_names():
        msg = f"--dictionary: expected one of {', '.join(dictionary_names())}; found {board.dictionary!r}"
        raise ModalcamError(msg)
    if min(board.squares_x, board.squares_y) < 3:
        msg = f"--squares: expected 3 or more each way, found {board.squares_x}x{board.squares_y}"
        raise ModalcamError(msg)
    if not 0.0 < board.marker_mm < board.square_mm < float("inf"):
        msg = (
            f"expected 0 < --marker-mm < --square-mm, found {board.marker_mm:g} mm and {board.square_mm:g} mm"
        )
        raise ModalcamError(msg)


def parse_squares(text: str, option: str = "--squares") -> tuple[int, int]:
    """Squares across and down from ``7x5``, the text of an option.

    Raises
    ------
    ModalcamError
        If the text is not of that form.
    """
    parts = text.lower().split("x")
    if len(parts) != 2 or not all(part.isdecimal() and len(part) < 4 for part in parts):
        msg = f"{option}: expected the number of squares across and down, such as 7x5; found {text!r}"
        raise ModalcamError(msg)
    return int(parts[0]), int(parts[1])

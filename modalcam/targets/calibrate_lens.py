"""`modalcam calibrate`: lens from images of a ChArUco board, written to a file for `[camera] lens`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import numpy as np
import tomli_w
from numpy.typing import NDArray

from modalcam.errors import InputError
from modalcam.names import shown
from modalcam.storage import write_text
from modalcam.targets.board import check_board
from tracker.geometry import Board, LensCalibration, calibrate_lens
from tracker.video import IMAGE_SUFFIXES, ImageFiles, UnreadableVideoError


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

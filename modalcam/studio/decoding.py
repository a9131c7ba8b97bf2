"""Pictures of frames and their index, made in child processes.

A recording may be made to need any time or memory, and a decoder may crash: nothing is decoded in the process of the
server.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from tracker.video import UnreadableVideoError, frame_stamps, read_frame, to_8_bit


@dataclass(frozen=True)
class Problem:
    """A call without a result; falsy, with the reason."""

    reason: str

    def __bool__(self) -> bool:
        return False


@dataclass(frozen=True)
class FrameTask:
    """A frame to be shown; `stamps` is that of `read_frame`, `width_px` the largest width of the picture."""

    path: Path
    index: int
    stamps: tuple[int | None, ...] = ()
    width_px: int | None = None


def frame_png(task: FrameTask) -> bytes | Problem:
    """PNG of a frame; deep pixels are stretched to 8 bit."""
    try:
        image = to_8_bit(read_frame(task.path, task.index, task.stamps))
    except UnreadableVideoError as error:
        return Problem(str(error))
    height, width = image.shape
    if task.width_px is not None and width > task.width_px:
        size = (task.width_px, max(1, round(height * task.width_px / width)))
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    # Fast rather than small: it stays on this machine.
    written, data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    return data.tobytes() if written else Problem(f"frame {task.index} could not be written as a picture")


def stamps_of(path: Path) -> tuple[int | None, ...] | Problem:
    """Time stamps of all frames, for `FrameTask`."""
    try:
        return frame_stamps(path)
    except UnreadableVideoError as error:
        return Problem(str(error))

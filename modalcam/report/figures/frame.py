"""The first frame as a small picture, with the markers drawn over it."""

from __future__ import annotations

import base64
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from modalcam.report.text import figure_label
from tracker.series import MarkerTracks

_LONGEST_SIDE_PX = 420
_JPEG_QUALITY = 82


@dataclass(frozen=True)
class FrameMark:
    """One marker: where it is in the picture (in pixels of the frame), its name, and the side it is written on."""

    x: float
    y: float
    name: str
    reference: bool
    side: int


@dataclass(frozen=True)
class FrameView:
    """A picture as a data URI, in a frame of `width` by `height` pixels, and the marks over it."""

    data_uri: str
    width: int
    height: int
    marks: tuple[FrameMark, ...]
    alt: str

    @property
    def drawn_width(self) -> float:
        """Width with room for the names that stand beside the picture."""
        ends = [mark.x + self.unit * (18.0 + 11.0 * len(mark.name)) for mark in self.marks if mark.side > 0]
        return round(max([float(self.width), *ends]), 1)

    @property
    def unit(self) -> float:
        """Length in frame pixels that is drawn about one pixel wide."""
        return max(self.width, self.height) / _LONGEST_SIDE_PX


def frame_view(frame: NDArray[np.uint8] | None, tracks: MarkerTracks | None = None) -> FrameView | None:
    """The frame with the markers where they were first seen; None without a frame or an empty one."""
    if frame is None or frame.size == 0 or frame.ndim != 2:
        return None
    height, width = frame.shape
    marks = () if tracks is None else _marks(tracks)
    return FrameView(
        data_uri=_data_uri(frame),
        width=width,
        height=height,
        marks=marks,
        alt=f"First frame of the recording, {width} by {height} pixels"
        + (f", with {len(marks)} markers circled." if marks else "."),
    )


def _marks(tracks: MarkerTracks) -> tuple[FrameMark, ...]:
    marks = []
    for k, name in enumerate(tracks.markers):
        seen = np.flatnonzero(np.isfinite(tracks.x_px[:, k]) & np.isfinite(tracks.y_px[:, k]))
        if seen.size:
            x, y = float(tracks.x_px[seen[0], k]), float(tracks.y_px[seen[0], k])
            wide = tracks.decode.width_px > 0.5 * tracks.decode.height_px
            side = -1 if wide and x > 0.75 * tracks.decode.width_px else 1
            label = figure_label(name, limit=12)
            marks.append(FrameMark(round(x, 1), round(y, 1), label, name in tracks.reference, side))
    return tuple(marks)


def _data_uri(frame: NDArray[np.uint8]) -> str:
    height, width = frame.shape
    shrink = min(1.0, _LONGEST_SIDE_PX / max(height, width))
    if shrink < 1.0:
        size = (max(1, round(width * shrink)), max(1, round(height * shrink)))
        frame = np.asarray(cv2.resize(frame, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    # JPEG, since the noise of a camera makes PNG ten times as large without a use to the eye.
    done, coded = cv2.imencode(".jpg", np.ascontiguousarray(frame), [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    if not done:
        msg = f"the first frame of shape {frame.shape} could not be coded as JPEG"
        raise ValueError(msg)
    return "data:image/jpeg;base64," + base64.b64encode(coded.tobytes()).decode("ascii")

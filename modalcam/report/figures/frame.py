"""The first frame as a small picture, with the markers drawn over it."""

from __future__ import annotations

import base64
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from modalcam.report.style.text import figure_label
from tracker.results import MarkerTracks

_LONGEST_SIDE_PX = 420
_JPEG_QUALITY = 82
MOST_CANDIDATES = 60


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
    caption: str

    @property
    def drawn_width(self) -> float:
        """Width with room for the names that stand beside the picture."""
        ends = [mark.x + self.unit * (18.0 + 11.0 * len(mark.name)) for mark in self.marks if mark.side > 0]
        return round(max([float(self.width), *ends]), 1)

    @property
    def unit(self) -> float:
        """Length in frame pixels that is drawn about one pixel wide."""
        return max(self.width, self.height) / _LONGEST_SIDE_PX


def frame_view(
    frame: NDArray[np.uint8] | None,
    tracks: MarkerTracks | None = None,
    seen_px: NDArray[np.float64] | None = None,
) -> FrameView | None:
    """The frame with the markers where they were first seen; None without a frame or an empty one.

    Parameters
    ----------
    seen_px : array, shape (c, 2), or None
        Candidates that were seen in a recording that could not be tracked.
    """
    if frame is None or frame.size == 0 or frame.ndim != 2:
        return None
    height, width = frame.shape
    marks = _candidates(seen_px, width, height) if tracks is None else _marks(tracks)
    return FrameView(
        data_uri=_data_uri(frame),
        width=width,
        height=height,
        marks=marks,
        alt=f"First frame of the recording, {width} by {height} pixels"
        + (f", with {len(marks)} {_what(tracks)} circled." if marks else "."),
        caption=_caption(tracks, bool(marks)),
    )


def _what(tracks: MarkerTracks | None) -> str:
    return "candidates" if tracks is None else "markers"


def _caption(tracks: MarkerTracks | None, marked: bool) -> str:  # noqa: FBT001
    if not marked:
        return "First frame."
    if tracks is None:
        return "First frame, with each place circled that looks like a marker. None of them was followed."
    return (
        "First frame, each marker circled where it was first seen (dashed: fixed and subtracted). "
        "Check that every circle sits on a marker."
    )


def _candidates(seen_px: NDArray[np.float64] | None, width: int, height: int) -> tuple[FrameMark, ...]:
    """Candidates by number; at most as many as can be told apart."""
    places = np.zeros((0, 2)) if seen_px is None else seen_px[:MOST_CANDIDATES]
    wide = width > 0.5 * height
    return tuple(
        FrameMark(
            x=round(float(x), 1),
            y=round(float(y), 1),
            name=str(k + 1),
            reference=False,
            side=-1 if wide and x > 0.75 * width else 1,
        )
        for k, (x, y) in enumerate(places)
        if np.isfinite(x) and np.isfinite(y)
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
    return jpeg_uri(frame)


def jpeg_uri(frame: NDArray[np.uint8]) -> str:
    """A gray picture of shape (height, width) as a data URI."""
    # JPEG, since the noise of a camera makes PNG ten times as large without a use to the eye.
    done, coded = cv2.imencode(".jpg", np.ascontiguousarray(frame), [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    if not done:
        msg = f"a frame of shape {frame.shape} could not be coded as JPEG"
        raise ValueError(msg)
    return "data:image/jpeg;base64," + base64.b64encode(coded.tobytes()).decode("ascii")

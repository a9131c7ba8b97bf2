"""Images of one recording: the first frame, and frames across it."""

from __future__ import annotations

import base64
from collections.abc import Collection
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from modalcam.report.style import figure_label
from tracker import FailedTracking, FrameStrip, MarkerTracks

_LONGEST_SIDE_PX = 420
MOST_CANDIDATES = 60
# Of more markers, such as the stations of a line, the first, the last and a few between them are named.
_MOST_NAMES, _NAMED = 30, 6
# Most that a letter of a name takes, in units of `Frame.unit`.
_LETTER = 11.0


class Mark(NamedTuple):
    """A marker in an image: position, name, whether it is a reference, and the side of its name (1 is right).

    The name is empty where it is not shown, and stands beside the image where it would cross its right edge.
    """

    x: float
    y: float
    name: str
    reference: bool
    side: int = 1
    beside: bool = False


class Frame(NamedTuple):
    """The first frame as a data URI; `tracked` is False where the marks are candidates."""

    data_uri: str
    width: int
    height: int
    marks: tuple[Mark, ...]
    tracked: bool

    @property
    def radius(self) -> float:
        """Of the circles in units: smaller where they would cover each other."""
        return 7.0 if len(self.marks) <= _MOST_NAMES else 2.0

    @property
    def drawn_width(self) -> float:
        """Width including the names next to the image."""
        named = (mark for mark in self.marks if mark.beside)
        ends = [self.width + self.unit * (4.0 + _LETTER * len(mark.name)) for mark in named]
        return round(max([float(self.width), *ends]), 1)

    @property
    def unit(self) -> float:
        """Length in frame pixels that is drawn about one pixel wide."""
        return _unit(self.width, self.height)


class StripFrame(NamedTuple):
    """One image of a strip, the lines above it, and the fitted centres in it."""

    data_uri: str
    lines: tuple[str, ...]
    centres: tuple[Mark, ...]


class Strip(NamedTuple):
    """Frames side by side; lengths in pixels of the reduced images."""

    frames: tuple[StripFrame, ...]
    image_width: int
    image_height: int

    @property
    def arm(self) -> int:
        """Half the width of the crosses: smaller where they would cover each other."""
        return 5 if all(len(frame.centres) <= _MOST_NAMES for frame in self.frames) else 1


def first_frame(tracks: MarkerTracks | FailedTracking) -> Frame | None:
    """The first frame with the markers, or the candidates of a failed tracking; None without a frame."""
    frame = tracks.first_frame
    if frame is None or frame.size == 0 or frame.ndim != 2:
        return None
    height, width = frame.shape
    marks = []
    if isinstance(tracks, MarkerTracks):
        for k, name in enumerate(tracks.markers):
            seen = np.flatnonzero(np.isfinite(tracks.x_px[:, k] + tracks.y_px[:, k]))
            for row in seen[:1]:
                label, reference = figure_label(name, limit=12), name in tracks.reference
                marks.append(Mark(tracks.x_px[row, k], tracks.y_px[row, k], label, reference))
    elif tracks.seen_px is not None:
        candidates = enumerate(tracks.seen_px[:MOST_CANDIDATES], 1)
        marks = [Mark(x, y, str(k), reference=False) for k, (x, y) in candidates if np.isfinite(x + y)]
    named = named_among(len(marks)) if isinstance(tracks, MarkerTracks) else range(len(marks))
    wide = width > 0.5 * height

    def crosses(mark: Mark) -> bool:
        return bool(mark.x + (18.0 + _LETTER * len(mark.name)) * _unit(width, height) > width)

    placed = tuple(
        mark._replace(
            x=round(float(mark.x), 1),
            y=round(float(mark.y), 1),
            name=mark.name if k in named else "",
            side=-1 if wide and (mark.x > 0.75 * width or crosses(mark)) else 1,
            beside=k in named and not wide and crosses(mark),
        )
        for k, mark in enumerate(marks)
    )
    shrink = _LONGEST_SIDE_PX / max(height, width)
    if shrink < 1.0:
        size = (max(1, round(width * shrink)), max(1, round(height * shrink)))
        frame = np.asarray(cv2.resize(frame, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    return Frame(_jpeg(frame), width, height, placed, isinstance(tracks, MarkerTracks))


def _unit(width: int, height: int) -> float:
    return max(width, height) / _LONGEST_SIDE_PX


def named_among(count: int) -> Collection[int]:
    """Which of a number of markers are named: all, or a few that are evenly spread."""
    if count <= _MOST_NAMES:
        return range(count)
    return set(np.linspace(0, count - 1, _NAMED).round().astype(int).tolist())


def strip(tracks: MarkerTracks, onset_s: float | None) -> Strip | None:
    """Start, onset, largest displacement and end of a recording; None when no frames were kept."""
    kept = tracks.strip
    if kept is None or kept.frame.size == 0 or kept.images.ndim != 3:
        return None
    picks = sorted(_picks(tracks, kept, onset_s).items())
    height, width = kept.images.shape[1:]
    return Strip(tuple(_strip_frame(tracks, kept, index, names) for index, names in picks), width, height)


def _picks(tracks: MarkerTracks, kept: FrameStrip, onset_s: float | None) -> dict[int, list[str]]:
    """Indices of the frames shown with their names; a frame can have several."""
    time_s = tracks.time_s[kept.frame]
    named: dict[int, list[str]] = {0: ["start"]}
    if onset_s is not None and np.isfinite(onset_s):
        named.setdefault(int(np.argmin(np.abs(time_s - onset_s))), []).append("near the onset")
    moved = np.hypot(tracks.x_px - tracks.x_px[0], tracks.y_px - tracks.y_px[0])[kept.frame]
    if np.isfinite(moved).any():
        named.setdefault(int(np.nanargmax(np.fmax.reduce(moved, axis=1))), []).append("largest motion")
    named.setdefault(kept.frame.size - 1, []).append("end")
    return named


def _strip_frame(tracks: MarkerTracks, kept: FrameStrip, index: int, names: list[str]) -> StripFrame:
    row = int(kept.frame[index])
    # Reducing keeps areas: the edge of the image stays in place, not the centre of its first pixel.
    centres = tuple(
        Mark(
            round((x + 0.5) / kept.shrink, 2),
            round((y + 0.5) / kept.shrink, 2),
            name,
            name in tracks.reference,
        )
        for name, x, y in zip(
            tracks.markers, tracks.x_px[row].tolist(), tracks.y_px[row].tolist(), strict=True
        )
        if np.isfinite(x + y)
    )
    lines = (*names, f"{tracks.time_s[row]:.4g} s, frame {row}")
    return StripFrame(_jpeg(kept.images[index]), lines, centres)


def _jpeg(frame: NDArray[np.uint8]) -> str:
    # Camera noise makes PNG ten times as large without a visible gain.
    return data_uri("jpeg", np.ascontiguousarray(frame), [cv2.IMWRITE_JPEG_QUALITY, 82])


def data_uri(kind: str, image: NDArray[np.uint8], options: list[int]) -> str:
    """An image as a data URI, coded as `kind`, such as "jpeg", with options of OpenCV; ValueError if it cannot be."""
    done, coded = cv2.imencode(f".{kind}", image, options)
    if not done:
        msg = f"an image of shape {image.shape} could not be coded as {kind}"
        raise ValueError(msg)
    return f"data:image/{kind};base64," + base64.b64encode(coded.tobytes()).decode("ascii")

"""Images of one recording: the first frame, frames across it, and the film beside the simulation."""

from __future__ import annotations

import base64
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from modalcam.report.style.text import figure_label
from modalcam.video.results import KeptFrames, SimulatedFootage
from tracker.results import FailedTracking, FrameStrip, MarkerTracks

_LONGEST_SIDE_PX = 420
MOST_CANDIDATES = 60
_GAP_PX = 8.0
# Captions above the frames of a strip need this width.
_LEAST_WIDTH_PX = 118.0
_LINE_PX = 13.0
SHOWN_PER_S = 12.0
_FILM_GAP_PX = 6
_CLOSE_UP_PX = 32
CLOSE_UP_SHOWN_PX = 176
# A sheet is a row of frames, and WebP is limited to 16383 px.
_LARGEST_SIDE_PX = 16_000


class Mark(NamedTuple):
    """A marker in an image: position, name, whether it is a reference, and the side of its name (1 is right)."""

    x: float
    y: float
    name: str
    reference: bool
    side: int = 1


class Frame(NamedTuple):
    """The first frame as a data URI; `tracked` is False where the marks are candidates."""

    data_uri: str
    width: int
    height: int
    marks: tuple[Mark, ...]
    tracked: bool

    @property
    def drawn_width(self) -> float:
        """Width with room for the names beside the image."""
        ends = [mark.x + self.unit * (18.0 + 11.0 * len(mark.name)) for mark in self.marks if mark.side > 0]
        return round(max([float(self.width), *ends]), 1)

    @property
    def unit(self) -> float:
        """Length in frame pixels that is drawn about one pixel wide."""
        return max(self.width, self.height) / _LONGEST_SIDE_PX


class StripFrame(NamedTuple):
    """One image of a strip: its left edge, the lines above it with their heights, and the fitted centres."""

    data_uri: str
    left: float
    lines: tuple[tuple[float, str], ...]
    centres: tuple[Mark, ...]


class Strip(NamedTuple):
    """Frames side by side below `head`; lengths in pixels of the reduced images."""

    frames: tuple[StripFrame, ...]
    image_width: int
    image_height: int
    head: float
    width: float
    height: float


class Film(NamedTuple):
    """Sheets of `frames` images: measured and simulated together, and close-ups of the marker that moves most."""

    frames: int
    beside: bool
    width: int
    height: int
    sheet: str
    close_ups: tuple[str, str]
    footage: SimulatedFootage
    step_s: float


def first_frame(tracks: MarkerTracks | FailedTracking) -> Frame | None:
    """The first frame with the markers, or the candidates of a failed tracking; None without a frame."""
    frame = tracks.first_frame
    if frame is None or frame.size == 0 or frame.ndim != 2:
        return None
    height, width = frame.shape
    if isinstance(tracks, MarkerTracks):
        seen = [
            np.flatnonzero(np.isfinite(x) & np.isfinite(y))
            for x, y in zip(tracks.x_px.T, tracks.y_px.T, strict=True)
        ]
        points = [
            (float(tracks.x_px[at[0], k]), float(tracks.y_px[at[0], k]), figure_label(name, limit=12), name)
            for k, (name, at) in enumerate(zip(tracks.markers, seen, strict=True))
            if at.size
        ]
        reference = tracks.reference
    else:
        candidates = np.zeros((0, 2)) if tracks.seen_px is None else tracks.seen_px[:MOST_CANDIDATES]
        points = [
            (float(x), float(y), str(k + 1), "") for k, (x, y) in enumerate(candidates) if np.isfinite(x + y)
        ]
        reference = ()
    marks = tuple(
        Mark(round(x, 1), round(y, 1), label, name in reference, _side(x, width, height))
        for x, y, label, name in points
    )
    shrink = _LONGEST_SIDE_PX / max(height, width)
    if shrink < 1.0:
        size = (max(1, round(width * shrink)), max(1, round(height * shrink)))
        frame = np.asarray(cv2.resize(frame, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    return Frame(_jpeg(frame), width, height, marks, isinstance(tracks, MarkerTracks))


def strip(tracks: MarkerTracks, onset_s: float | None) -> Strip | None:
    """Start, onset, largest displacement and end of a recording; None when no frames were kept."""
    kept = tracks.strip
    if kept is None or kept.frame.size == 0 or kept.images.ndim != 3:
        return None
    picks = sorted(_picks(tracks, kept, onset_s).items())
    height, width = kept.images.shape[1:]
    pitch = max(float(width), _LEAST_WIDTH_PX) + _GAP_PX
    head = _LINE_PX * (1.5 + max(len(names) for _, names in picks))
    frames = tuple(
        _strip_frame(tracks, kept, index, names, n * pitch, head) for n, (index, names) in enumerate(picks)
    )
    return Strip(
        frames, width, height, head, round(len(frames) * pitch - _GAP_PX, 1), round(height + head, 1)
    )


def film(kept: KeptFrames, simulated: SimulatedFootage) -> Film:
    """Film of a recording and of its simulation, with close-ups of the marker that moves most."""
    n, height, width = simulated.images.shape
    beside = height >= width
    gap = np.full((n, height, _FILM_GAP_PX) if beside else (n, _FILM_GAP_PX, width), 128, np.uint8)
    frames = np.concatenate([kept.images, gap, simulated.images], axis=2 if beside else 1)
    frames = frames[: max(1, _LARGEST_SIDE_PX // frames.shape[2])]
    n = frames.shape[0]
    side = min(_CLOSE_UP_PX, height, width)
    x, y = simulated.most_moving_px
    left = int(np.clip(round(x) - side // 2, 0, width - side))
    top = int(np.clip(round(y) - side // 2, 0, height - side))
    measured, made = (
        _sheet(images[:n, top : top + side, left : left + side]) for images in (kept.images, simulated.images)
    )
    return Film(
        frames=n,
        beside=beside,
        width=frames.shape[2],
        height=frames.shape[1],
        sheet=_sheet(frames),
        close_ups=(measured, made),
        footage=simulated,
        step_s=float(np.median(np.diff(simulated.time_s[:n]))),
    )


def _side(x: float, width: int, height: int) -> int:
    return -1 if width > 0.5 * height and x > 0.75 * width else 1


def _picks(tracks: MarkerTracks, kept: FrameStrip, onset_s: float | None) -> dict[int, list[str]]:
    """Indices of the frames shown with their names; a frame can have several."""
    time_s = tracks.time_s[kept.frame]
    wanted = [(0, "start")]
    if onset_s is not None and np.isfinite(onset_s):
        wanted.append((int(np.argmin(np.abs(time_s - onset_s))), "near the onset"))
    moved = np.hypot(tracks.x_px - tracks.x_px[0], tracks.y_px - tracks.y_px[0])[kept.frame]
    if np.isfinite(moved).any():
        wanted.append((int(np.nanargmax(np.fmax.reduce(moved, axis=1))), "largest motion"))
    wanted.append((kept.frame.size - 1, "end"))
    named: dict[int, list[str]] = {}
    for index, name in wanted:
        named.setdefault(index, []).append(name)
    return named


def _strip_frame(
    tracks: MarkerTracks, kept: FrameStrip, index: int, names: list[str], left: float, head: float
) -> StripFrame:
    row = int(kept.frame[index])
    centres = []
    for name, x, y in zip(tracks.markers, tracks.x_px[row], tracks.y_px[row], strict=True):
        if np.isfinite(x) and np.isfinite(y):
            # Reducing keeps areas: the edge of the image stays in place, not the centre of its first pixel.
            at = ((x + 0.5) / kept.shrink + left, (y + 0.5) / kept.shrink + head)
            centres.append(
                Mark(round(float(at[0]), 2), round(float(at[1]), 2), name, name in tracks.reference)
            )
    lines = [*names, f"{tracks.time_s[row]:.4g} s, frame {row}"]
    heights = [round((n + 0.9) * _LINE_PX, 1) for n in range(len(lines))]
    uri = _jpeg(kept.images[index])
    return StripFrame(uri, round(left, 1), tuple(zip(heights, lines, strict=True)), tuple(centres))


def _sheet(frames: NDArray[np.uint8]) -> str:
    """Frames side by side as a data URI."""
    return _data_uri("webp", np.concatenate(list(frames), axis=1), [cv2.IMWRITE_WEBP_QUALITY, 60])


def _jpeg(frame: NDArray[np.uint8]) -> str:
    # Camera noise makes PNG ten times as large without a visible gain.
    return _data_uri("jpeg", np.ascontiguousarray(frame), [cv2.IMWRITE_JPEG_QUALITY, 82])


def _data_uri(kind: str, image: NDArray[np.uint8], options: list[int]) -> str:
    done, coded = cv2.imencode(f".{kind}", image, options)
    if not done:
        msg = f"an image of shape {image.shape} could not be coded as {kind}"
        raise ValueError(msg)
    return f"data:image/{kind};base64," + base64.b64encode(coded.tobytes()).decode("ascii")

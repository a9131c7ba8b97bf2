"""Pictures of frames, and what is drawn over them as SVG in pixels of the image.

Pixel centres are at integers, as everywhere in modalcam; the corner of the picture is at (-0.5, -0.5). A recording may
be made to need any time or memory, and a decoder may crash: frames are decoded in child processes, never in that of
the server.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

import cv2
import numpy as np

from modalcam.config import RecordingConfig
from tracker import Failure
from tracker.markers import kind_of
from tracker.video import UnreadableVideoError, frame_stamps, read_frame, to_8_bit

Point = tuple[float, float]
# Side of a patch's window that is drawn where its size is chosen by the texture.
_USUAL_WINDOW_PX = 31.0
# Stations that are drawn along a line.
_MOST_DRAWN = 60


def on_canvas(x_px: float, y_px: float) -> Point:
    """Position in the picture, from its corner, of a point in pixels of the image."""
    return x_px + 0.5, y_px + 0.5


def in_image(x: float, y: float) -> Point:
    """Point in pixels of the image, to a tenth, of a position in the picture."""
    return round(x - 0.5, 1), round(y - 0.5, 1)


def overlay(recording: RecordingConfig, pending: Sequence[Point] = (), sizes_px: Sequence[float] = ()) -> str:
    """Points, line and regions of a recording's options, and the first point of an unfinished line or region.

    `sizes_px` are those of the windows of the patches, where they are known and not given by an option.
    """
    parts = [_left_out(region) for region in recording.leave_out_px]
    kind = kind_of(recording.kind)
    if kind.takes_points:
        points, positions = recording.points_px or (), recording.positions_mm or ()
        for k, (name, point) in enumerate(zip(patch_names(recording), points, strict=True)):
            chosen = sizes_px[k] if len(sizes_px) == len(points) else _USUAL_WINDOW_PX
            size = recording.size_px or chosen
            at = f", {positions[k]:g} mm" if len(positions) == len(points) else ""
            parts += _patch(f"{name}{at}", point, size, is_round=recording.patch_shape == "round")
    if kind.follows_line and recording.line_px is not None:
        parts.append(drawn_line(recording.line_px, recording.stations))
    parts += [_dot(point, "pending") for point in pending]
    return "".join(parts)


def patch_names(recording: RecordingConfig) -> tuple[str, ...]:
    """Name of each patch: those given, and m1, m2, ... by its place for the others."""
    given, count = recording.names or (), len(recording.points_px or ())
    return (*given[:count], *(f"m{k + 1}" for k in range(len(given), count)))


def marked(points: Iterable[tuple[str, float, float]], kind: str) -> str:
    """Named points, of the class `kind` of the style sheet."""
    return "".join(_dot((x, y), kind) + _name(name, (x, y)) for name, x, y in points)


def trail(xs: Sequence[float], ys: Sequence[float], gain: float) -> str:
    """Path of a marker, with its motion about the first position enlarged by `gain`."""
    x0, y0 = xs[0], ys[0]
    at = (on_canvas(x0 + gain * (x - x0), y0 + gain * (y - y0)) for x, y in zip(xs, ys, strict=True))
    return f'<polyline class="trail" points="{" ".join(f"{x:.2f},{y:.2f}" for x, y in at)}"/>'


def _patch(name: str, point: Point, size_px: float, *, is_round: bool) -> list[str]:
    x, y = on_canvas(*point)
    half = 0.5 * size_px
    side = f"{size_px:.2f}"
    window = (
        f'<circle class="window" cx="{x:.2f}" cy="{y:.2f}" r="{half:.2f}"/>'
        if is_round
        else f'<rect class="window" x="{x - half:.2f}" y="{y - half:.2f}" width="{side}" height="{side}"/>'
    )
    return [window, _dot(point, "point"), _name(name, (point[0], point[1] - half), "above")]


def _left_out(corners: Sequence[Point]) -> str:
    (left, right), (top, bottom) = (sorted(values) for values in zip(*corners, strict=True))
    # From the corner of the first pixel, half a pixel before its centre, to that of the last.
    return (
        f'<rect class="left-out" x="{left:.2f}" y="{top:.2f}" width="{right - left + 1.0:.2f}" '
        f'height="{bottom - top + 1.0:.2f}"/>'
    )


def drawn_line(ends: Sequence[Point], stations: int | None, kind: str = "beam") -> str:
    """A line from the clamp to the free end with its stations, of the class `kind` of the style sheet."""
    (x0, y0), (x1, y1) = (on_canvas(*end) for end in ends)
    parts = [f'<line class="{kind}" x1="{x0:.2f}" y1="{y0:.2f}" x2="{x1:.2f}" y2="{y1:.2f}"/>']
    length = ((x1 - x0) ** 2 + (y1 - y0) ** 2) ** 0.5
    count = min(stations or min(round(length / 5.0), 200), _MOST_DRAWN)
    for k in range(count):
        share = k / max(count - 1, 1)
        at = ends[0][0] + share * (x1 - x0), ends[0][1] + share * (y1 - y0)
        parts.append(_dot(at, "station"))
    return "".join([*parts, _name("clamp", ends[0]), _name("free end", ends[1])])


def _dot(point: Point, kind: str) -> str:
    x, y = on_canvas(*point)
    return f'<circle class="dot {kind}" cx="{x:.2f}" cy="{y:.2f}" r="2"/>'


def _name(name: str, point: Point, kind: str = "beside") -> str:
    x, y = on_canvas(*point)
    return f'<text class="{kind}" x="{x:.2f}" y="{y:.2f}">{escape(name)}</text>'


def markers_text(recording: RecordingConfig) -> str:
    """What is followed in a recording, in two words."""
    kind = kind_of(recording.kind)
    if kind.follows_line:
        return "line"
    if kind.takes_points and recording.points_px:
        count = len(recording.points_px)
        return "1 patch" if count == 1 else f"{count} patches"
    return recording.kind


@dataclass(frozen=True)
class FrameTask:
    """A frame to be shown; `stamps` is that of `read_frame`.

    With `width_px`, the largest width of the picture, a frame that is higher than wide is turned, its top at the left.
    """

    path: Path
    index: int
    stamps: tuple[int | None, ...] = ()
    width_px: int | None = None


def frame_png(task: FrameTask) -> bytes | Failure:
    """PNG of a frame; deep pixels are stretched to 8 bit."""
    try:
        image = to_8_bit(read_frame(task.path, task.index, task.stamps))
    except UnreadableVideoError as error:
        return Failure(str(error))
    if task.width_px is not None and image.shape[0] > image.shape[1]:
        image = np.ascontiguousarray(np.rot90(image))
    height, width = image.shape
    if task.width_px is not None and width > task.width_px:
        size = (task.width_px, max(1, round(height * task.width_px / width)))
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    # Fast rather than small: it stays on this machine.
    written, data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    return data.tobytes() if written else Failure(f"frame {task.index} could not be written as a picture")


def stamps_of(path: Path) -> tuple[int | None, ...] | Failure:
    """Time stamps of all frames, for `FrameTask`."""
    try:
        return frame_stamps(path)
    except UnreadableVideoError as error:
        return Failure(str(error))

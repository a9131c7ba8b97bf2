"""Frames across a recording with the fitted centres drawn over them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modalcam.report.figures.frame import jpeg_uri
from tracker.results import MarkerTracks

_GAP_PX = 8.0
_LINE_PX = 13.0
# Headings need some width of their own, whatever the picture has.
_LEAST_WIDTH_PX = 118.0


@dataclass(frozen=True)
class StripCentre:
    """Where a fitted centre is drawn, and whether its marker is subtracted as a reference."""

    x: float
    y: float
    reference: bool


@dataclass(frozen=True)
class StripFrame:
    """One picture: its left edge in the strip, the lines over it with their heights, and the centres in it."""

    data_uri: str
    left: float
    lines: tuple[tuple[float, str], ...]
    centres: tuple[StripCentre, ...]


@dataclass(frozen=True)
class StripView:
    """Pictures side by side; lengths are in pixels of the small pictures."""

    frames: tuple[StripFrame, ...]
    picture_width: int
    picture_height: int
    head: float
    width: float
    height: float
    alt: str


def strip_view(tracks: MarkerTracks, onset_s: float | None) -> StripView | None:
    """Start, onset, largest displacement and end of a recording; None when no pictures were kept."""
    strip = tracks.strip
    if strip is None or strip.frame.size == 0 or strip.images.ndim != 3:
        return None
    picks = _picks(tracks, onset_s)
    height, width = strip.images.shape[1:]
    pitch = max(float(width), _LEAST_WIDTH_PX) + _GAP_PX
    head = _LINE_PX * (1.5 + max(len(names) for names in picks.values()))
    frames = tuple(
        _frame(tracks, index, names, n * pitch, head)
        for n, (index, names) in enumerate(sorted(picks.items()))
    )
    shown = ", ".join(name for _, names in sorted(picks.items()) for name in names)
    return StripView(
        frames=frames,
        picture_width=width,
        picture_height=height,
        head=head,
        width=round(len(frames) * pitch - _GAP_PX, 1),
        height=round(height + head, 1),
        alt=f"{len(frames)} frames of the recording ({shown}) with the fitted centres of its markers.",
    )


def _picks(tracks: MarkerTracks, onset_s: float | None) -> dict[int, list[str]]:
    """Index in the strip and name of what is shown; a picture that is two things has both names."""
    strip = tracks.strip
    assert strip is not None  # noqa: S101 - asked for by the caller
    time_s = tracks.time_s[strip.frame]
    wanted = [(0, "start")]
    if onset_s is not None and np.isfinite(onset_s):
        wanted.append((int(np.argmin(np.abs(time_s - onset_s))), "near the onset"))
    moved = np.hypot(tracks.x_px - tracks.x_px[0], tracks.y_px - tracks.y_px[0])[strip.frame]
    if np.isfinite(moved).any():
        wanted.append((int(np.nanargmax(np.fmax.reduce(moved, axis=1))), "largest motion"))
    wanted.append((strip.frame.size - 1, "end"))
    named: dict[int, list[str]] = {}
    for index, name in wanted:
        named.setdefault(index, []).append(name)
    return named


def _frame(tracks: MarkerTracks, index: int, names: list[str], left: float, head: float) -> StripFrame:
    strip = tracks.strip
    assert strip is not None  # noqa: S101 - asked for by the caller
    row = int(strip.frame[index])
    centres = []
    for k, name in enumerate(tracks.markers):
        x, y = float(tracks.x_px[row, k]), float(tracks.y_px[row, k])
        if np.isfinite(x) and np.isfinite(y):
            # Shrinking keeps areas: the picture's edge, not the centre of its first pixel, stays where it is.
            at = ((x + 0.5) / strip.shrink + left, (y + 0.5) / strip.shrink + head)
            centres.append(StripCentre(round(at[0], 2), round(at[1], 2), name in tracks.reference))
    lines = [*names, f"{tracks.time_s[row]:.4g} s, frame {row}"]
    return StripFrame(
        data_uri=jpeg_uri(strip.images[index]),
        left=round(left, 1),
        lines=tuple((round((n + 0.9) * _LINE_PX, 1), line) for n, line in enumerate(lines)),
        centres=tuple(centres),
    )

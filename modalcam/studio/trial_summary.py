"""Numbers of a test track, and what to change where it is bad."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tracker.arrays import FloatArray
from tracker.results import MarkerTracks

# Markers listed and drawn, evenly spread: the stations of a line are many.
_MOST_LISTED = 24
# Positions with a larger sd are worth another choice of the point.
_COARSE_PX = 0.05
# Motion between frames beyond which a short exposure matters.
_FAST_PX = 3.0
_LOST = 0.02


@dataclass(frozen=True)
class TrialRow:
    """One marker: median sd in px and mm (NaN without a scale), motion, largest step between frames, share lost."""

    name: str
    sd_px: float
    sd_mm: float
    motion_px: float
    step_px: float
    lost: float

    def as_text(self) -> tuple[str, ...]:
        """Cells of the table; a value that is not known is a dash."""
        numbers = (
            f"{self.sd_px:.4f}",
            f"{self.sd_mm:.5f}",
            f"{self.motion_px:.2f}",
            f"{self.step_px:.2f}",
            f"{100.0 * self.lost:.0f}",
        )
        return (self.name, *("–" if number == "nan" else number for number in numbers))


@dataclass(frozen=True)
class TrialSummary:
    """Rows of the markers, their paths (name, x, y), and sentences on what to change."""

    rows: tuple[TrialRow, ...]
    trails: tuple[tuple[str, list[float], list[float]], ...]
    advice: tuple[str, ...]


def summarised(tracks: MarkerTracks) -> TrialSummary:
    """Numbers of the markers of a track, at most 24, in order along the beam."""
    count = len(tracks.markers)
    chosen = sorted({round(k) for k in np.linspace(0, count - 1, min(count, _MOST_LISTED))})
    sd_mm = np.hypot(tracks.sd_x_mm, tracks.sd_y_mm)
    rows, trails = [], []
    for k in chosen:
        xy = np.column_stack([tracks.x_px[:, k], tracks.y_px[:, k]])
        seen = np.all(np.isfinite(xy), axis=1)
        rows.append(_row(tracks, k, xy, seen, sd_mm[:, k]))
        if seen.any():
            trails.append((tracks.markers[k], xy[seen, 0].tolist(), xy[seen, 1].tolist()))
    return TrialSummary(tuple(rows), tuple(trails), _advice(rows))


def _row(
    tracks: MarkerTracks,
    k: int,
    xy: FloatArray,
    seen: np.ndarray[tuple[int], np.dtype[np.bool_]],
    sd_mm: FloatArray,
) -> TrialRow:
    # Of the component that is measured: a line has no position along itself.
    sd = np.fmin(tracks.sd_x_px[:, k], tracks.sd_y_px[:, k])
    steps = np.linalg.norm(np.diff(xy, axis=0), axis=1)
    return TrialRow(
        tracks.markers[k],
        _median(sd),
        _median(sd_mm),
        float(np.max(np.ptp(xy[seen], axis=0))) if seen.any() else float("nan"),
        float(np.nanmax(steps)) if np.isfinite(steps).any() else float("nan"),
        1.0 - float(seen.mean()),
    )


def _median(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else float("nan")


def _advice(rows: list[TrialRow]) -> tuple[str, ...]:
    advice = []
    coarse = [row.name for row in rows if row.sd_px > _COARSE_PX]
    lost = [row.name for row in rows if row.lost > _LOST]
    fast = [row.name for row in rows if row.step_px > _FAST_PX]
    still = [row.name for row in rows if row.motion_px < 5.0 * row.sd_px]
    if coarse:
        advice.append(
            f"{', '.join(coarse)}: the position is uncertain by more than {_COARSE_PX} px; choose a point with more "
            "contrast, or a larger window."
        )
    if lost:
        advice.append(
            f"{', '.join(lost)}: lost in some frames; choose a point that stays in the picture and does not look like "
            "its surroundings."
        )
    if fast:
        advice.append(
            f"{', '.join(fast)}: moves by more than {_FAST_PX:g} px between frames; give the exposure time, and record "
            "at a higher rate if it is lost."
        )
    if still:
        advice.append(
            f"{', '.join(still)}: hardly moves in these frames; choose a point farther from the clamp, unless it is a "
            "fixed reference."
        )
    return tuple(advice)

"""Numbers of a test track, and what to change where it is bad."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from modalcam.studio.trial_windows import evenly
from tracker import FloatArray, MarkerTracks

if TYPE_CHECKING:
    from modalcam.studio.trial import Trial

# Markers listed and drawn, evenly spread: the stations of a line are many.
MOST_LISTED = 24
# Positions with a larger sd are worth another choice of the point.
_COARSE_PX = 0.05
# Motion between frames beyond which a short exposure matters.
_FAST_PX = 3.0
_LOST = 0.02
_BLURRED_PX = 5.0
# Motion below this many standard deviations of a position is none.
_LEAST_MOTION_SD = 5.0
_MOST_NAMES = 6
# Share of a window's contrast that is not explained by one picture that moves.
_UNEXPLAINED = 0.3


@dataclass(frozen=True)
class TrialRow:
    """One marker of a test track.

    Median sd in px and mm (NaN without a scale), motion, largest step between frames, largest motion blur (NaN without
    an exposure time), share of frames lost, and what its window does not explain (NaN where that was not computed).
    """

    name: str
    sd_px: float
    sd_mm: float
    motion_px: float
    step_px: float
    blur_px: float
    lost: float
    unexplained: float

    def as_text(self) -> tuple[str, ...]:
        """Cells of the table; a value that is not known is a dash."""
        numbers = (
            f"{self.sd_px:.4f}",
            f"{self.sd_mm:.5f}",
            f"{self.motion_px:.2f}",
            f"{self.step_px:.2f}",
            f"{self.blur_px:.2f}",
            f"{100.0 * self.lost:.0f}",
            f"{100.0 * self.unexplained:.0f}",
        )
        return (self.name, *("–" if number == "nan" else number for number in numbers))


# What concerns a marker, and what to change.
_RULES: tuple[tuple[Callable[[TrialRow], bool], str], ...] = (
    (
        lambda row: row.sd_px > _COARSE_PX,
        (
            f"the position is uncertain by more than {_COARSE_PX} px; choose a point with more contrast, or a larger "
            "window."
        ),
    ),
    (
        lambda row: row.lost > _LOST,
        "lost in some frames; choose a point that stays in the picture and does not look like its surroundings.",
    ),
    (
        lambda row: row.blur_px > _BLURRED_PX,
        f"blurred by more than {_BLURRED_PX:g} px; shorten the exposure and add light.",
    ),
    (
        lambda row: row.step_px > _FAST_PX and not np.isfinite(row.blur_px),
        (
            f"moves by more than {_FAST_PX:g} px between frames; give the exposure time, and record faster if "
            "the marker is lost."
        ),
    ),
    (
        lambda row: row.unexplained > _UNEXPLAINED,
        (
            "the picture in its window changes; delete it where it is not on what vibrates, or choose a smaller or a "
            "round window, which leaves out what does not move with it."
        ),
    ),
    (
        lambda row: row.motion_px < _LEAST_MOTION_SD * row.sd_px,
        "hardly moves in these frames; choose a point farther from the clamp, unless it is a fixed reference.",
    ),
)


@dataclass(frozen=True)
class TrialSummary:
    """Rows of the markers, their paths (name, x, y), and sentences on what to change."""

    rows: tuple[TrialRow, ...]
    trails: tuple[tuple[str, list[float], list[float]], ...]
    advice: tuple[str, ...]


def summarised(trial: Trial) -> TrialSummary:
    """Numbers of the markers of a test track, at most 24, in order along the beam."""
    tracks = trial.tracks
    sd_px = _measured_sd(tracks, tracks.sd_x_px, tracks.sd_y_px)
    sd_mm = _measured_sd(tracks, tracks.sd_x_mm, tracks.sd_y_mm)
    share = float("nan") if trial.exposure_share is None else trial.exposure_share
    unexplained = {window.name: window.unexplained for window in trial.windows}
    rows, trails = [], []
    for k in evenly(len(tracks.markers), MOST_LISTED):
        xy = np.column_stack([tracks.x_px[:, k], tracks.y_px[:, k]])
        seen = np.all(np.isfinite(xy), axis=1)
        rows.append(
            _row(
                tracks.markers[k],
                xy,
                seen,
                (_median(sd_px[:, k]), _median(sd_mm[:, k])),
                share,
                unexplained.get(tracks.markers[k], float("nan")),
            )
        )
        if seen.any():
            trails.append((tracks.markers[k], xy[seen, 0].tolist(), xy[seen, 1].tolist()))
    return TrialSummary(tuple(rows), tuple(trails), _advice(rows))


def _row(
    name: str,
    xy: FloatArray,
    seen: np.ndarray[tuple[int], np.dtype[np.bool_]],
    sd: tuple[float, float],
    exposure_share: float,
    unexplained: float,
) -> TrialRow:
    steps = np.linalg.norm(np.diff(xy, axis=0), axis=1)
    step = float(np.nanmax(steps)) if np.isfinite(steps).any() else float("nan")
    return TrialRow(
        name,
        *sd,
        float(np.max(np.ptp(xy[seen], axis=0))) if seen.any() else float("nan"),
        step,
        step * exposure_share,
        1.0 - float(seen.mean()),
        unexplained,
    )


def _measured_sd(tracks: MarkerTracks, sd_x: FloatArray, sd_y: FloatArray) -> FloatArray:
    """Of the component that is measured: the errors of a station in x and y are parts of one across the line."""
    return np.asarray(np.fmin(sd_x, sd_y) if tracks.correlation_xy is None else np.hypot(sd_x, sd_y))


def _median(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else float("nan")


def _advice(rows: list[TrialRow]) -> tuple[str, ...]:
    return tuple(
        f"{_listed(names)}: {text}"
        for concerns, text in _RULES
        if (names := [row.name for row in rows if concerns(row)])
    )


def _listed(names: list[str]) -> str:
    more = len(names) - _MOST_NAMES
    return ", ".join(names[:_MOST_NAMES]) + (f" and {more} more" if more > 0 else "")

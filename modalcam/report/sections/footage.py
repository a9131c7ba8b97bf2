"""Footage and tracks of one recording: its sampling in time, and the markers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tracker.arrays import FloatArray
from tracker.flags import DUPLICATE_FRAME, REGISTRY
from tracker.results import MarkerTracks


class Sampling(NamedTuple):
    """Number of frames, duration, and median, shortest and longest step; steps are NaN below two frames."""

    frames: int
    duration_s: float
    step_s: float
    shortest_s: float
    longest_s: float

    @property
    def even(self) -> bool:
        """Whether all steps are equal."""
        return self.longest_s - self.shortest_s < 1e-6 * self.step_s


class MarkerRow(NamedTuple):
    """One marker: position on the beam, frames in which it was found, median sd, and frames with each flag."""

    name: str
    reference: bool
    position_mm: float
    found: int
    frames: int
    sd_x_px: float
    sd_y_px: float
    sd_mm: float
    flags: tuple[tuple[str, int], ...]


def sampling(time_s: FloatArray) -> Sampling:
    """Steps of a time axis."""
    if time_s.size < 2:
        nan = float("nan")
        return Sampling(time_s.size, 0.0, nan, nan, nan)
    steps = np.diff(time_s)
    values = (time_s[-1] - time_s[0], np.median(steps), steps.min(), steps.max())
    return Sampling(time_s.size, *(float(value) for value in values))


def repeated_frames(tracks: MarkerTracks) -> int:
    """Number of frames that repeat the image of the one before."""
    return int(np.count_nonzero((tracks.flags & np.uint32(DUPLICATE_FRAME.value)).any(axis=1)))


def marker_rows(tracks: MarkerTracks) -> tuple[MarkerRow, ...]:
    """A row for each marker."""
    return tuple(_row(tracks, k) for k in range(len(tracks.markers)))


def _row(tracks: MarkerTracks, k: int) -> MarkerRow:
    found = np.count_nonzero(np.isfinite(tracks.x_px[:, k]) & np.isfinite(tracks.y_px[:, k]))
    sd_x, sd_y = _median(tracks.sd_x_px[:, k]), _median(tracks.sd_y_px[:, k])
    mm_per_px = float("nan") if tracks.scale is None else tracks.scale.mm_per_px
    counts = [(f.name, int(np.count_nonzero(tracks.flags[:, k] & np.uint32(f.value)))) for f in REGISTRY]
    return MarkerRow(
        name=tracks.markers[k],
        reference=tracks.markers[k] in tracks.reference,
        position_mm=float(tracks.positions_mm[k]),
        found=int(found),
        frames=tracks.frame.size,
        sd_x_px=sd_x,
        sd_y_px=sd_y,
        sd_mm=float(np.hypot(sd_x, sd_y) / np.sqrt(2.0)) * mm_per_px,
        flags=tuple(pair for pair in counts if pair[1]),
    )


def _median(values: FloatArray) -> float:
    good = values[np.isfinite(values)]
    return float(np.median(good)) if good.size else float("nan")

"""Order of markers along a beam seen from the side, and selection of its markers among many spots."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations
from typing import Literal

import numpy as np

from tracker.arrays import FloatArray, IntArray

ClampSide = Literal["top", "bottom", "left", "right"]

# One direction must fit this many times worse before the spacing alone decides the clamped end.
DECISIVE = 3.0


@dataclass(frozen=True)
class BeamOrder:
    """Indices of the markers from the clamp outwards, and notes for the user."""

    order: IntArray
    notes: tuple[str, ...]


def order_along_beam(
    points_px: FloatArray, positions_mm: tuple[float, ...] | None, clamp_side: ClampSide | None
) -> BeamOrder:
    """Sort markers, of shape (n, 2), from the clamp outwards.

    The line through the markers is their first principal axis. Its clamped end is at `clamp_side` where given; else
    at the end from which `positions_mm` fit the spacing clearly better; else at the top of the image for a line closer
    to vertical, at the left for one closer to horizontal.
    """
    centred = points_px - points_px.mean(axis=0)
    axis = np.linalg.svd(centred, full_matrices=False)[2][0] if len(points_px) > 1 else np.array([0.0, 1.0])
    upright = abs(axis[1]) >= abs(axis[0])
    side = clamp_side or ("top" if upright else "left")
    outward = {"top": (0, 1), "bottom": (0, -1), "left": (1, 0), "right": (-1, 0)}[side]
    if axis @ np.array(outward, dtype=np.float64) < 0:
        axis = -axis
    along = centred @ axis
    order = np.argsort(along, kind="stable")
    if clamp_side is not None or len(order) < 2:
        return BeamOrder(order, ())
    if positions_mm is not None and len(order) > 2:
        forward = _misfit(along[order], positions_mm)
        backward = _misfit(-along[order[::-1]], positions_mm)
        if forward > DECISIVE * backward and forward > 0.02:
            note = (
                "The spacing of the markers puts the clamp at the opposite end; set clamp_side to override."
            )
            return BeamOrder(order[::-1].copy(), (note,))
        if backward > DECISIVE * forward and backward > 0.02:
            return BeamOrder(order, ())
    note = f"The clamp is assumed at the {side} of the image; set clamp_side if it is not."
    return BeamOrder(order, (note,))


def _misfit(along_px: FloatArray, positions_mm: tuple[float, ...]) -> float:
    """Rms deviation of sorted pixel positions from a line in `positions_mm`, relative to their extent."""
    mm = np.array(positions_mm)
    line = np.polynomial.polynomial.polyfit(mm, along_px, 1)
    if line[1] <= 0:
        return float("inf")
    rest = along_px - np.polynomial.polynomial.polyval(mm, line)
    return float(np.sqrt(np.mean(rest**2)) / max(np.ptp(along_px), 1e-9))


def matching_subset(points_px: FloatArray, positions_mm: tuple[float, ...]) -> IntArray | None:
    """Indices of the spots that lie on a line with the spacing of `positions_mm`, among more spots than markers.

    Every pair of spots is tried as first and last marker; the others must lie within a fifth of the smallest spacing.
    The subset with the smallest error is returned, None when none fits.
    """
    mm = np.array(positions_mm)
    first, last = int(np.argmin(mm)), int(np.argmax(mm))
    share = (mm - mm[first]) / (mm[last] - mm[first])
    spacing = float(np.min(np.diff(np.sort(share))))
    fitting: list[tuple[float, tuple[int, ...]]] = []
    for start, stop in permutations(points_px, 2):
        span = stop - start
        expected = start + share[:, None] * span
        distance = np.linalg.norm(points_px[None, :, :] - expected[:, None, :], axis=2)
        nearest = np.argmin(distance, axis=1)
        error = distance[np.arange(len(mm)), nearest]
        if len(set(nearest.tolist())) == len(mm) and error.max() < 0.2 * spacing * np.linalg.norm(span):
            relative = float(np.sqrt(np.mean(error**2)) / np.linalg.norm(span))
            fitting.append((relative, tuple(sorted(nearest.tolist()))))
    return np.array(min(fitting)[1], dtype=np.int64) if fitting else None

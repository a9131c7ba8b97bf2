"""Prediction of a marker's position in the next frame from its previous positions."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from tracker.acceptance import AHEAD
from tracker.acceptance import TUNING as ACCEPTANCE
from tracker.arrays import BoolArray, FloatArray, IntArray

# Frozen into compiled code.
NEWEST_SHARE = ACCEPTANCE.newest_share
LARGEST_ERROR_PX = ACCEPTANCE.largest_error_px
LONGEST_EXTRAPOLATION = ACCEPTANCE.longest_extrapolation

# The parabola through three positions at the four times before them, the latest first.
BACKWARDS = np.array([[3.0, -3.0, 1.0], [6.0, -8.0, 3.0], [10.0, -15.0, 6.0], [15.0, -24.0, 10.0]])


class Memory(NamedTuple):
    """Past of m markers.

    `past` (m, 4, 2) holds positions, the latest first, predicted ones where the marker was missing; `error` (m, 4) the
    running error of each degree; `known` (m,) the number of positions, at most 4; `lost` (m,) the frames since the
    marker was last seen; `trusted` (m, 4) whether a position was measured, or predicted for a frame or so.
    """

    past: FloatArray
    error: FloatArray
    known: IntArray
    lost: IntArray
    trusted: BoolArray


@njit(cache=True, nogil=True, error_model="numpy")
def _guess(past: FloatArray, degree: int, guess: FloatArray) -> None:
    for c in range(2):
        total = 0.0
        for j in range(degree + 1):
            total += AHEAD[degree, j] * past[j, c]
        guess[c] = total


@njit(cache=True, nogil=True, error_model="numpy")
def _best_degree(error: FloatArray, known: int) -> int:
    best = 0
    for degree in range(1, min(known, 4)):
        if error[degree] < error[best]:
            best = degree
    return best


@njit(cache=True, nogil=True, error_model="numpy")
def predict_all(memory: Memory, aims: FloatArray, velocity: FloatArray) -> None:
    """Fill predicted positions and the motion expected during the frame, both of shape (m, 2)."""
    past, known = memory.past, memory.known
    for k in range(past.shape[0]):
        _guess(past[k], _best_degree(memory.error[k], known[k]), aims[k])
        for c in range(2):
            # Midway between the last step and the predicted one.
            step = 0.5 * (aims[k, c] - past[k, 1, c])
            velocity[k, c] = step if known[k] >= 2 and np.isfinite(step) else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def update_all(memory: Memory, positions: FloatArray) -> None:
    """Add the positions of a frame to the memory; shape (m, 2), NaN where missing."""
    past, error, known, lost, trusted = memory
    guess = np.empty(2)
    newest = np.empty(2)
    for k in range(past.shape[0]):
        seen = np.isfinite(positions[k, 0]) and np.isfinite(positions[k, 1])
        if seen and lost[k] == 0:
            for degree in range(4):
                _guess(past[k], degree, guess)
                miss = np.hypot(guess[0] - positions[k, 0], guess[1] - positions[k, 1])
                fresh = min(miss, LARGEST_ERROR_PX) if np.isfinite(miss) else LARGEST_ERROR_PX
                error[k, degree] += NEWEST_SHARE * (fresh - error[k, degree])
        if seen:
            newest[0], newest[1] = positions[k, 0], positions[k, 1]
        elif lost[k] < LONGEST_EXTRAPOLATION:
            _guess(past[k], _best_degree(error[k], known[k]), newest)
        else:
            newest[0], newest[1] = past[k, 0, 0], past[k, 0, 1]
        # Entry by entry: compiling an array assignment takes numba two seconds.
        for j in range(3, 0, -1):
            for c in range(2):
                past[k, j, c] = past[k, j - 1, c]
            # Now that the marker is seen again, its predictions meanwhile have proved wrong.
            trusted[k, j] = trusted[k, j - 1] and not (seen and j <= lost[k])
        past[k, 0, 0], past[k, 0, 1] = newest[0], newest[1]
        trusted[k, 0] = seen or (lost[k] < LONGEST_EXTRAPOLATION and known[k] >= 3)
        if seen:
            known[k] = min(known[k] + 1, 4)
            lost[k] = 0
        else:
            lost[k] += 1


class Predictor:
    """Predicts m markers at once, each with the polynomial degree of the smallest recent error.

    Positions of frames in which a marker is missing are replaced by predictions for a few frames: these serve only to
    aim the next fit and are never output.
    """

    def __init__(self, markers: int) -> None:
        self.memory = Memory(
            np.full((markers, 4, 2), np.nan),
            np.tile([1.0, 1.1, 1.2, 1.3], (markers, 1)),
            np.zeros(markers, dtype=np.int64),
            np.zeros(markers, dtype=np.int64),
            np.zeros((markers, 4), dtype=np.bool_),
        )

    def start(self, marker: int, position_px: FloatArray) -> None:
        """Restart a marker at a position without history."""
        self.memory.past[marker] = position_px
        self.memory.known[marker] = 1
        self.memory.lost[marker] = 0

    def start_moving(self, marker: int, first_px: FloatArray) -> None:
        """Restart a marker with the past that its positions in the next three frames, shape (3, 2), continue."""
        self.start(marker, BACKWARDS @ first_px)
        self.memory.known[marker] = 3
        self.memory.trusted[marker] = True
        # This past was constructed with the parabola.
        self.memory.error[marker, 2] = 0.5 * self.memory.error[marker, 0]

    def predict(self) -> tuple[FloatArray, FloatArray]:
        """Positions in the next frame and motion from frame to frame there; both of shape (m, 2), in px."""
        markers = self.memory.known.size
        aims, velocity = np.empty((markers, 2)), np.empty((markers, 2))
        predict_all(self.memory, aims, velocity)
        return aims, velocity

    def passed(self) -> tuple[FloatArray, FloatArray]:
        """Motion from frame to frame and its change, at the frame before the latest; both of shape (m, 2), in px.

        The slope of the cubic through the last four positions, whose error is that of the fourth derivative, and the
        central second difference; where the latest is missing, its prediction is used. NaN where a marker was lost.
        """
        past, trust = self.memory.past, self.memory.trusted
        after, middle, before, first = (past[:, j] for j in range(4))
        motion = (2.0 * after + 3.0 * middle - 6.0 * before + first) / 6.0
        motion = np.where(trust[:, 3:] & np.isfinite(first), motion, 0.5 * (after - before))
        bend = after - 2.0 * middle + before
        trusted = np.all(trust[:, :3], axis=1)[:, None]
        return np.where(trusted, motion, np.nan), np.where(trusted, bend, np.nan)

    def update(self, position_px: FloatArray) -> None:
        """Add the positions of a frame, NaN where missing; shape (m, 2)."""
        update_all(self.memory, position_px)

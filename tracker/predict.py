"""Where a marker will be in the next frame, from where it has been."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tracker.series import FloatArray

# Extrapolation by polynomials of degree 0 to 3 through the last positions, the latest first.
WEIGHTS = np.array(
    [
        [1.0, 0.0, 0.0, 0.0],
        [2.0, -1.0, 0.0, 0.0],
        [3.0, -3.0, 1.0, 0.0],
        [4.0, -6.0, 4.0, -1.0],
    ]
)
# Share of the newest error in the running mean that picks the degree.
MEMORY = 0.2
# A marker that is lost is extrapolated this long; then its last position is the centre of the search.
LONGEST_EXTRAPOLATION = 4


class Predictor:
    """Predicts m markers at once, each with the polynomial degree that has served it best lately.

    Positions of frames in which a marker is missing are replaced by their prediction for a few frames: for
    aiming only, they never leave this class.
    """

    def __init__(self, markers: int) -> None:
        self._past = np.full((markers, 4, 2), np.nan)
        self._error = np.tile([1.0, 1.1, 1.2, 1.3], (markers, 1))
        self._known = np.zeros(markers, dtype=np.int64)
        self._lost = np.zeros(markers, dtype=np.int64)

    def start(self, marker: int, position_px: FloatArray) -> None:
        """Begin a marker anew at a position without history."""
        self._past[marker] = position_px
        self._known[marker] = 1
        self._lost[marker] = 0

    def positions_px(self) -> FloatArray:
        """Predicted x, y of each marker; shape (m, 2)."""
        guesses = self._guesses()
        degree = self._degrees()
        return guesses[np.arange(degree.size), degree]

    def _guesses(self) -> FloatArray:
        return np.asarray(np.einsum("dk,mkc->mdc", WEIGHTS, self._past))

    def _degrees(self) -> NDArray[np.int64]:
        error = np.where(np.arange(4)[None, :] < self._known[:, None], self._error, np.inf)
        error[:, 0] = np.where(self._known <= 1, 0.0, error[:, 0])
        return np.asarray(np.argmin(error, axis=1), dtype=np.int64)

    def update(self, position_px: FloatArray) -> None:
        """Take the positions of a frame, NaN where missing; shape (m, 2)."""
        guesses = self._guesses()
        seen = np.all(np.isfinite(position_px), axis=1)
        miss = np.linalg.norm(guesses - position_px[:, None, :], axis=2)
        # A degree is judged by errors of at most a marker's distance, else one jump rules for long.
        fresh = np.minimum(np.where(np.isfinite(miss), miss, 10.0), 10.0)
        tracked = seen & (self._lost == 0)
        self._error[tracked] += MEMORY * (fresh[tracked] - self._error[tracked])
        aim = self.positions_px()
        carried = self._lost < LONGEST_EXTRAPOLATION
        newest = np.where(seen[:, None], position_px, np.where(carried[:, None], aim, self._past[:, 0]))
        self._past = np.concatenate([newest[:, None, :], self._past[:, :3]], axis=1)
        self._known = np.where(seen, np.minimum(self._known + 1, 4), self._known)
        self._lost = np.where(seen, 0, self._lost + 1)

    def velocity_px(self) -> FloatArray:
        """Motion per frame expected at the next frame: midway between the last step and the predicted one."""
        ahead = self.positions_px() - self._past[:, 0]
        behind = self._past[:, 0] - self._past[:, 1]
        both = 0.5 * (ahead + behind)
        return np.where((self._known >= 2)[:, None] & np.isfinite(both), both, 0.0)

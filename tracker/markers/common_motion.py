"""Motion that all markers have in common: where it is expected next, with its uncertainty."""

from __future__ import annotations

import numpy as np

from tracker.arrays import BoolArray, FloatArray
from tracker.markers.assignment import Expectation, spacing_px

# Sd of expected positions before any motion; its factor per frame, and its factor where nothing was found.
FIRST_SD_PX, FADING, GROWTH = 1.0, 0.9, 1.5
# The range of an oscillation is known after this many passes from one side to the other; a side begins at this share of
# the range. When the range has grown by the third factor, passes are counted anew.
PASSES, SIDE, GROWN = 3, 0.25, 1.2
# Sd by which the motion may exceed its range so far, as a share of the range.
BEYOND = 0.08
# Predictions with a larger error, as a share of the range, are no better than the range itself.
POOR = 0.25
# An expected position of a single marker is used where it is this near to those of all others, in spacings.
CONSISTENT = 0.3


class CommonMotion:
    """Running error of the predictions, and the limits between which all markers have swung so far.

    Predictions are useless where markers move far between frames. What remains known is the range of an oscillation:
    once it has passed back and forth, positions beyond it are improbable.
    """

    def __init__(self, first_px: FloatArray, size_px: float) -> None:
        self._first, self._size = first_px, size_px
        self.form_px = first_px.copy()
        self._sd_px, self._frames = FIRST_SD_PX, 0
        self._low, self._high = np.zeros(2), np.zeros(2)
        self._side, self._passes, self._counted_px = 0, 0, 0.0

    def saw(self, positions_px: FloatArray) -> None:
        """After each frame: positions of all markers, shape (m, 2), NaN where missing."""
        self._frames += 1
        seen = np.isfinite(positions_px[:, 0])
        if not seen.any():
            return
        moved = (positions_px[seen] - self._first[seen]).mean(axis=0)
        self._low, self._high = np.minimum(self._low, moved), np.maximum(self._high, moved)
        axis = int(np.argmax(self._high - self._low))
        extent = float(self._high[axis] - self._low[axis])
        if extent > GROWN * self._counted_px:
            self._passes, self._counted_px = 0, extent
        reach = SIDE * extent
        off = float(moved[axis] - 0.5 * (self._low[axis] + self._high[axis]))
        side = int(np.sign(off)) if abs(off) > reach else 0
        if side and side != self._side:
            self._passes += self._side != 0
            self._side = side

    def assigned(self, motion_px: FloatArray, form_px: FloatArray) -> None:
        """After an assignment: its motion from the expected positions, NaN where none was found, and all markers."""
        found = bool(np.all(np.isfinite(motion_px)))
        missed = float(np.hypot(*motion_px)) if found else self._sd_px * GROWTH
        self._sd_px, self._frames = max(missed, self.sd_px()), 0
        self.form_px = form_px

    def sd_px(self) -> float:
        """Uncertainty of predictions: the largest recent error, which fades while nothing unexpected happens."""
        return float(max(self._sd_px * FADING**self._frames, FIRST_SD_PX))

    def is_unpredictable(self, share: float) -> bool:
        """Whether predictions err by more than this share of the spacing between markers."""
        return self.sd_px() > share * float(spacing_px(self.form_px, self._size).min())

    def expect(self, predicted_px: FloatArray, known: BoolArray) -> Expectation:
        """Where markers are expected, from predictions, shape (m, 2), of those `known` in the last frame."""
        extent = float((self._high - self._low).max())
        swings = self._passes >= PASSES
        if swings and (self.sd_px() > POOR * extent or not known.any()):
            # The middle of the range; anywhere within it is equally probable.
            where, sd_px = self._first + 0.5 * (self._low + self._high), float("inf")
        elif known.any():
            common = self.form_px + np.median(predicted_px[known] - self.form_px[known], axis=0)
            near = np.hypot(*(predicted_px - common).T) < CONSISTENT * spacing_px(self.form_px, self._size)
            where, sd_px = np.where((known & near)[:, None], predicted_px, common), self.sd_px()
        else:
            where, sd_px = self.form_px, self.sd_px()
        if not swings:
            return Expectation(where, sd_px)
        moved = (where - self._first).mean(axis=0)
        limits = np.stack([self._low, self._high]) - moved
        return Expectation(where, sd_px, limits, BEYOND * extent + FIRST_SD_PX)

"""Where a marker will be in the next frame, from where it has been."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tracker.arrays import FloatArray

# Extrapolation by polynomials of degree 0 to 3 through the last positions, the latest first.
WEIGHTS = np.array(
    [
        [1.0, 0.0, 0.0, 0.0],
        [2.0, -1.0, 0.0, 0.0],
        [3.0, -3.0, 1.0, 0.0],
        [4.0, -6.0, 4.0, -1.0],
    ]
)
# The parabola through three positions at the four times before them, the latest first.
BACKWARDS = np.array([[3.0, -3.0, 1.0], [6.0, -8.0, 3.0], [10.0, -15.0, 6.0], [15.0, -24.0, 10.0]])
# Share of the newest error in the running mean that picks the degree.
MEMORY = 0.2
# A marker that is lost is extrapolated this long; then its last position is the centre of the search.
LONGEST_EXTRAPOLATION = 4
# past (m, 4, 2), error (m, 4), known (m,), lost (m,) and trusted (m, 4) of a `Predictor`.
Memory = tuple[FloatArray, FloatArray, NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]


@njit(cache=True, nogil=True, error_model="numpy")
def _guess(past: FloatArray, degree: int, weights: FloatArray, guess: FloatArray) -> None:
    for c in range(2):
        total = 0.0
        for j in range(degree + 1):
            total += weights[degree, j] * past[j, c]
        guess[c] = total


@njit(cache=True, nogil=True, error_model="numpy")
def _best_degree(error: FloatArray, known: int) -> int:
    best = 0
    for degree in range(1, min(known, 4)):
        if error[degree] < error[best]:
            best = degree
    return best


@njit(cache=True, nogil=True, error_model="numpy")
def predict_all(
    past: FloatArray,
    error: FloatArray,
    known: NDArray[np.int64],
    weights: FloatArray,
    aims: FloatArray,
    velocity: FloatArray,
) -> None:
    """Fill predicted positions and the motion expected during the frame, both of shape (m, 2)."""
    for k in range(past.shape[0]):
        _guess(past[k], _best_degree(error[k], known[k]), weights, aims[k])
        for c in range(2):
            # Midway between the last step and the predicted one.
            step = 0.5 * (aims[k, c] - past[k, 1, c])
            velocity[k, c] = step if known[k] >= 2 and np.isfinite(step) else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def update_all(
    past: FloatArray,
    error: FloatArray,
    known: NDArray[np.int64],
    lost: NDArray[np.int64],
    trusted: NDArray[np.bool_],
    weights: FloatArray,
    memory: float,
    longest: int,
    places: FloatArray,
) -> None:
    """Take the positions of a frame into the history; NaN where missing."""
    guess = np.empty(2)
    newest = np.empty(2)
    for k in range(past.shape[0]):
        seen = np.isfinite(places[k, 0]) and np.isfinite(places[k, 1])
        if seen and lost[k] == 0:
            for degree in range(4):
                _guess(past[k], degree, weights, guess)
                miss = np.hypot(guess[0] - places[k, 0], guess[1] - places[k, 1])
                # A degree is judged by errors of at most a marker's distance, else one jump rules for long.
                fresh = min(miss, 10.0) if np.isfinite(miss) else 10.0
                error[k, degree] += memory * (fresh - error[k, degree])
        if seen:
            newest[0], newest[1] = places[k, 0], places[k, 1]
        elif lost[k] < longest:
            _guess(past[k], _best_degree(error[k], known[k]), weights, newest)
        else:
            newest[0], newest[1] = past[k, 0, 0], past[k, 0, 1]
        # Entry by entry: numba compiles for two seconds at the error text of an array's assignment.
        for j in range(3, 0, -1):
            for c in range(2):
                past[k, j, c] = past[k, j - 1, c]
            # Seen again, the marker was not where it was thought to be meanwhile.
            trusted[k, j] = trusted[k, j - 1] and not (seen and j <= lost[k])
        past[k, 0, 0], past[k, 0, 1] = newest[0], newest[1]
        trusted[k, 0] = seen or (lost[k] < longest and known[k] >= 3)
        if seen:
            known[k] = min(known[k] + 1, 4)
            lost[k] = 0
        else:
            lost[k] += 1


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
        # Positions that were measured, or foretold for a frame or so from such.
        self._trusted = np.zeros((markers, 4), dtype=np.bool_)

    def start(self, marker: int, position_px: FloatArray) -> None:
        """Begin a marker anew at a position without history."""
        self._past[marker] = position_px
        self._known[marker] = 1
        self._lost[marker] = 0

    def start_moving(self, marker: int, first_px: FloatArray) -> None:
        """Begin a marker with its positions in the three frames to come, shape (3, 2): the past they continue."""
        self._past[marker] = BACKWARDS @ first_px
        self._known[marker] = 3
        self._trusted[marker] = True
        # The parabola is how this past was made.
        self._error[marker, 2] = 0.5 * self._error[marker, 0]
        self._lost[marker] = 0

    @property
    def memory(self) -> Memory:
        """What `predict_all` and `update_all` work on, themselves and not copies."""
        return self._past, self._error, self._known, self._lost, self._trusted

    def predict(self) -> tuple[FloatArray, FloatArray]:
        """Positions in the next frame and motion from frame to frame there; both of shape (m, 2), in px."""
        aims, velocity = np.empty((self._known.size, 2)), np.empty((self._known.size, 2))
        predict_all(self._past, self._error, self._known, WEIGHTS, aims, velocity)
        return aims, velocity

    def passed(self) -> tuple[FloatArray, FloatArray]:
        """Motion from frame to frame and its change, at the frame before the latest; both of shape (m, 2), in px.

        The slope of the cubic through the last four positions, whose error is that of the fourth derivative, and the
        central second difference; where the latest is missing, with its prediction. NaN where a marker had been lost.
        """
        after, here, before, first = (self._past[:, j] for j in range(4))
        motion = (2.0 * after + 3.0 * here - 6.0 * before + first) / 6.0
        motion = np.where(self._trusted[:, 3:] & np.isfinite(first), motion, 0.5 * (after - before))
        bend = after - 2.0 * here + before
        trusted = np.all(self._trusted[:, :3], axis=1)[:, None]
        return np.where(trusted, motion, np.nan), np.where(trusted, bend, np.nan)

    def update(self, position_px: FloatArray) -> None:
        """Take the positions of a frame, NaN where missing; shape (m, 2)."""
        update_all(
            self._past,
            self._error,
            self._known,
            self._lost,
            self._trusted,
            WEIGHTS,
            MEMORY,
            LONGEST_EXTRAPOLATION,
            position_px,
        )

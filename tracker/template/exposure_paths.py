"""Motion of a marker in the calibration frames: extrapolation, and its path during each exposure."""

from __future__ import annotations

import numpy as np

from tracker.arrays import FloatArray
from tracker.template.blur import SMALLEST_PX, exposed_path_px, path_length_px

# Frames with the least motion during the exposure, from which a template is learned.
LEAST_SHARP = 12


def extrapolated(past: list[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Next position by the polynomial through up to three positions, and the motion from frame to frame there."""
    last = past[-1]
    if len(past) == 1:
        return last, np.zeros(2)
    if len(past) == 2:
        return 2.0 * last - past[0], last - past[0]
    ahead = 3.0 * last - 3.0 * past[1] + past[0]
    return ahead, 0.5 * (ahead - past[1]) + (ahead - 2.0 * last + past[1])


def _motion(states: FloatArray) -> FloatArray:
    """Motion from frame to frame at each frame, by differences over four or two; 0 where a neighbour is missing."""
    motion = np.zeros((len(states), 2))
    if len(states) > 2:
        motion[1:-1] = 0.5 * (states[2:, :2] - states[:-2, :2])
        if len(states) > 4:
            wider = (4.0 * motion[2:-2] - 0.25 * (states[4:, :2] - states[:-4, :2])) / 3.0
            motion[2:-2] = np.where(np.isfinite(wider), wider, motion[2:-2])
        motion[0], motion[-1] = 2.0 * motion[1] - motion[2], 2.0 * motion[-2] - motion[-3]
    return np.where(np.isfinite(motion), motion, 0.0)


def _bend(states: FloatArray) -> FloatArray:
    """Second difference of the position at each frame; 0 where a neighbour is missing."""
    bend = np.zeros((len(states), 2))
    if len(states) > 2:
        bend[1:-1] = states[2:, :2] - 2.0 * states[1:-1, :2] + states[:-2, :2]
        bend[0], bend[-1] = bend[1], bend[-2]
    return np.where(np.isfinite(bend), bend, 0.0)


def path_derivatives_px(states: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Motion from frame to frame and its change at each frame, both of shape (n, 2); 0 where unknown."""
    return _motion(states), _bend(states)


def paths_px(states: FloatArray, exposure_share: float) -> FloatArray:
    """Path during the exposure of each frame, shape (n, 2, 2); see `tracker.template.blur.exposed_path_px`."""
    motion, bend = path_derivatives_px(states)
    return np.array([exposed_path_px(m, b, exposure_share) for m, b in zip(motion, bend, strict=True)])


def sharp_states(states: FloatArray, exposure_share: float) -> FloatArray:
    """States without those of blurred frames, as long as there are enough sharp ones."""
    if exposure_share == 0.0:
        return states
    length = np.array([path_length_px(p) for p in paths_px(states, exposure_share)])
    seen = np.all(np.isfinite(states), axis=1)
    if not seen.any():
        return states
    enough = float(np.sort(length[seen])[min(LEAST_SHARP, int(np.count_nonzero(seen))) - 1])
    return np.where((length <= max(enough, SMALLEST_PX))[:, None], states, np.nan)


def typical_chi2(chi2: FloatArray, states: FloatArray, exposure_share: float) -> float:
    """Median of chi-square over frames that did not determine the template.

    A template learned from a dozen sharp frames contains their noise and fits them too well: the next sharpest frames
    are used where there are as many. Without blur the template is learned from many frames, and all are used.
    """
    fitted = np.isfinite(chi2)
    learned = np.all(np.isfinite(sharp_states(states, exposure_share)), axis=1) & fitted
    others = np.flatnonzero(fitted & ~learned)
    if others.size < LEAST_SHARP:
        return float(np.nanmedian(chi2))
    length = np.array([path_length_px(p) for p in paths_px(states, exposure_share)])
    return float(np.median(chi2[others[np.argsort(length[others])[: 2 * LEAST_SHARP]]]))

"""Stretches in which the picture stands still although the scene was moving: padding by a camera or a converter."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tracker.arrays import FloatArray

LEAST_FRAMES = 8
# Slower than this share of the usual motion is a candidate.
SLOW = 0.2
# A vibration slows down before it turns: over so many slow frames the speed changes by at most a quarter of
# the limit a frame, which makes this ratio at most 2. A frozen picture stops within a frame.
ABRUPTNESS = 3.0
FRAMES_BEFORE = 2


def frozen_frames(x_px: FloatArray, y_px: FloatArray) -> NDArray[np.bool_]:
    """Frames that repeat the picture before them, told by all markers stopping at once.

    Codecs with losses do not repeat a picture bit by bit, so comparing pictures is not enough.

    Parameters
    ----------
    x_px, y_px : array, shape (n, m)
        NaN where missing; a frame in which every marker is missing is never frozen.

    Returns
    -------
    bool array, shape (n,)
        True from the first repeated frame of a run of eight or more on.
    """
    n = x_px.shape[0]
    frozen = np.zeros(n, dtype=bool)
    if n < LEAST_FRAMES + FRAMES_BEFORE + 1:
        return frozen
    moved = np.hypot(np.diff(x_px, axis=0), np.diff(y_px, axis=0))
    # fmax over nothing but NaN is NaN, without the warning of nanmax.
    step = np.fmax.reduce(moved, axis=1)
    usual = float(np.nanmedian(step)) if np.any(np.isfinite(step)) else 0.0
    slow = step < SLOW * usual
    edges = np.flatnonzero(np.diff(np.concatenate([[False], slow, [False]]).astype(np.int8)))
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        before = step[max(start - FRAMES_BEFORE, 0) : start]
        before = before[np.isfinite(before)]
        long_enough = stop - start >= LEAST_FRAMES and before.size > 0
        if long_enough and float(before.max()) > ABRUPTNESS * float(step[start:stop].max()):
            frozen[start + 1 : stop + 1] = True
    return frozen

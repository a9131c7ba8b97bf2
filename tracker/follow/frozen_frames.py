"""Detection of repeated frames: a camera or converter pads a recording although the scene was moving."""

from __future__ import annotations

import numpy as np

from tracker.arrays import BoolArray, FloatArray

LEAST_FRAMES = 8
# Motion below this share of the median motion is a candidate.
SLOW = 0.2
# A vibration slows down before it reverses: over this many slow frames the speed changes by at most a quarter of
# the limit per frame, so this ratio is at most 2. A repeated image stops within one frame.
ABRUPTNESS = 3.0
FRAMES_BEFORE = 2


def frozen_frames(x_px: FloatArray, y_px: FloatArray) -> BoolArray:
    """Frames that repeat the previous image, recognised by all markers stopping at once.

    Lossy codecs do not repeat an image bit by bit, so comparing images is not sufficient. The positions have shape
    (n, m), the result (n,): True from the first repeated frame of a run of eight or more on. A frame in which every
    marker is missing is never frozen.
    """
    n = x_px.shape[0]
    frozen = np.zeros(n, dtype=bool)
    if n < LEAST_FRAMES + FRAMES_BEFORE + 1:
        return frozen
    moved = np.hypot(np.diff(x_px, axis=0), np.diff(y_px, axis=0))
    # fmax of NaN alone is NaN, without the warning of nanmax.
    step = np.fmax.reduce(moved, axis=1)
    median = float(np.nanmedian(step)) if np.any(np.isfinite(step)) else 0.0
    slow = step < SLOW * median
    edges = np.flatnonzero(np.diff(np.concatenate([[False], slow, [False]]).astype(np.int8)))
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        before = step[max(start - FRAMES_BEFORE, 0) : start]
        before = before[np.isfinite(before)]
        long_enough = stop - start >= LEAST_FRAMES and before.size > 0
        if long_enough and float(before.max()) > ABRUPTNESS * float(step[start:stop].max()):
            frozen[start + 1 : stop + 1] = True
    return frozen

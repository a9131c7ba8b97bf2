"""Points that a user may want to follow as patches: texture that moves, in a film without markers."""

from __future__ import annotations

import cv2
import numpy as np

from tracker.arrays import FloatArray, GrayImage
from tracker.video.gray import to_8_bit

# Side of the window about a point; the smallest of a patch.
WINDOW_PX = 31
# Frames used, evenly spread over those given.
FRAMES = 16
# Change over time, in standard deviations of that of the still part, from which a window moves.
_MOVES = 3.0
# Share of the best score below which a point is not proposed.
_WORTH = 0.05


def propose_points(frames: list[GrayImage], most: int = 6) -> FloatArray:
    """Centres of at most `most` windows with texture in both directions that change over time, best first.

    The score of a window is the smaller eigenvalue of its structure tensor, after Shi and Tomasi, times the mean
    change of its pixels over the frames beyond that of the still part of the image. Windows do not overlap.

    Parameters
    ----------
    frames : list of arrays, shape (height, width)
        A few frames in which the object moves.

    Returns
    -------
    array, shape (k, 2)
        x and y in px; empty where nothing moves or the image is smaller than two windows.
    """
    picks = sorted({int(k) for k in np.linspace(0, len(frames) - 1, FRAMES)})
    stack = np.array([to_8_bit(frames[k]) for k in picks], dtype=np.float32)
    height, width = stack.shape[1:]
    if len(stack) < 3 or min(height, width) < 2 * WINDOW_PX:
        return np.empty((0, 2))
    size = (WINDOW_PX, WINDOW_PX)
    change = cv2.blur(stack.std(axis=0), size)
    still = float(np.median(change))
    spread = 1.4826 * float(np.median(np.abs(change - still)))
    # Differences of neighbouring windows without motion are those of the noise, at least those of rounding.
    beyond = np.maximum(change - still - _MOVES * max(spread, 0.02), 0.0)
    down, across = np.gradient(cv2.GaussianBlur(stack[0], (0, 0), 1.0))
    xx, yy, xy = (cv2.blur(product, size) for product in (across**2, down**2, across * down))
    weak = 0.5 * (xx + yy - np.sqrt((xx - yy) ** 2 + 4.0 * xy**2))
    score = np.maximum(weak, 0.0) * beyond
    margin = WINDOW_PX // 2 + 3
    inside = np.zeros_like(score)
    inside[margin:-margin, margin:-margin] = score[margin:-margin, margin:-margin]
    return _peaks(inside, most)


def _peaks(score: FloatArray, most: int) -> FloatArray:
    """Largest values, each a window away from the larger ones."""
    left, found = score.copy(), []
    for _ in range(most):
        y, x = np.unravel_index(int(np.argmax(left)), left.shape)
        if left[y, x] <= _WORTH * score.max():
            break
        found.append((float(x), float(y)))
        left[max(y - WINDOW_PX, 0) : y + WINDOW_PX + 1, max(x - WINDOW_PX, 0) : x + WINDOW_PX + 1] = 0.0
    return np.array(found).reshape(-1, 2)

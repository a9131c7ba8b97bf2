"""Points that a user may want to follow as patches: texture that moves, in a film without markers."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from tracker.arrays import FloatArray, GrayImage
from tracker.video import to_8_bit

Image = NDArray[np.float32]

# Side of the window about a point; the smallest of a patch.
WINDOW_PX = 31
# Frames used, evenly spread over those given.
FRAMES = 16
# Change over time, in standard deviations of that of the still part, from which a window moves; at least this many gray
# levels, which rounding leaves.
_MOVES, _LEAST_SPREAD = 3.0, 0.02
# Blur before differentiation, and the eigenvalue of the structure tensor that is added to those of bare windows.
_BLUR_PX, _BARE = 1.0, 1.0
# Share of the change that a shift explains of a window that moves as a whole. Filmed forks: 0.58 to 0.94 at their
# weights, 0.03 to 0.32 at turning gears beside them.
_RIGID = 0.5
# Share of the best score below which a point is not proposed.
_WORTH = 0.05


def propose_points(frames: list[GrayImage], most: int = 6) -> FloatArray:
    """Centres of at most `most` windows with texture that moves, best first.

    First those that move as a whole: a shift (Lucas and Kanade) explains most of the change of their pixels, in which
    the noise of single pixels averages out, so that a motion of a tenth of a pixel shows. They are ranked by that
    change times the root of the smaller eigenvalue of the structure tensor, after Shi and Tomasi. Then those whose
    pixels change in another way, as by a motion of many pixels, ranked by the mean change times the eigenvalue. Both
    changes count beyond that of the still part of the image. Windows do not overlap.

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
    mean = stack.mean(axis=0)
    changes = _without_flicker(stack - mean, mean)
    down, across = np.gradient(cv2.GaussianBlur(mean, (0, 0), _BLUR_PX))
    tensor = tuple(_windowed(product) for product in (across**2, down**2, across * down))
    xx, yy, xy = tensor
    weak = np.maximum(0.5 * (xx + yy - np.sqrt((xx - yy) ** 2 + 4.0 * xy**2)), 0.0)
    explained, total = _explained_by_shift(changes, (across, down), tensor)
    rigid = _beyond_still(np.sqrt(explained)) * (explained > _RIGID * total)
    other = _beyond_still(_windowed(changes.std(axis=0)))
    found: list[tuple[float, float]] = []
    for score in (np.sqrt(weak) * rigid, weak * other):
        _add_peaks(found, score, most)
    return np.array(found).reshape(-1, 2)


def _windowed(image: Image) -> Image:
    """Mean over the window about each pixel."""
    return np.asarray(cv2.blur(image, (WINDOW_PX, WINDOW_PX)))


def _without_flicker(changes: Image, mean: Image) -> Image:
    """Changes of each frame, shape (n, height, width), less those of the brightness of the whole picture."""
    basis = np.column_stack([np.ones(mean.size, np.float32), mean.ravel()])
    flat = changes.reshape(len(changes), -1)
    common = np.linalg.lstsq(basis, flat.T, rcond=None)[0]
    return np.asarray((flat - common.T @ basis.T).reshape(changes.shape))


def _explained_by_shift(
    changes: Image, slopes: tuple[Image, Image], tensor: tuple[Image, ...]
) -> tuple[Image, Image]:
    """Mean square over the frames of the change that the best shift of each window explains, and of all change."""
    (across, down), (xx, yy, xy) = slopes, tensor
    xx, yy = xx + _BARE, yy + _BARE
    explained, total = np.zeros_like(across), np.zeros_like(across)
    for change in changes:
        smooth = cv2.GaussianBlur(change, (0, 0), _BLUR_PX)
        x, y = _windowed(across * smooth), _windowed(down * smooth)
        explained += (yy * x**2 - 2.0 * xy * x * y + xx * y**2) / (xx * yy - xy**2)
        total += _windowed(smooth**2)
    count = np.float32(len(changes))
    return np.asarray(explained / count), np.asarray(total / count)


def _beyond_still(change: Image) -> Image:
    """Change of each window beyond that of the still part of the image."""
    still = float(np.median(change))
    spread = 1.4826 * float(np.median(np.abs(change - still)))
    return np.asarray(np.maximum(change - still - _MOVES * max(spread, _LEAST_SPREAD), 0.0))


def _add_peaks(found: list[tuple[float, float]], score: Image, most: int) -> None:
    """Add the largest values away from the edges of the picture, each a window away from those found before."""
    margin = WINDOW_PX // 2 + 3
    left = np.zeros_like(score)
    left[margin:-margin, margin:-margin] = score[margin:-margin, margin:-margin]
    least = _WORTH * float(left.max())
    for x, y in found:
        _take_out(left, round(x), round(y))
    while len(found) < most:
        row, column = np.unravel_index(int(np.argmax(left)), left.shape)
        if left[row, column] <= least:
            return
        found.append((float(column), float(row)))
        _take_out(left, int(column), int(row))


def _take_out(score: Image, x: int, y: int) -> None:
    score[max(y - WINDOW_PX, 0) : y + WINDOW_PX + 1, max(x - WINDOW_PX, 0) : x + WINDOW_PX + 1] = 0.0

"""Coarse search of a line in an image: the best path through its strip of pixels along a guessed curve."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numba import njit

from tracker.arrays import FloatArray, GrayImage, IntArray
from tracker.line.curve import CurveAt

# Largest slope of a path against the guessed curve.
LARGEST_SLOPE = 0.8
# Cost of each px by which a path changes its slope, relative to a typical score.
BEND_COST = 0.15
STRIP_WIDTHS_PX = (2, 3, 4, 6, 8, 11, 15, 20, 28, 40)
EDGE_REACH_PX = 3
# A strip is preferred to an edge if its score is at least this share of the edge's.
STRIP_SHARE = 0.6


def straightened(image: GrayImage, curve: CurveAt, reach_px: int, along_px: float) -> FloatArray:
    """Gray levels across a curve, shape (m, 2 reach + 1), averaged over `along_px`; the border repeats outside."""
    across = np.arange(-reach_px, reach_px + 1, dtype=np.float64)
    total = np.zeros((len(curve.points), across.size))
    source = image.astype(np.float32)
    parts = (-0.5, 0.0, 0.5)
    for part in parts:
        start = curve.points + part * along_px * curve.tangents
        x = start[:, :1] + across * curve.normals[:, :1]
        y = start[:, 1:] + across * curve.normals[:, 1:]
        total += cv2.remap(
            source,
            x.astype(np.float32),
            y.astype(np.float32),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
    return np.asarray(total / len(parts))


@njit(cache=True, nogil=True)
def best_path(score: FloatArray, steepest: int, cost: float) -> IntArray:
    """Path of the largest total score, one column for each row; shape (m,).

    From row to row it moves by at most `steepest` columns; each column of it costs `cost`. Columns with a score of
    -inf are forbidden.
    """
    rows, columns = score.shape
    total = score.copy()
    came = np.zeros((rows, columns), dtype=np.int64)
    for k in range(1, rows):
        for j in range(columns):
            best, where = -np.inf, j
            for i in range(max(j - steepest, 0), min(j + steepest, columns - 1) + 1):
                value = total[k - 1, i] - cost * abs(i - j)
                if value > best:
                    best, where = value, i
            total[k, j] += best
            came[k, j] = where
    path = np.empty(rows, dtype=np.int64)
    path[rows - 1] = np.argmax(total[rows - 1])
    for k in range(rows - 1, 0, -1):
        path[k - 1] = came[k, path[k]]
    return path


@dataclass(frozen=True)
class FoundPath:
    """A path: offsets along the normals of the guess (m,), what it follows, its width, and its contrast (m,).

    `width_px` is 0 for an edge; the contrast is in gray levels.
    """

    offsets_px: FloatArray
    feature: Literal["strip", "edge"]
    width_px: float
    contrast: FloatArray


def find_path(
    across: FloatArray, spacing_px: float, feature: Literal["strip", "edge", "auto"], ends_px: float
) -> FoundPath:
    """The strip or edge of the largest contrast in a straightened image, from end to end of the guess.

    At both ends the path is within `ends_px` of the guess, farther in between.
    """
    m, columns = across.shape
    reach = columns // 2
    from_end = np.minimum(np.arange(m) + 0.5, m - 0.5 - np.arange(m)) * spacing_px
    allowed = np.abs(np.arange(columns) - reach)[None, :] <= ends_px + LARGEST_SLOPE * from_end[:, None]
    found: dict[str, FoundPath] = {}
    merit: dict[str, float] = {}
    for width in (*STRIP_WIDTHS_PX, 0):
        kind: Literal["strip", "edge"] = "strip" if width else "edge"
        if feature not in (kind, "auto") or 2 * width + 6 > columns:
            continue
        response = _strip_response(across, width) if width else _edge_response(across)
        for sign in (1.0, -1.0):
            score = np.where(allowed, np.maximum(sign * response, 0.0), -np.inf)
            cost = BEND_COST * float(np.quantile(score[np.isfinite(score)], 0.95))
            path = best_path(score, int(np.ceil(LARGEST_SLOPE * spacing_px)), cost)
            contrast = score[np.arange(m), path]
            # Wider means average more pixels: the signal-to-noise ratio selects the width.
            value = float(np.mean(contrast)) * np.sqrt(min(width, 12)) if width else float(np.mean(contrast))
            if value > merit.get(kind, 0.0):
                merit[kind] = value
                found[kind] = FoundPath((path - reach).astype(np.float64), kind, float(width), contrast)
    if not found:
        return FoundPath(np.zeros(m), "edge", 0.0, np.zeros(m))
    if "strip" in found and "edge" in found:
        strip, edge = found["strip"], found["edge"]
        return strip if strip.contrast.mean() >= STRIP_SHARE * edge.contrast.mean() else edge
    return next(iter(found.values()))


def _means(across: FloatArray, count: int) -> FloatArray:
    """Means over `count` columns; column j of the result begins at column j of the image."""
    total = np.cumsum(np.pad(across, ((0, 0), (1, 0))), axis=1)
    return np.asarray((total[:, count:] - total[:, :-count]) / count)


def _strip_response(across: FloatArray, width: int) -> FloatArray:
    """Smaller of the differences between a strip of this width and the surface on either side of it."""
    flank = max(2, width // 2)
    margin = width // 2 + 1 + flank
    padded = np.pad(across, ((0, 0), (margin + 1, margin + 1)), mode="edge")
    columns = np.arange(across.shape[1]) + margin + 1
    inner, outer = _means(padded, width), _means(padded, flank)
    start = columns - (width - 1) // 2
    one = inner[:, start] - outer[:, start - 1 - flank]
    other = inner[:, start] - outer[:, start + width + 1]
    same = np.sign(one) == np.sign(other)
    return np.asarray(np.where(same, np.sign(one) * np.minimum(np.abs(one), np.abs(other)), 0.0))


def _edge_response(across: FloatArray) -> FloatArray:
    """Difference of the surfaces on the side of the normal and on the other."""
    reach = EDGE_REACH_PX
    padded = np.pad(across, ((0, 0), (reach + 1, reach + 1)), mode="edge")
    means = _means(padded, reach)
    columns = np.arange(across.shape[1]) + reach + 1
    return np.asarray(means[:, columns + 1] - means[:, columns - reach])


def centred(image: GrayImage, points_px: FloatArray, path: FoundPath, flank_px: float) -> FloatArray:
    """Points near a strip, moved to the centre of its contrast up to `flank_px` beside it; of an edge as they are."""
    if path.feature == "edge":
        return points_px
    tangents = np.gradient(points_px, axis=0)
    spacing = np.linalg.norm(tangents, axis=1)
    curve = CurveAt(points_px, tangents / spacing[:, None], np.zeros(len(points_px)), spacing)
    reach = int(np.ceil(0.5 * path.width_px + flank_px))
    levels = straightened(image, curve, reach, 0.5 * float(np.median(spacing)))
    across = np.arange(-reach, reach + 1.0)
    outer = np.abs(across) > reach - 2
    excess = levels - levels[:, outer].mean(axis=1, keepdims=True)
    excess *= np.sign(np.median(excess[:, reach]))
    # Half of the contrast is far above noise and texture.
    excess = np.maximum(excess - 0.5 * np.max(excess, axis=1, keepdims=True), 0.0)
    off = np.sum(excess * across, axis=1) / np.maximum(np.sum(excess, axis=1), 1e-9)
    return np.asarray(points_px + off[:, None] * curve.normals)


def matched_offsets(
    across: FloatArray, profiles: FloatArray, spacing_px: float
) -> tuple[FloatArray, FloatArray]:
    """Offset of each station at which a known profile is found, all stations together, and its correlation there.

    Parameters
    ----------
    across : array, shape (m, columns)
        Straightened image, in steps of a px.
    profiles : array, shape (m, width)
        Profile at each station in steps of a px, of odd width; the line is in the middle.
    """
    width = profiles.shape[1]
    half, reach = width // 2, across.shape[1] // 2
    windows = np.lib.stride_tricks.sliding_window_view(across, width, axis=1)
    centred = profiles - profiles.mean(axis=1, keepdims=True)
    product = np.einsum("mjw,mw->mj", windows, centred)
    spread = np.maximum(windows.var(axis=2) * width, 1e-9)
    norm = np.sum(centred**2, axis=1)[:, None]
    correlation = product / np.sqrt(spread * norm)
    # Contrast must be similar too: the noise of a plain surface correlates with anything.
    gain = product / norm
    score = np.clip(correlation, 0.0, 1.0) * np.clip(gain / 0.4, 0.0, 1.0)
    path = best_path(score, int(np.ceil(LARGEST_SLOPE * spacing_px)), 0.05)
    return (path + half - reach).astype(np.float64), score[np.arange(len(path)), path]

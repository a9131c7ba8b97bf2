"""Compiled kernel that adds a bare strip to a frame, integrated over each pixel."""

from __future__ import annotations

from math import ceil, floor, sqrt

import numpy as np
from numba import njit

from sim.render.kernels import REACH, fast_erf, interpolate
from tracker import FloatArray


@njit(cache=True)
def pixel_weights(at: float, count: int, reach: float, scale: float, weights: FloatArray) -> tuple[int, int]:
    """Shares `weights` of a blurred point at `at` in the pixels within `reach` of it, of a line of `count` pixels.

    Returns the first of these pixels and their number.
    """
    first, last = max(0, ceil(at - reach)), min(count - 1, floor(at + reach))
    before = fast_erf((first - 0.5 - at) * scale)
    for k in range(last - first + 1):
        after = fast_erf((first + k + 0.5 - at) * scale)
        weights[k] = 0.5 * (after - before)
        before = after
    return first, max(0, last - first + 1)


@njit(cache=True)
def add_strip_points(
    image: FloatArray,
    along: FloatArray,
    across: FloatArray,
    surface: FloatArray,
    surface_grid: tuple[float, float, float, float],
    backdrop: FloatArray,
    backdrop_grid: tuple[float, float, float, float],
    background: float,
    sigma: float,
) -> None:
    """Add what a strip changes of the background: a sum over points of its surface, each blurred and seen by pixels.

    Parameters
    ----------
    image : array, shape (height, width)
    along : array, shape (n, 7)
        Points of the centreline: x, y, tangent (x, y) in the image, curvature per px (positive turns left, seen with y
        upwards), distance along the strip, weight.
    across : array, shape (m, 2)
        Distances to the left of the centreline, in px, and weights.
    surface, backdrop : array
        Counts of the strip at (distance to the left, distance along); counts above `background` at (y, x). Empty: 0.
    surface_grid, backdrop_grid : tuple of float
        First value and reciprocal step of the rows, and of the columns, of each.
    sigma : float
        Lens blur in px.
    """
    height, width = image.shape
    reach = 0.5 + REACH * sigma
    scale = 1.0 / (sqrt(2.0) * sigma)
    in_x, in_y = np.empty(int(2.0 * reach) + 3), np.empty(int(2.0 * reach) + 3)
    for i in range(along.shape[0]):
        tx, ty, curvature, distance = along[i, 2], along[i, 3], along[i, 4], along[i, 5]
        surface_column = (distance - surface_grid[2]) * surface_grid[3]
        for j in range(across.shape[0]):
            left = across[j, 0]
            x, y = along[i, 0] + left * ty, along[i, 1] - left * tx
            if x < -reach or y < -reach or x > width - 1 + reach or y > height - 1 + reach:
                continue
            value = interpolate(surface, (left - surface_grid[0]) * surface_grid[1], surface_column)
            value -= background
            if backdrop.size:
                row = (y - backdrop_grid[0]) * backdrop_grid[1]
                value -= interpolate(backdrop, row, (x - backdrop_grid[2]) * backdrop_grid[3])
            value *= along[i, 6] * across[j, 1] * (1.0 - curvature * left)
            first_row, rows = pixel_weights(y, height, reach, scale, in_y)
            first_column, columns = pixel_weights(x, width, reach, scale, in_x)
            for k in range(rows):
                share = value * in_y[k]
                for q in range(columns):
                    image[first_row + k, first_column + q] += share * in_x[q]

"""Pixels of the windows of a line's stations, for what is learned from them."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tracker.arrays import FloatArray, GrayImage
from tracker.line import kernel


@njit(cache=True, nogil=True, error_model="numpy")
def most_pixels(stations: kernel.Stations) -> int:
    """Upper bound of the number of pixels of a window: those of the square around it, in any direction."""
    reach = 0.0
    # Entry by entry: compiling the maximum of an array takes numba a second.
    for k in range(stations.half_along.size):
        reach = max(reach, np.hypot(stations.half_along[k], stations.half_across[k]))
    side = 2 * int(reach) + 3
    return side * side


@njit(cache=True, nogil=True, error_model="numpy")
def window_pixels(
    image: GrayImage,
    stations: kernel.Stations,
    k: int,
    shift: float,
    saturation: float,
    places: NDArray[np.int64],
    across: FloatArray,
) -> int:
    """Pixels of a station displaced by `shift` that are in the image and not saturated; returns their number.

    Filled: row and column of each in `places`, shape (2, n), and its distance from the line in `across`, shape (n,).
    """
    box = np.empty(4, dtype=np.int64)
    height, width = image.shape
    tx, ty = stations.tangents[k, 0], stations.tangents[k, 1]
    px, py = stations.points[k, 0] - shift * ty, stations.points[k, 1] + shift * tx
    half_along, half_across = stations.half_along[k], stations.half_across[k]
    bend = 0.5 * stations.curvature[k]
    kernel.box_around(px, py, tx, ty, half_along, half_across, box)
    count = 0
    for row in range(max(box[2], 0), min(box[3], height - 1) + 1):
        y = row - py
        for column in range(max(box[0], 0), min(box[1], width - 1) + 1):
            x = column - px
            u = x * tx + y * ty
            v = y * tx - x * ty - bend * u * u
            if u < -half_along or u >= half_along or v < -half_across or v > half_across:
                continue
            if float(image[row, column]) >= saturation:
                continue
            places[0, count], places[1, count], across[count] = row, column, v
            count += 1
    return count

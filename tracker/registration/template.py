"""The noise-free picture of a marker as a cubic spline on an oversampled grid, in the marker's own frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from tracker.series import FloatArray


@njit(cache=True, nogil=True)
def _fill_cells(coefs: FloatArray, cells: NDArray[np.float32]) -> None:
    """Polynomials of the uniform cubic B-spline in all cells that have their four neighbours."""
    rows, cols = coefs.shape
    basis = np.array(
        [[1.0, 4.0, 1.0, 0.0], [-3.0, 0.0, 3.0, 0.0], [3.0, -6.0, 3.0, 0.0], [-1.0, 3.0, -3.0, 1.0]]
    )
    basis /= 6.0
    along = np.empty((4, 4))
    for r in range(1, rows - 2):
        for c in range(1, cols - 2):
            for k in range(4):
                for i in range(4):
                    total = 0.0
                    for m in range(4):
                        total += basis[i, m] * coefs[r - 1 + k, c - 1 + m]
                    along[k, i] = total
            for i in range(4):
                for j in range(4):
                    total = 0.0
                    for k in range(4):
                        total += basis[j, k] * along[k, i]
                    cells[r, c, 4 * i + j] = total


@dataclass(frozen=True)
class Template:
    """A marker's noise-free picture, interpolated instead of the measured frame.

    The picture already holds the pixel's own area, the lens and the print. A point (u, v) in px of the
    marker's frame, from the marker's centre, lies at grid column ``(cols - 1) / 2 + u * oversampling`` and
    likewise for rows.

    Attributes
    ----------
    coefs : array, shape (rows, cols)
        Coefficients of the uniform cubic B-spline, in gray levels.
    support : uint8 array, shape (rows, cols)
        1 where the picture belongs to the marker, 0 where anything may be seen.
    oversampling : float
        Grid points a px.
    """

    coefs: FloatArray
    support: NDArray[np.uint8]
    oversampling: float

    @cached_property
    def area_px(self) -> float:
        """Area of the support in px of the template's frame."""
        return float(np.count_nonzero(self.support)) / self.oversampling**2

    @cached_property
    def reach_px(self) -> float:
        """Half the diagonal of the support, in px: how far from the centre pixels can matter."""
        rows, cols = np.nonzero(self.support)
        centre = (np.array(self.support.shape) - 1) / 2
        corner = np.hypot(rows - centre[0], cols - centre[1])
        return float(corner.max() / self.oversampling) if rows.size else 0.0

    @cached_property
    def cells(self) -> NDArray[np.float32]:
        """The spline as polynomials, shape (rows, cols, 16).

        Between grid points (r, c) and (r + 1, c + 1) the picture is the sum of
        ``cells[r, c, 4 i + j] t^i s^j``, with t and s in 0..1 along the row and the column.
        """
        cells = np.zeros((*self.coefs.shape, 16), dtype=np.float32)
        _fill_cells(self.coefs, cells)
        return cells

    def values(self) -> FloatArray:
        """The picture at the grid points, in gray levels."""
        return np.asarray(ndimage.convolve(self.coefs, SPLINE_AT_KNOTS, mode="nearest"))


_AXIS = np.array([1.0, 4.0, 1.0]) / 6.0
SPLINE_AT_KNOTS = np.outer(_AXIS, _AXIS)


def from_values(values: FloatArray, support: NDArray[np.uint8], oversampling: float) -> Template:
    """Template whose spline passes through `values` at the grid points."""
    coefs = ndimage.spline_filter(np.asarray(values, dtype=np.float64), order=3, mode="mirror")
    return Template(np.ascontiguousarray(coefs), np.ascontiguousarray(support, dtype=np.uint8), oversampling)


def grid_px(
    half_width_px: float, half_height_px: float, oversampling: float
) -> tuple[FloatArray, FloatArray]:
    """Coordinates (u of the columns, v of the rows) in px of a grid that covers the half sizes and a margin.

    The margin of 3 px lets every pixel of the support find its four spline coefficients.
    """
    columns = int(np.ceil((half_width_px + 3.0) * oversampling))
    rows = int(np.ceil((half_height_px + 3.0) * oversampling))
    u_px = np.arange(-columns, columns + 1) / oversampling
    v_px = np.arange(-rows, rows + 1) / oversampling
    return u_px, v_px

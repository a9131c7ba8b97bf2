"""The noise-free picture of a marker as a cubic spline on an oversampled grid, in the marker's own frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tracker.arrays import FloatArray


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
    def grid(self) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        """Coefficients in single precision and support, without the margins in which there is no support.

        As much is cut off on opposite sides, so that the middle stays the marker's centre.
        """
        rows, cols = self.support.shape
        used_rows, used_cols = np.nonzero(self.support)
        if not used_rows.size:
            return np.ascontiguousarray(self.coefs, dtype=np.float32), self.support
        # Pixels lie within half a step of a grid point in the support and need two grid points farther on.
        top = max(min(int(used_rows.min()), rows - 1 - int(used_rows.max())) - 3, 0)
        left = max(min(int(used_cols.min()), cols - 1 - int(used_cols.max())) - 3, 0)
        inner = np.s_[top : rows - top, left : cols - left]
        return np.ascontiguousarray(self.coefs[inner], dtype=np.float32), np.ascontiguousarray(
            self.support[inner]
        )

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

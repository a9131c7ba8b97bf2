"""Noise-free image of a marker: a cubic spline on an oversampled grid, in the marker's own frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from tracker.arrays import FloatArray, GrayImage, IntArray


@dataclass(frozen=True)
class Tuning:
    """Use of large markers."""

    #: [pixels] beyond which a marker is subsampled
    #: physics: these already determine the position to 1e-4 px
    enough_pixels: float = 8000.0


TUNING = Tuning()


@dataclass(frozen=True)
class Template:
    """Noise-free image of a marker, interpolated instead of the measured frame.

    The image includes the effects of pixel area, lens and print. A point (u, v) in px of the marker's frame, relative
    to the marker's centre, lies at grid column ``(cols - 1) / 2 + u * oversampling``, and likewise for rows. `coefs`
    are those of the uniform cubic B-spline, in gray levels; `support` is 1 where the image belongs to the marker, 0
    where the scene is arbitrary; both have the shape (rows, cols) of the grid.
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
        """Largest distance of the support from the centre, in px."""
        support = self.support > 0
        rows = np.flatnonzero(support.any(axis=1))
        if not rows.size:
            return 0.0
        middle_row, middle = (np.array(support.shape) - 1) / 2
        # The farthest point of a row is its first or its last.
        first, last = support[rows].argmax(axis=1), support.shape[1] - 1 - support[rows, ::-1].argmax(axis=1)
        across = np.maximum(np.abs(first - middle), np.abs(last - middle))
        return float(np.hypot(rows - middle_row, across).max() / self.oversampling)

    @cached_property
    def grid(self) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
        """Coefficients in single precision and support, cropped to the support and its spline neighbourhood.

        Opposite sides are cropped equally, so that the middle remains the marker's centre.
        """
        # Pixels lie within half a step of a grid point in the support and need two grid points beyond it.
        inner = crop_to_support(self.support, 3)
        coefs = np.ascontiguousarray(self.coefs[inner], dtype=np.float32)
        return coefs, np.ascontiguousarray(self.support[inner])

    def values(self) -> FloatArray:
        """The image at the grid points, in gray levels."""
        return np.asarray(ndimage.convolve(self.coefs, SPLINE_AT_KNOTS, mode="nearest"))

    def slopes(self) -> tuple[FloatArray, FloatArray]:
        """Derivatives along the rows (u) and down the columns (v) at the grid points, in gray levels a grid step."""
        u, v = (
            ndimage.correlate1d(
                ndimage.correlate1d(self.coefs, [-0.5, 0.0, 0.5], axis=axis, mode="nearest"),
                _AXIS,
                axis=1 - axis,
                mode="nearest",
            )
            for axis in (1, 0)
        )
        return u, v

    def axes_px(self) -> tuple[FloatArray, FloatArray]:
        """Coordinates (u of the columns, v of the rows) of the grid in px from the centre."""
        rows, cols = self.coefs.shape
        u = (np.arange(cols) - 0.5 * (cols - 1)) / self.oversampling
        v = (np.arange(rows) - 0.5 * (rows - 1)) / self.oversampling
        return u, v

    def sampled(self, points_uv: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Image and support at points of shape (2, ...) in px of the marker's frame; False beyond the grid."""
        rows, cols = self.coefs.shape
        at = points_uv * self.oversampling
        where = [at[1] + 0.5 * (rows - 1), at[0] + 0.5 * (cols - 1)]
        image = ndimage.map_coordinates(self.coefs, where, order=3, mode="nearest", prefilter=False)
        support = ndimage.map_coordinates(self.support, where, order=0, mode="constant") > 0
        return np.asarray(image), np.asarray(support)

    def image_reach_px(self, warp: FloatArray) -> float:
        """Largest distance of the support from the centre in px of a frame that `warp` maps to the marker's frame."""
        return self.reach_px / float(np.linalg.svd(warp, compute_uv=False)[-1]) + 1.0

    def stride(self, warp: FloatArray) -> int:
        """Spacing of the pixels to use: 1 except for large markers."""
        pixels = self.area_px / abs(float(np.linalg.det(warp)))
        return max(1, int(np.sqrt(pixels / TUNING.enough_pixels)))


@lru_cache(maxsize=128)
def quadrature(count: int) -> tuple[FloatArray, FloatArray]:
    """Nodes and weights of Gauss-Legendre quadrature from -1 to 1."""
    return np.polynomial.legendre.leggauss(count)


_AXIS = np.array([1.0, 4.0, 1.0]) / 6.0
SPLINE_AT_KNOTS = np.outer(_AXIS, _AXIS)


def crop_to_support(support: NDArray[np.uint8], margin: int) -> tuple[slice, slice]:
    """Slices that keep the support and `margin` grid points around it, cropping opposite sides equally."""
    rows, cols = support.shape
    used_rows, used_cols = (np.flatnonzero(support.any(axis=axis)) for axis in (1, 0))
    if not used_rows.size:
        return slice(0, rows), slice(0, cols)
    top = max(min(int(used_rows[0]), rows - 1 - int(used_rows[-1])) - margin, 0)
    left = max(min(int(used_cols[0]), cols - 1 - int(used_cols[-1])) - margin, 0)
    return slice(top, rows - top), slice(left, cols - left)


def from_values(values: FloatArray, support: NDArray[np.uint8], oversampling: float) -> Template:
    """Template whose spline passes through `values` at the grid points."""
    coefs = ndimage.spline_filter(np.asarray(values, dtype=np.float64), order=3, mode="mirror")
    return Template(np.ascontiguousarray(coefs), np.ascontiguousarray(support, dtype=np.uint8), oversampling)


def grid_px(
    half_width_px: float, half_height_px: float, oversampling: float
) -> tuple[FloatArray, FloatArray]:
    """Coordinates (u of the columns, v of the rows) in px of a grid that covers the half sizes and a margin.

    With the margin of 3 px every pixel of the support has its four spline coefficients per axis.
    """
    columns = int(np.ceil((half_width_px + 3.0) * oversampling))
    rows = int(np.ceil((half_height_px + 3.0) * oversampling))
    u_px = np.arange(-columns, columns + 1) / oversampling
    v_px = np.arange(-rows, rows + 1) / oversampling
    return u_px, v_px


@njit(cache=True, nogil=True)
def placed(state: FloatArray, warp: FloatArray, oversampling: float, rows: int, cols: int) -> FloatArray:
    """Placement of a template's grid in the image; shape (8,).

    The matrix from pixels to grid points (four, row by row), the grid's centre (u, v), and half the size of the grid's
    bounding box in the image (x, y), px.
    """
    cosine, sine = np.cos(state[2]), np.sin(state[2])
    a00 = (cosine * warp[0, 0] + sine * warp[1, 0]) * oversampling
    a01 = (cosine * warp[0, 1] + sine * warp[1, 1]) * oversampling
    a10 = (-sine * warp[0, 0] + cosine * warp[1, 0]) * oversampling
    a11 = (-sine * warp[0, 1] + cosine * warp[1, 1]) * oversampling
    u0, v0 = 0.5 * (cols - 1), 0.5 * (rows - 1)
    det = abs(a00 * a11 - a01 * a10)
    half_x = (abs(a11) * u0 + abs(a01) * v0) / det
    half_y = (abs(a10) * u0 + abs(a00) * v0) / det
    return np.array([a00, a01, a10, a11, u0, v0, half_x, half_y])


@njit(cache=True, nogil=True)
def fill_taps(t: float, taps: FloatArray) -> None:
    """Weights of the four coefficients around a point at the fraction `t` between the second and the third."""
    s = 1.0 - t
    taps[0] = s * s * s / 6.0
    taps[1] = (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0
    taps[2] = (4.0 - 6.0 * s * s + 3.0 * s * s * s) / 6.0
    taps[3] = t * t * t / 6.0


@njit(cache=True, nogil=True)
def _fill_modelled(
    image: GrayImage,
    state: FloatArray,
    warp: FloatArray,
    coefs: FloatArray,
    oversampling: float,
    where: IntArray,
    values: FloatArray,
) -> int:
    """Fill nearest grid point, pixel and model of each pixel inside the grid, shapes (2, n); their number."""
    rows, cols = coefs.shape
    a00, a01, a10, a11, u0, v0, half_x, half_y = placed(state, warp, oversampling, rows, cols)
    wu = np.empty(4)
    wv = np.empty(4)
    n = 0
    for j in range(max(int(state[1] - half_y), 0), min(int(state[1] + half_y) + 2, image.shape[0])):
        for i in range(max(int(state[0] - half_x), 0), min(int(state[0] + half_x) + 2, image.shape[1])):
            px, py = i - state[0], j - state[1]
            gu = a00 * px + a01 * py + u0
            gv = a10 * px + a11 * py + v0
            iu, iv = int(np.floor(gu)), int(np.floor(gv))
            if iu < 1 or iv < 1 or iu > cols - 3 or iv > rows - 3:
                continue
            fill_taps(gu - iu, wu)
            fill_taps(gv - iv, wv)
            value = 0.0
            for r in range(4):
                for c in range(4):
                    value += wv[r] * wu[c] * coefs[iv - 1 + r, iu - 1 + c]
            where[0, n], where[1, n] = int(gv + 0.5), int(gu + 0.5)
            values[0, n], values[1, n] = image[j, i], state[3] * value + state[4]
            n += 1
    return n


def modelled_pixels(
    image: GrayImage, state: FloatArray, warp: FloatArray, coefs: FloatArray, oversampling: float
) -> tuple[tuple[IntArray, IntArray], FloatArray, FloatArray]:
    """Pixels of a marker inside its template's grid: row and column of the nearest grid point, pixel and model."""
    rows, cols = coefs.shape
    *_, half_x, half_y = placed(state, warp, oversampling, rows, cols)
    most = (int(2.0 * half_x) + 4) * (int(2.0 * half_y) + 4)
    where, values = np.empty((2, most), dtype=np.int64), np.empty((2, most))
    n = _fill_modelled(image, state, warp, coefs, oversampling, where, values)
    return (where[0, :n], where[1, :n]), values[0, :n], values[1, :n]

"""Parametric templates: ArUco cells or a disc, with size and lens blur."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from tracker.arrays import FloatArray
from tracker.template.spline import Template, from_values, grid_px, quadrature

OVERSAMPLING = 4.0
# Below this blur the pixel determines the edge; the closed form needs a positive value.
SMALLEST_BLUR_PX = 0.05


def step_response(t_px: FloatArray, blur_px: float) -> FloatArray:
    """A unit step at 0 after a Gaussian lens blur and integration over a pixel of side 1.

    The integral of the normal distribution function over the pixel, in closed form.
    """
    sigma = max(blur_px, SMALLEST_BLUR_PX)

    def antiderivative(t: FloatArray) -> FloatArray:
        z = t / sigma
        return np.asarray(t * ndtr(z) + sigma * np.exp(-0.5 * z * z) / np.sqrt(2.0 * np.pi))

    return np.asarray(antiderivative(t_px + 0.5) - antiderivative(t_px - 0.5))


def aruco_values(
    u_px: FloatArray, v_px: FloatArray, bits: NDArray[np.uint8], side_px: float, blur_px: float
) -> FloatArray:
    """Brightness of an ArUco marker at points of its own frame: 1 white, also outside, 0 black; shape of the points.

    Parameters
    ----------
    bits : uint8 array, shape (cells, cells)
        1 white, 0 black, black border included.
    side_px, blur_px : float
        Outer side of the black border; standard deviation of the lens blur. The pixel area is integrated along the
        marker's axes.
    """
    across = _cells(u_px, bits.shape[1], side_px, blur_px)
    down = _cells(v_px, bits.shape[0], side_px, blur_px)
    black = 1.0 - bits.astype(np.float64)
    return np.asarray(1.0 - np.einsum("i...,ij,j...->...", down, black, across, optimize=True))


def _cells(t_px: FloatArray, cells: int, side_px: float, blur_px: float) -> FloatArray:
    """Share of each cell in a pixel at `t_px`; shape (cells, ...)."""
    edges = side_px * (np.arange(cells + 1) / cells - 0.5)
    steps = np.stack([step_response(t_px - edge, blur_px) for edge in edges])
    return steps[:-1] - steps[1:]


def aruco_template(bits: NDArray[np.uint8], side_px: float, blur_px: float) -> Template:
    """Template of an ArUco marker; its support ends in the quiet zone.

    It includes a white rim of three quarters of a cell, at least 2.5 px, around the black border: a wider quiet zone
    may not exist.
    """
    rim = max(2.5, 0.75 * side_px / bits.shape[0])
    u, v = grid_px(0.5 * side_px + rim, 0.5 * side_px + rim, OVERSAMPLING)
    across = _cells(u, bits.shape[1], side_px, blur_px)
    down = _cells(v, bits.shape[0], side_px, blur_px)
    values = 1.0 - down.T @ (1.0 - bits.astype(np.float64)) @ across
    support = np.maximum(np.abs(v)[:, None], np.abs(u)[None, :]) <= 0.5 * side_px + rim
    return from_values(values, support.astype(np.uint8), OVERSAMPLING)


def disc_values(u_px: FloatArray, v_px: FloatArray, radius_px: float, blur_px: float) -> FloatArray:
    """Brightness of a disc on a grid: 1 inside, 0 outside; shape (v, u).

    Chords are integrated in closed form across, and by Gauss-Legendre quadrature down with the row at
    radius * sin(angle).
    """
    # Ten nodes per px of the radius: their spacing is below the narrowest pulse of a pixel and its blur.
    points, weights = quadrature(64 + 10 * int(np.ceil(abs(radius_px))))
    angle = 0.5 * np.pi * points
    row, half = radius_px * np.sin(angle), radius_px * np.cos(angle)
    # The nodes are symmetric about 0, and so are the chords.
    lower = half[: (half.size + 1) // 2, None]
    left, right = (step_response(u_px[None, :] + end, blur_px) for end in (lower, -lower))
    chords = np.concatenate([left - right, (left - right)[: half.size // 2][::-1]])
    # d row = radius cos(angle) d angle; the vertical response is the derivative of the step response.
    sigma = max(blur_px, SMALLEST_BLUR_PX)
    offset = v_px[:, None] - row[None, :]
    pulse = ndtr((offset + 0.5) / sigma) - ndtr((offset - 0.5) / sigma)
    return np.asarray(pulse @ (chords * (0.5 * np.pi * weights * half)[:, None]))


def disc_template(radius_px: float, blur_px: float) -> Template:
    """Template of a dot; its support ends 2.5 px outside the rim."""
    reach = radius_px + max(2.5, 2.5 * blur_px + 0.7)
    u, v = grid_px(reach, reach, OVERSAMPLING)
    support = np.hypot(v[:, None], u[None, :]) <= reach
    return from_values(disc_values(u, v, radius_px, blur_px), support.astype(np.uint8), OVERSAMPLING)

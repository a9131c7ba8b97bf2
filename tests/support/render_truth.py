"""Pixel values computed independently of the renderer: integrals over the shape, in the axes of the image.

A pixel is the integral over the shape of (unit box * Gaussian), which is a product in x and y whatever the shape's
rotation. Along y it has an antiderivative; along x it is integrated adaptively between the shape's corners.
"""

from itertools import pairwise

import numpy as np
from scipy.integrate import quad
from scipy.special import ndtr

from sim.render import Poses


def box_gauss(t, sigma):
    return ndtr((t + 0.5) / sigma) - ndtr((t - 0.5) / sigma)


def box_gauss_integral(t, sigma):
    def psi(z):
        return z * ndtr(z) + np.exp(-0.5 * z * z) / np.sqrt(2.0 * np.pi)

    return sigma * (psi((t + 0.5) / sigma) - psi((t - 0.5) / sigma))


def disc_pixel(column, row, x, y, radius, sigma):
    """Pixel of a disc of height 1 at (x, y)."""

    def slice_at(u):
        half = np.sqrt(max(radius**2 - (u - x) ** 2, 0.0))
        inside = box_gauss_integral(y + half - row, sigma) - box_gauss_integral(y - half - row, sigma)
        return box_gauss(u - column, sigma) * inside

    return _integrate(slice_at, x - radius, x + radius, column, sigma, [])


def convex_pixel(column, row, corners, sigma):
    """Pixel of a convex polygon of height 1 with `corners` (n, 2)."""

    def slice_at(u):
        crossings = []
        for (x0, y0), (x1, y1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            if min(x0, x1) <= u < max(x0, x1):
                crossings.append(y0 + (u - x0) * (y1 - y0) / (x1 - x0))
        if len(crossings) < 2:
            return 0.0
        inside = box_gauss_integral(max(crossings) - row, sigma) - box_gauss_integral(
            min(crossings) - row, sigma
        )
        return box_gauss(u - column, sigma) * inside

    return _integrate(slice_at, corners[:, 0].min(), corners[:, 0].max(), column, sigma, list(corners[:, 0]))


def _integrate(function, low, high, column, sigma, breaks):
    low, high = max(low, column - 0.5 - 8 * sigma), min(high, column + 0.5 + 8 * sigma)
    if high <= low:
        return 0.0
    edges = sorted({low, high, *(b for b in [*breaks, column - 0.5, column + 0.5] if low < b < high)})
    return sum(quad(function, a, b, epsabs=1e-9, epsrel=1e-9, limit=200)[0] for a, b in pairwise(edges))


def rectangle_corners(x, y, half_u, half_v, angle):
    """Corners of a rectangle rotated counter-clockwise, in an image whose y axis points down."""
    c, s = np.cos(angle), np.sin(angle)
    u = np.array([-half_u, half_u, half_u, -half_u])
    v = np.array([half_v, half_v, -half_v, -half_v])
    return np.column_stack([x + u * c - v * s, y - (u * s + v * c)])


def still(x_mm, y_mm, angle_rad):
    """A motion of points at rest."""
    x, y, angle = (np.atleast_1d(np.asarray(a, dtype=float)) for a in (x_mm, y_mm, angle_rad))

    def motion(time_s):
        n = (time_s.size, 1)
        return Poses(np.tile(x, n), np.tile(y, n), np.tile(angle, n))

    return motion


def centroid(image, background):
    weight = image - background
    rows, columns = np.indices(image.shape)
    return np.array([np.sum(weight * columns), np.sum(weight * rows)]) / np.sum(weight)

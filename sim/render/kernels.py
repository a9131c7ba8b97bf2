"""Compiled kernels that add blurred markers and bare strips to a frame, integrated over each pixel.

`order_for` gives the number of Gauss-Legendre points of an integral over a pixel or an exposure.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from math import ceil, cos, exp, factorial, floor, hypot, lgamma, log, sin, sqrt

import numpy as np
from numba import njit
from numpy.polynomial import hermite
from scipy.special import erf

from tracker import FloatArray


@dataclass(frozen=True)
class Tuning:
    """Accuracy of the integrals."""

    #: [sd] distance beyond which a blurred edge is complete
    #: physics: ndtr(-5.5) = 2e-8 of the contrast, 5e-6 counts of 8 bit.
    reach: float = 5.5
    #: [contrasts] largest error of one integral over a pixel or an exposure
    #: physics: 0.001 counts of 8 bit: a thousandth of the rounding to whole counts.
    error: float = 4.0e-6
    #: [1] points of one integral; more are refused
    #: convention: Chosen: the blur is then too small for the span.
    most_points: int = 64
    #: [sd] longest panel of an integral along or across a bare strip
    #: convention: Longer panels save few points.
    panel: float = 10.0
    #: [1] bound of the error of a panel
    #: physics: It holds for the worst place of a Gaussian and exceeds the error by 20 or more: 1e-6 of the contrast.
    panel_error: float = 2.0e-5


TUNING = Tuning()
_REACH = TUNING.reach
# Nodes per unit of the error function's Taylor series: within half a step of 1 / 64 the first omitted term is 3e-16.
# The C library's erf takes four times as long. Beyond 6 it is 1 to 2e-17.
_ERF_NODES = 64
_ERF_END = 6.0
_ERF_TERMS = 7


def _erf_series() -> FloatArray:
    """Taylor coefficients of erf about each node, shape (nodes, terms).

    Its derivative n is ``2/sqrt(pi) (-1)^(n-1) H_(n-1)(z) exp(-z^2)`` (Abramowitz & Stegun 7.1.19).
    """
    z = np.arange(round(_ERF_END * _ERF_NODES) + 1) / _ERF_NODES
    columns = [erf(z)]
    for n in range(1, _ERF_TERMS):
        slope = 2.0 / sqrt(np.pi) * np.exp(-(z**2)) * hermite.hermval(z, [0.0] * (n - 1) + [1.0])
        columns.append((-1.0) ** (n - 1) * slope / factorial(n))
    return np.column_stack(columns)


_ERF = _erf_series()


@njit(cache=True)
def fast_erf(z: float) -> float:
    """Error function, accurate to the last two bits of 1."""
    a = abs(z)
    if a >= _ERF_END:
        return 1.0 if z > 0.0 else -1.0
    k = int(a * _ERF_NODES + 0.5)
    t = a - k / _ERF_NODES
    total = 0.0
    for n in range(_ERF_TERMS - 1, -1, -1):
        total = total * t + _ERF[k, n]
    return total if z > 0.0 else -total


@njit(cache=True)
def interpolate(table: FloatArray, row: float, column: float) -> float:
    """Cubic (four-point Lagrange in each axis) value of a table; 0 outside."""
    rows, columns = table.shape
    i, j = floor(row), floor(column)
    if i < 1 or j < 1 or i > rows - 3 or j > columns - 3:
        return 0.0
    a, b = row - i, column - j
    u0 = -a * (a - 1.0) * (a - 2.0) / 6.0
    u1 = (a + 1.0) * (a - 1.0) * (a - 2.0) / 2.0
    u2 = -(a + 1.0) * a * (a - 2.0) / 2.0
    u3 = (a + 1.0) * a * (a - 1.0) / 6.0
    w0 = -b * (b - 1.0) * (b - 2.0) / 6.0
    w1 = (b + 1.0) * (b - 1.0) * (b - 2.0) / 2.0
    w2 = -(b + 1.0) * b * (b - 2.0) / 2.0
    w3 = (b + 1.0) * b * (b - 1.0) / 6.0
    total = 0.0
    for k, u in enumerate((u0, u1, u2, u3)):
        r = i - 1 + k
        total += u * (w0 * table[r, j - 1] + w1 * table[r, j] + w2 * table[r, j + 1] + w3 * table[r, j + 2])
    return total


@njit(cache=True)
def add_marker(
    image: FloatArray,
    table: FloatArray,
    step: float,
    x: float,
    y: float,
    angle: float,
    share: float,
    nodes: FloatArray,
    weights: FloatArray,
) -> None:
    """Add `share` of a marker at (x, y), rotated by `angle`, integrated over each pixel by nodes x nodes points."""
    height, width = image.shape
    c, s = cos(angle), sin(angle)
    middle = 0.5 * (table.shape[0] - 1)
    reach = middle * step * (abs(c) + abs(s)) + 0.5
    first_row, last_row = max(0, ceil(y - reach)), min(height - 1, floor(y + reach))
    first_column, last_column = max(0, ceil(x - reach)), min(width - 1, floor(x + reach))
    for row in range(first_row, last_row + 1):
        for column in range(first_column, last_column + 1):
            total = 0.0
            for p in range(nodes.size):
                dy = row - y + nodes[p]
                line = 0.0
                for q in range(nodes.size):
                    dx = column - x + nodes[q]
                    # Counter-clockwise as seen, in an image whose rows run down.
                    u = (c * dx - s * dy) / step + middle
                    v = (s * dx + c * dy) / step + middle
                    line += weights[q] * interpolate(table, v, u)
                total += weights[p] * line
            image[row, column] += share * total


@njit(cache=True)
def add_rectangle(
    image: FloatArray,
    x0: float,
    y0: float,
    x1: float,
    y1: float,
    half_width: float,
    height_counts: float,
    sigma: float,
    nodes: FloatArray,
    weights: FloatArray,
) -> None:
    """Add a blurred rectangle around the line from (x0, y0) to (x1, y1), integrated over each pixel."""
    rows, columns = image.shape
    length = hypot(x1 - x0, y1 - y0)
    if length == 0.0:
        return
    tx, ty = (x1 - x0) / length, (y1 - y0) / length
    scale = 1.0 / (sqrt(2.0) * sigma)
    reach = half_width + _REACH * sigma
    margin = reach + 0.5
    first_row = max(0, ceil(min(y0, y1) - margin))
    last_row = min(rows - 1, floor(max(y0, y1) + margin))
    first_column = max(0, ceil(min(x0, x1) - margin))
    last_column = min(columns - 1, floor(max(x0, x1) + margin))
    for row in range(first_row, last_row + 1):
        for column in range(first_column, last_column + 1):
            total = 0.0
            for p in range(nodes.size):
                dy = row - y0 + nodes[p]
                for q in range(nodes.size):
                    dx = column - x0 + nodes[q]
                    across = abs(dy * tx - dx * ty)
                    if across > reach:
                        continue
                    along = dx * tx + dy * ty
                    if along < -_REACH * sigma or along > length + _REACH * sigma:
                        continue
                    value = fast_erf((half_width - across) * scale) + fast_erf((half_width + across) * scale)
                    value *= fast_erf(along * scale) + fast_erf((length - along) * scale)
                    total += weights[p] * weights[q] * value
            image[row, column] += 0.25 * height_counts * total


@njit(cache=True)
def add_strip(
    image: FloatArray,
    line: FloatArray,
    covers: FloatArray,
    half_width: float,
    height_counts: float,
    sigma: float,
    nodes: FloatArray,
    weights: FloatArray,
) -> None:
    """Add the parts of a polyline (p, 2) of x, y outside the covers (m, 3) of x, y, radius, which do not overlap."""
    for i in range(line.shape[0] - 1):
        x0, y0 = line[i, 0], line[i, 1]
        dx, dy = line[i + 1, 0] - x0, line[i + 1, 1] - y0
        length = hypot(dx, dy)
        if length == 0.0:
            continue
        tx, ty = dx / length, dy / length
        # from the segment's start, the parts between the covers are visible
        seen = 0.0
        while seen < length:
            hidden, after = length, length
            for m in range(covers.shape[0]):
                along = (covers[m, 0] - x0) * tx + (covers[m, 1] - y0) * ty
                across = (covers[m, 0] - x0) * ty - (covers[m, 1] - y0) * tx
                chord = covers[m, 2] ** 2 - across**2
                if chord <= 0.0:
                    continue
                start, end = max(seen, along - sqrt(chord)), along + sqrt(chord)
                if end > seen and start < hidden:
                    hidden, after = start, end
            if hidden > seen:
                add_rectangle(
                    image,
                    x0 + seen * tx,
                    y0 + seen * ty,
                    x0 + hidden * tx,
                    y0 + hidden * ty,
                    half_width,
                    height_counts,
                    sigma,
                    nodes,
                    weights,
                )
            seen = after


def order_for(span_over_sigma: float) -> int:
    """Gauss-Legendre order that averages a Gaussian-blurred edge over a span, given in standard deviations of the blur.

    Raises
    ------
    ValueError
        If more than 64 points would be needed: the blur is too small for the span.

    Notes
    -----
    The remainder of the n-point rule over a span d is ``d^(2n) (n!)^4 / ((2n+1) ((2n)!)^3) |f^(2n)|`` for the
    average. For an edge blurred by a Gaussian, ``f^(2n) = He_(2n-1)(z) phi(z) / sigma^(2n)``, and Cramér's
    inequality bounds ``|He_m phi|`` by ``1.0865 sqrt(m!) / sqrt(2 pi)`` (Abramowitz & Stegun 22.14.17, 25.4.30).
    """
    return _order(span_over_sigma, 0, TUNING.error)


def panels(low: float, high: float, sigma: float) -> tuple[FloatArray, FloatArray]:
    """Points in (low, high) and their weights, which integrate a Gaussian of standard deviation `sigma` anywhere.

    In panels of at most 10 sigma; the order is chosen as in `order_for`, for the Gaussian, the derivative of the edge.
    """
    count = max(1, ceil((high - low) / (TUNING.panel * sigma)))
    width = (high - low) / count
    nodes, weights = unit_rule(_order(width / sigma, 1, TUNING.panel_error))
    middles = low + width * (np.arange(count) + 0.5)
    return (middles[:, None] + width * nodes).ravel(), np.tile(width * weights, count)


def _order(span_over_sigma: float, derivative: int, tolerance: float) -> int:
    """Order for an edge, or for its derivative, the Gaussian, integrated over the span."""
    if span_over_sigma == 0.0:
        return 1
    for n in range(1, TUNING.most_points + 1):
        log_error = (
            (2 * n + derivative) * log(span_over_sigma)
            + 4 * lgamma(n + 1)
            - log(2 * n + 1)
            - 3 * lgamma(2 * n + 1)
            + log(0.4334)
            + 0.5 * lgamma(2 * n + derivative)
        )
        if log_error < log(tolerance):
            return n
    msg = (
        f"a span of {span_over_sigma:.1f} standard deviations of the lens blur needs more than "
        f"{TUNING.most_points} points (error {exp(log_error):.1e}, wanted {tolerance:.1e}): raise lens_blur_px, or "
        "shorten the exposure"
    )
    raise ValueError(msg)


def unit_rule(order: int) -> tuple[FloatArray, FloatArray]:
    """Nodes in (-1/2, 1/2) and weights that sum to 1, each of shape (order,)."""
    nodes, weights = _rule(order)
    # kernels with explicit signatures need writable arrays, and the cached ones must not change
    return nodes.copy(), weights.copy()


@cache
def _rule(order: int) -> tuple[FloatArray, FloatArray]:
    nodes, weights = np.polynomial.legendre.leggauss(order)
    return 0.5 * nodes, 0.5 * weights


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
    reach = 0.5 + _REACH * sigma
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

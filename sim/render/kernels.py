"""Compiled kernels that add blurred markers and strips to a frame, integrated over each pixel."""

from __future__ import annotations

from math import ceil, cos, factorial, floor, hypot, sin, sqrt

import numpy as np
from numba import njit
from numpy.polynomial import hermite
from scipy.special import erf

from tracker import FloatArray

# As in sim.render.markers: standard deviations beyond which a blurred edge is complete.
REACH = 5.5
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
    reach = half_width + REACH * sigma
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
                    if along < -REACH * sigma or along > length + REACH * sigma:
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

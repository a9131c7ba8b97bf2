"""Compiled parts of a time step for many draws at once: the draw, or lane, is the innermost index of every array.

The equations are those of `sim.step_forces` and `sim.step_newton`. The number of lanes is known at run time only, so
that the compiler makes vector instructions of the loops over lanes instead of unrolling them; each loop touches few
arrays, whose overlap it can rule out with few comparisons. Vectors are padded with `PAD` rows of zeros at either end.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sim.banded import BAND, PAD, REORDER
from sim.step_forces import Axial, first_coordinate

FloatArray = NDArray[np.float64]


class Blend(NamedTuple):
    """Matrix of each lane, ``mass_share M + bending_share B``.

    Attributes
    ----------
    mass, bending : array, shape (15, n)
        Transposed bands.
    mass_share, bending_share : array, shape (lanes,)
    """

    mass: FloatArray
    bending: FloatArray
    mass_share: FloatArray
    bending_share: FloatArray


class Points(NamedTuple):
    """Values along and across the beam at the Gauss points, each (g, ne, lanes)."""

    x: FloatArray
    y: FloatArray


@njit(cache=True, fastmath=REORDER)
def add_blend(blend: Blend, x: FloatArray, out: FloatArray) -> None:
    """Add the blended matrix times `x` to `out`; both are padded, (n + 14, lanes)."""
    for i in range(blend.mass.shape[1]):
        for k in range(BAND):
            a, b = blend.mass[k, i], blend.bending[k, i]
            if a != 0.0 or b != 0.0:
                for s in range(x.shape[1]):
                    out[PAD + i, s] += (a * blend.mass_share[s] + b * blend.bending_share[s]) * x[i + k, s]


@njit(cache=True, fastmath=REORDER)
def lane_gradients(padded: FloatArray, dshape: FloatArray, out: Points) -> None:
    """Displacement gradients at the Gauss points."""
    points, elements, lanes = out.x.shape
    first = first_coordinate(padded.shape[0] - 2 * PAD, elements)
    for g in range(points):
        a, b, c, d = dshape[g, 0], dshape[g, 1], dshape[g, 2], dshape[g, 3]
        for e in range(elements):
            i = first + 4 * e
            for s in range(lanes):
                out.x[g, e, s] = (
                    a * padded[i, s] + b * padded[i + 2, s] + c * padded[i + 4, s] + d * padded[i + 6, s]
                )
            for s in range(lanes):
                out.y[g, e, s] = (
                    a * padded[i + 1, s] + b * padded[i + 3, s] + c * padded[i + 5, s] + d * padded[i + 7, s]
                )


@njit(cache=True, fastmath=REORDER)
def add_axial_force(
    start: Points,
    step: FloatArray,
    axial: Axial,
    beta: FloatArray,
    both: FloatArray,
    work: Points,
    out: FloatArray,
) -> None:
    """Add each lane's axial force, as `sim.step_forces.axial_force`; `beta` and `both` are its viscosities a lane."""
    points, elements, lanes = work.x.shape
    first = first_coordinate(step.shape[0] - 2 * PAD, elements)
    lane_gradients(step, axial.dshape, work)
    for g in range(points):
        for e in range(elements):
            ea = axial.stiffness_n_m[g, e]
            for s in range(lanes):
                dx, dy = work.x[g, e, s], work.y[g, e, s]
                x0, y0 = start.x[g, e, s], start.y[g, e, s]
                tx, ty = 1.0 + x0 + 0.5 * dx, y0 + 0.5 * dy
                growth = tx * dx + ty * dy
                normal = ea * (x0 + 0.5 * (x0 * x0 + y0 * y0) + 0.5 * growth)
                total = normal + ea * both[s] * growth
                rate = normal * beta[s]
                work.x[g, e, s] = total * tx + rate * dx
                work.y[g, e, s] = total * ty + rate * dy
            for k in range(4):
                scale = axial.dshape[g, k]
                row = first + 4 * e + 2 * k
                if row >= PAD:
                    for s in range(lanes):
                        out[row, s] += scale * work.x[g, e, s]
                    for s in range(lanes):
                        out[row + 1, s] += scale * work.y[g, e, s]


@njit(cache=True, fastmath=REORDER)
def assemble(
    blend: Blend,
    start: Points,
    step: FloatArray,
    axial: Axial,
    viscosity: tuple[FloatArray, FloatArray],
    work: Points,
    columns: FloatArray,
) -> None:
    """Lower columns, shape (n + 7, 8, lanes), of each lane's symmetric tangent (see `symmetric_tangent`)."""
    points, elements, lanes = work.x.shape
    n = blend.mass.shape[1]
    beta, both = viscosity
    xx, xy, yy = np.empty(lanes), np.empty(lanes), np.empty(lanes)
    columns[:] = 0.0
    for j in range(n):
        for m in range(min(PAD + 1, n - j)):
            a, b = blend.mass[PAD - m, j + m], blend.bending[PAD - m, j + m]
            if a != 0.0 or b != 0.0:
                for s in range(lanes):
                    columns[j, m, s] = a * blend.mass_share[s] + b * blend.bending_share[s]
    lane_gradients(step, axial.dshape, work)
    for e in range(elements):
        offset = first_coordinate(n, elements) - PAD + 4 * e
        for g in range(points):
            ea = axial.stiffness_n_m[g, e]
            for s in range(lanes):
                dx, dy = work.x[g, e, s], work.y[g, e, s]
                x0, y0 = start.x[g, e, s], start.y[g, e, s]
                tx, ty = 1.0 + x0 + 0.5 * dx, y0 + 0.5 * dy
                growth = tx * dx + ty * dy
                normal = ea * (x0 + 0.5 * (x0 * x0 + y0 * y0) + 0.5 * growth)
                stretch = ea * (0.5 + both[s])
                isotropic = 0.5 * (normal + ea * both[s] * growth) + normal * beta[s]
                xx[s] = stretch * tx * tx + isotropic
                xy[s] = stretch * tx * ty
                yy[s] = stretch * ty * ty + isotropic
            for k in range(4):
                row = offset + 2 * k
                if row < 0:
                    continue
                for m in range(k, 4):
                    scale = axial.dshape[g, k] * axial.dshape[g, m]
                    add_scaled(columns[row, 2 * (m - k)], scale, xx)
                    add_scaled(columns[row, 2 * (m - k) + 1], scale, xy)
                    add_scaled(columns[row + 1, 2 * (m - k)], scale, yy)
                    if m > k:
                        add_scaled(columns[row + 1, 2 * (m - k) - 1], scale, xy)


@njit(cache=True, fastmath=REORDER)
def add_scaled(out: FloatArray, scale: float, x: FloatArray) -> None:
    """Add ``scale x`` to `out`, a value a lane each."""
    for s in range(out.size):
        out[s] += scale * x[s]


@njit(cache=True, fastmath=REORDER)
def subtract_product(out: FloatArray, a: FloatArray, b: FloatArray) -> None:
    """Subtract ``a b`` from `out`, a value a lane each."""
    for s in range(out.size):
        out[s] -= a[s] * b[s]


@njit(cache=True, fastmath=REORDER)
def factor_lanes(columns: FloatArray, inverse_pivot: FloatArray) -> None:
    """L D L^T of each lane in place; a lane whose pivot vanishes is left with infinities, which its iteration finds."""
    n, lanes = inverse_pivot.shape
    share = np.empty(lanes)
    for j in range(n):
        for s in range(lanes):
            inverse_pivot[j, s] = 1.0 / columns[j, 0, s]
        for m in range(1, PAD + 1):
            for s in range(lanes):
                share[s] = columns[j, m, s] * inverse_pivot[j, s]
            for t in range(PAD + 1 - m):
                subtract_product(columns[j + m, t], share, columns[j, m + t])
        for m in range(1, PAD + 1):
            for s in range(lanes):
                columns[j, m, s] *= inverse_pivot[j, s]


@njit(cache=True, fastmath=REORDER)
def solve_lanes(columns: FloatArray, inverse_pivot: FloatArray, x: FloatArray) -> None:
    """Solve each lane in place with the factors of `factor_lanes`; `x` is padded."""
    n, lanes = inverse_pivot.shape
    for j in range(n):
        for m in range(1, PAD + 1):
            subtract_product(x[PAD + j + m], columns[j, m], x[PAD + j])
    for j in range(n - 1, -1, -1):
        row = x[PAD + j]
        for s in range(lanes):
            row[s] *= inverse_pivot[j, s]
        for m in range(1, min(PAD + 1, n - j)):
            subtract_product(row, columns[j, m], x[PAD + j + m])


@njit(cache=True, fastmath=REORDER)
def project_lanes(rows: FloatArray, x: FloatArray, out: FloatArray) -> None:
    """Write ``rows x`` of each lane to `out`, shape (r, lanes); `x` is padded."""
    out[:] = 0.0
    for r in range(rows.shape[0]):
        for i in range(rows.shape[1]):
            if rows[r, i] != 0.0:
                add_scaled(out[r], rows[r, i], x[PAD + i])


@njit(cache=True, fastmath=REORDER)
def add_rows_lanes(rows: FloatArray, factors: FloatArray, out: FloatArray) -> None:
    """Add ``rows^T factors`` of each lane to `out`, which is padded; `factors` has shape (r, lanes)."""
    for r in range(rows.shape[0]):
        for i in range(rows.shape[1]):
            if rows[r, i] != 0.0:
                add_scaled(out[PAD + i], rows[r, i], factors[r])

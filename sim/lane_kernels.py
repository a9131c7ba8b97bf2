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
from sim.step_forces import first_coordinate

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
def assemble_blend(blend: Blend, columns: FloatArray) -> None:
    """Write the lower columns, shape (n + 7, 8, lanes), of the blended matrix."""
    n, lanes = blend.mass.shape[1], columns.shape[2]
    for j in range(columns.shape[0]):
        for m in range(PAD + 1):
            a = b = 0.0
            if j + m < n:
                a, b = blend.mass[PAD - m, j + m], blend.bending[PAD - m, j + m]
            for s in range(lanes):
                columns[j, m, s] = a * blend.mass_share[s] + b * blend.bending_share[s]


@njit(cache=True)
def fill(out: FloatArray, value: float) -> None:
    """Write a value to every lane."""
    for s in range(out.size):
        out[s] = value


@njit(cache=True)
def copy(x: FloatArray, out: FloatArray) -> None:
    """Write `x` to `out`, a value a lane each."""
    for s in range(out.size):
        out[s] = x[s]


@njit(cache=True)
def scale(out: FloatArray, x: FloatArray) -> None:
    """Multiply `out` by `x`, a value a lane each."""
    for s in range(out.size):
        out[s] *= x[s]


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
def project_lanes(rows: FloatArray, x: FloatArray, first: int, out: FloatArray) -> None:
    """Write ``rows x`` of each lane to `out`, shape (r, lanes), of the rows from `first` on; `x` is padded."""
    for r in range(first, rows.shape[0]):
        fill(out[r], 0.0)
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


@njit(cache=True, fastmath=REORDER)
def _eliminate(system: FloatArray, first: int, a: int) -> None:
    """One column of Gauss and Jordan's elimination, of the rows from `first` on; the diagonal holds inverse pivots."""
    count = system.shape[0]
    for s in range(system.shape[2]):
        system[a, a, s] = 1.0 / system[a, a, s]
    for c in range(a + 1, count + a + 1):
        scale(system[a, c], system[a, a])
        for b in range(first, count):
            if b != a:
                subtract_product(system[b, c], system[b, a], system[a, c])


@njit(cache=True, fastmath=REORDER)
def woodbury_lanes(
    rows: FloatArray,
    gain: FloatArray,
    first: int,
    columns: FloatArray,
    inverse_pivot: FloatArray,
    spread: FloatArray,
    system: FloatArray,
) -> None:
    """Prepare the solution with ``A + U gain U^T``, the rows of U^T from `first` on, as `sim.step_newton.woodbury`.

    `spread` is padded, (r, n + 14, lanes); `system` has shape (r, 2 r, lanes).
    """
    count, n = rows.shape
    for a in range(first, count):
        for i in range(n + PAD):
            fill(spread[a, PAD + i], rows[a, i] if i < n else 0.0)
        solve_lanes(columns, inverse_pivot, spread[a])
        project_lanes(rows, spread[a], first, system[a])
    for a in range(first, count):
        for b in range(first, count):
            scale(system[a, b], gain[a])
            fill(system[a, count + b], 0.0)
        copy(gain[a], system[a, count + a])
        for s in range(gain.shape[1]):
            system[a, a, s] += 1.0
    for a in range(first, count):
        _eliminate(system, first, a)


@njit(cache=True, fastmath=REORDER)
def correct_lanes(
    rows: FloatArray,
    first: int,
    spread: FloatArray,
    system: FloatArray,
    work: tuple[FloatArray, FloatArray],
    x: FloatArray,
) -> None:
    """Complete the solution `x`, padded, of each lane by its low-rank part; `work` has two arrays (r, lanes)."""
    count, lanes = rows.shape[0], x.shape[1]
    coordinate, factor = work
    project_lanes(rows, x, first, coordinate)
    for a in range(first, count):
        fill(factor[a], 0.0)
        for b in range(first, count):
            for s in range(lanes):
                factor[a, s] += system[a, count + b, s] * coordinate[b, s]
        for i in range(rows.shape[1]):
            subtract_product(x[PAD + i], spread[a, PAD + i], factor[a])

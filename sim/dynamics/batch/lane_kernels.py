"""Compiled parts of a time step for many draws at once: the draw, or lane, is the innermost index of every array.

The equations are those of `sim.dynamics.forces` and `sim.dynamics.newton`. The number of lanes is known at
run time only, so that the compiler makes vector instructions of the loops over lanes instead of unrolling
them; each loop touches few arrays, whose overlap it can rule out with few comparisons. Vectors are padded
with `PAD` rows of zeros at either end.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sim.beam.banded import BAND, PAD, REORDER
from sim.dynamics.forces import first_coordinate
from tracker.arrays import FloatArray


class Blend(NamedTuple):
    """Matrix of each lane, ``mass_share M + bending_share B``.

    Attributes
    ----------
    columns_mass, columns_bending : array, shape (n + 7, 16)
        Lower columns.
    mass, bending : array, shape (n, 15) or (n, 7)
        Bands, with or without every second diagonal.
    mass_share, bending_share : array, shape (lanes,)
    """

    columns_mass: FloatArray
    columns_bending: FloatArray
    mass: FloatArray
    bending: FloatArray
    mass_share: FloatArray
    bending_share: FloatArray


class Rows(NamedTuple):
    """U^T of the modal terms, and the coordinates in which any of them is not zero.

    Attributes
    ----------
    values : array, shape (r, n)
    used : array of int
    """

    values: FloatArray
    used: NDArray[np.int64]


class Points(NamedTuple):
    """Values along and across the beam at the Gauss points, each (g, ne, lanes)."""

    x: FloatArray
    y: FloatArray


@njit(cache=True, fastmath=REORDER)
def _add_three(
    a: FloatArray,
    b: FloatArray,
    shares: tuple[FloatArray, FloatArray],
    x: tuple[FloatArray, FloatArray, FloatArray],
    out: FloatArray,
) -> None:
    """Add three diagonals' products; `a` and `b` hold one number a diagonal."""
    (mass, bending), (x0, x1, x2) = shares, x
    a0, a1, a2, b0, b1, b2 = a[0], a[1], a[2], b[0], b[1], b[2]
    for s in range(out.size):
        both = (a0 * x0[s] + a1 * x1[s] + a2 * x2[s]) * mass[s]
        out[s] += both + (b0 * x0[s] + b1 * x1[s] + b2 * x2[s]) * bending[s]


@njit(cache=True, fastmath=REORDER)
def add_blend(blend: Blend, x: FloatArray, out: FloatArray) -> None:
    """Add the blended matrix times `x` to `out`; both are padded, (n + 14, lanes)."""
    n, count = blend.mass.shape
    stride, first = BAND // count, 1 if count < BAND else 0
    shares = (blend.mass_share, blend.bending_share)
    for i in range(n):
        for k in range(0, count - 2, 3):
            j = i + first + stride * k
            rows = (x[j], x[j + stride], x[j + 2 * stride])
            _add_three(blend.mass[i, k:], blend.bending[i, k:], shares, rows, out[PAD + i])
        for k in range(count - count % 3, count):
            a, b, row = blend.mass[i, k], blend.bending[i, k], x[i + first + stride * k]
            for s in range(x.shape[1]):
                out[PAD + i, s] += (a * shares[0][s] + b * shares[1][s]) * row[s]


@njit(cache=True, fastmath=REORDER)
def add_momentum(blend: Blend, factor: float, v: FloatArray, q: FloatArray, out: FloatArray) -> None:
    """Add ``factor M v + B q`` to `out`; all are padded."""
    n, count = blend.mass.shape
    stride, first = BAND // count, 1 if count < BAND else 0
    for i in range(n):
        for k in range(count):
            a, b = factor * blend.mass[i, k], blend.bending[i, k]
            row_v, row_q, row = v[i + first + stride * k], q[i + first + stride * k], out[PAD + i]
            for s in range(row.size):
                row[s] += a * row_v[s] + b * row_q[s]


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
    for j in range(columns.shape[0]):
        for m in range(PAD + 1):
            a, b = blend.columns_mass[j, m], blend.columns_bending[j, m]
            for s in range(columns.shape[2]):
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
def _less_three(
    out: FloatArray,
    a: tuple[FloatArray, FloatArray, FloatArray],
    x: tuple[FloatArray, FloatArray, FloatArray],
) -> None:
    """Subtract three products from `out`, a value a lane each."""
    (a0, a1, a2), (x0, x1, x2) = a, x
    for s in range(out.size):
        out[s] -= a0[s] * x0[s] + a1[s] * x1[s] + a2[s] * x2[s]


@njit(cache=True, fastmath=REORDER)
def solve_lanes(columns: FloatArray, inverse_pivot: FloatArray, x: FloatArray) -> None:
    """Solve each lane in place with the factors of `factor_lanes`; `x` is padded by zeros."""
    n = inverse_pivot.shape[0]
    for j in range(min(PAD, n)):
        for m in range(1, j + 1):
            subtract_product(x[PAD + j], columns[j - m, m], x[PAD + j - m])
    for j in range(PAD, n):
        row, i = x[PAD + j], PAD + j
        _less_three(
            row, (columns[j - 7, 7], columns[j - 6, 6], columns[j - 5, 5]), (x[i - 7], x[i - 6], x[i - 5])
        )
        _less_three(
            row, (columns[j - 4, 4], columns[j - 3, 3], columns[j - 2, 2]), (x[i - 4], x[i - 3], x[i - 2])
        )
        subtract_product(row, columns[j - 1, 1], x[i - 1])
    for j in range(n - 1, -1, -1):
        row, i, own = x[PAD + j], PAD + j, columns[j]
        scale(row, inverse_pivot[j])
        _less_three(row, (own[7], own[6], own[5]), (x[i + 7], x[i + 6], x[i + 5]))
        _less_three(row, (own[4], own[3], own[2]), (x[i + 4], x[i + 3], x[i + 2]))
        subtract_product(row, own[1], x[i + 1])


@njit(cache=True, fastmath=REORDER)
def project_lanes(rows: Rows, x: FloatArray, first: int, out: FloatArray) -> None:
    """Write ``rows x`` of each lane to `out`, shape (r, lanes), of the rows from `first` on; `x` is padded."""
    at, last = rows.used, rows.used.size - rows.used.size % 4
    for r in range(first, rows.values.shape[0]):
        fill(out[r], 0.0)
        a, to = rows.values[r], out[r]
        for k in range(0, last, 4):
            a0, a1, a2, a3 = a[at[k]], a[at[k + 1]], a[at[k + 2]], a[at[k + 3]]
            x0, x1, x2, x3 = x[PAD + at[k]], x[PAD + at[k + 1]], x[PAD + at[k + 2]], x[PAD + at[k + 3]]
            for s in range(to.size):
                to[s] += a0 * x0[s] + a1 * x1[s] + a2 * x2[s] + a3 * x3[s]
        for k in range(last, at.size):
            add_scaled(to, a[at[k]], x[PAD + at[k]])


@njit(cache=True, fastmath=REORDER)
def add_rows_lanes(rows: Rows, factors: FloatArray, out: FloatArray) -> None:
    """Add ``rows^T factors`` of each lane to `out`, which is padded; `factors` has shape (r, lanes)."""
    count = rows.values.shape[0]
    last = count - count % 3
    for i in rows.used:
        to = out[PAD + i]
        for r in range(0, last, 3):
            a0, a1, a2 = rows.values[r, i], rows.values[r + 1, i], rows.values[r + 2, i]
            f0, f1, f2 = factors[r], factors[r + 1], factors[r + 2]
            for s in range(to.size):
                to[s] += a0 * f0[s] + a1 * f1[s] + a2 * f2[s]
        for r in range(last, count):
            add_scaled(to, rows.values[r, i], factors[r])


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
    rows: Rows,
    gain: FloatArray,
    first: int,
    columns: FloatArray,
    inverse_pivot: FloatArray,
    spread: FloatArray,
    system: FloatArray,
) -> None:
    """Prepare the solution with ``A + U gain U^T``, the rows of U^T from `first` on, as `sim.dynamics.newton.woodbury`.

    `spread` is padded, (r, n + 14, lanes); `system` has shape (r, 2 r, lanes).
    """
    count, n = rows.values.shape
    for a in range(first, count):
        for i in range(n):
            fill(spread[a, PAD + i], rows.values[a, i])
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
    rows: Rows,
    first: int,
    spread: FloatArray,
    system: FloatArray,
    work: tuple[FloatArray, FloatArray],
    x: FloatArray,
) -> None:
    """Complete the solution `x`, padded, of each lane by its low-rank part; `work` has two arrays (r, lanes)."""
    (count, n), lanes = rows.values.shape, x.shape[1]
    coordinate, factor = work
    project_lanes(rows, x, first, coordinate)
    for a in range(first, count):
        fill(factor[a], 0.0)
        for b in range(first, count):
            for s in range(lanes):
                factor[a, s] += system[a, count + b, s] * coordinate[b, s]
    a = first
    while a + 3 <= count:
        for i in range(PAD, PAD + n):
            beside = (spread[a, i], spread[a + 1, i], spread[a + 2, i])
            _less_three(x[i], beside, (factor[a], factor[a + 1], factor[a + 2]))
        a += 3
    for b in range(a, count):
        for i in range(PAD, PAD + n):
            subtract_product(x[i], spread[b, i], factor[b])

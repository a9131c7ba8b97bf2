"""Compiled axial force of one time step for many draws at once: `sim.dynamics.axial` with the draw as innermost index.

Each loop over lanes writes one array and reads few, so that the compiler can rule out their overlap.
"""

from __future__ import annotations

from typing import NamedTuple

from numba import njit

from sim.beam.banded import PAD, REORDER
from sim.dynamics.axial import BETWEEN
from sim.dynamics.batch.lane_kernels import Blend, Points, add_scaled, assemble_blend
from sim.dynamics.forces import Axial, first_coordinate
from tracker.arrays import FloatArray


class LaneStretch(NamedTuple):
    """As `sim.dynamics.axial.Stretch`, each (g, ne, lanes), and scratch, (5, lanes)."""

    along_x: FloatArray
    along_y: FloatArray
    offset: FloatArray
    before: FloatArray
    scratch: FloatArray


@njit(cache=True, fastmath=REORDER)
def strain_of(x: FloatArray, y: FloatArray, out: FloatArray) -> None:
    """Write the axial strain of a displacement gradient."""
    for s in range(out.size):
        out[s] = x[s] + 0.5 * (x[s] * x[s] + y[s] * y[s])


@njit(cache=True, fastmath=REORDER)
def inner_product(ax: FloatArray, ay: FloatArray, x: FloatArray, y: FloatArray, out: FloatArray) -> None:
    """Write the product of two vectors of each lane."""
    for s in range(out.size):
        out[s] = ax[s] * x[s] + ay[s] * y[s]


@njit(cache=True, fastmath=REORDER)
def keep_lane_strain(start: Points, stretch: LaneStretch) -> None:
    """Remember the strain at the start of a step for the guess of the next one."""
    for g in range(start.x.shape[0]):
        for e in range(start.x.shape[1]):
            strain_of(start.x[g, e], start.y[g, e], stretch.before[g, e])


@njit(cache=True, fastmath=REORDER)
def predict_lanes(start: Points, stretch: LaneStretch, work: Points) -> None:
    """Begin a step, whose gradients are `work`: the mean strain over it is that over the step before."""
    strain, along = stretch.scratch[0], stretch.scratch[1]
    for g in range(start.x.shape[0]):
        for e in range(start.x.shape[1]):
            strain_of(start.x[g, e], start.y[g, e], strain)
            inner_product(stretch.along_x[g, e], stretch.along_y[g, e], work.x[g, e], work.y[g, e], along)
            offset, before = stretch.offset[g, e], stretch.before[g, e]
            for s in range(offset.size):
                offset[s] = before[s] - strain[s] - along[s]


@njit(cache=True, fastmath=REORDER)
def _pressed(
    total: FloatArray,
    missed: FloatArray,
    rate: FloatArray,
    tangent: FloatArray,
    along: FloatArray,
    out: FloatArray,
) -> None:
    """Turn one component of the step's gradient into that of the force."""
    for s in range(out.size):
        out[s] = total[s] * tangent[s] + missed[s] * along[s] + rate[s] * out[s]


@njit(cache=True, fastmath=REORDER)
def _force(
    ea: float,
    at: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    along: tuple[FloatArray, FloatArray, FloatArray],
    viscosity: tuple[FloatArray, FloatArray],
    scratch: FloatArray,
) -> None:
    """Renew the offset of `along` (x, y, offset), and turn the step's gradient in `at` into that of the force."""
    (x0, y0, dx, dy), (ax, ay, offset), (beta, both) = at, along, viscosity
    tx, ty, missed, total, rate = scratch[0], scratch[1], scratch[2], scratch[3], scratch[4]
    lanes = offset.size
    for s in range(lanes):
        tx[s] = 1.0 + x0[s] + 0.5 * dx[s]
    for s in range(lanes):
        ty[s] = y0[s] + 0.5 * dy[s]
    # the growth, at first
    for s in range(lanes):
        total[s] = offset[s] + ax[s] * dx[s] + ay[s] * dy[s]
    for s in range(lanes):
        missed[s] = tx[s] * dx[s] + ty[s] * dy[s] - total[s]
    for s in range(lanes):
        offset[s] += missed[s]
    # the axial force, at first
    for s in range(lanes):
        rate[s] = ea * (x0[s] + 0.5 * (x0[s] * x0[s] + y0[s] * y0[s] + total[s]))
    for s in range(lanes):
        total[s] = rate[s] + ea * both[s] * total[s]
    for s in range(lanes):
        rate[s] *= beta[s]
    for s in range(lanes):
        missed[s] *= ea * (0.5 + both[s])
    _pressed(total, missed, rate, tx, ax, dx)
    _pressed(total, missed, rate, ty, ay, dy)


@njit(cache=True, fastmath=REORDER)
def add_axial_force(
    start: Points,
    axial: Axial,
    viscosity: tuple[FloatArray, FloatArray],
    stretch: LaneStretch,
    work: Points,
    out: FloatArray,
) -> None:
    """Add each lane's axial force, as `sim.dynamics.axial.axial_force`; `work` holds the gradients: overwritten."""
    points, elements, _ = work.x.shape
    first = first_coordinate(out.shape[0] - 2 * PAD, elements)
    for g in range(points):
        for e in range(elements):
            ea = axial.stiffness_n_m[g, e]
            x0, y0, dx, dy = start.x[g, e], start.y[g, e], work.x[g, e], work.y[g, e]
            ax, ay, offset = stretch.along_x[g, e], stretch.along_y[g, e], stretch.offset[g, e]
            _force(ea, (x0, y0, dx, dy), (ax, ay, offset), viscosity, stretch.scratch)
            for k in range(4):
                scale = axial.dshape[g, k]
                row = first + 4 * e + 2 * k
                if row >= PAD:
                    add_scaled(out[row], scale, dx)
                    add_scaled(out[row + 1], scale, dy)


@njit(cache=True, fastmath=REORDER)
def _linearise(
    ea: float,
    beta: FloatArray,
    both: FloatArray,
    at: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    along: tuple[FloatArray, FloatArray, FloatArray],
    out: tuple[FloatArray, FloatArray, FloatArray],
) -> None:
    """Renew `along` (x, y, offset) about the gradients `at`; write the tangent's xx, xy, yy to `out`."""
    (x0, y0, dx, dy), (ax, ay, offset), (xx, xy, yy) = at, along, out
    for s in range(xx.size):
        growth = offset[s] + ax[s] * dx[s] + ay[s] * dy[s]
        ax[s], ay[s] = 1.0 + x0[s] + BETWEEN * dx[s], y0[s] + BETWEEN * dy[s]
        offset[s] = growth - ax[s] * dx[s] - ay[s] * dy[s]
        normal = ea * (x0[s] + 0.5 * (x0[s] * x0[s] + y0[s] * y0[s]) + 0.5 * growth)
        isotropic = 0.5 * (normal + ea * both[s] * growth) + normal * beta[s]
        stiff = ea * (0.5 + both[s])
        xx[s] = stiff * ax[s] * ax[s] + isotropic
        xy[s] = stiff * ax[s] * ay[s]
        yy[s] = stiff * ay[s] * ay[s] + isotropic


@njit(cache=True, fastmath=REORDER)
def assemble(
    blend: Blend,
    start: Points,
    axial: Axial,
    viscosity: tuple[FloatArray, FloatArray],
    stretch: LaneStretch,
    work: Points,
    columns: FloatArray,
) -> None:
    """Lower columns, (n + 7, 8, lanes), of each lane's tangent about the step whose gradients are `work`."""
    points, elements, _ = work.x.shape
    n = blend.mass.shape[0]
    assemble_blend(blend, columns)
    xx, xy, yy = stretch.scratch[0], stretch.scratch[1], stretch.scratch[2]
    for e in range(elements):
        offset = first_coordinate(n, elements) - PAD + 4 * e
        for g in range(points):
            _linearise(
                axial.stiffness_n_m[g, e],
                viscosity[0],
                viscosity[1],
                (start.x[g, e], start.y[g, e], work.x[g, e], work.y[g, e]),
                (stretch.along_x[g, e], stretch.along_y[g, e], stretch.offset[g, e]),
                (xx, xy, yy),
            )
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

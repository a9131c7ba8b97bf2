"""Compiled axial force of one time step in mixed form, with strain and displacement as unknowns.

The energy-momentum rule applies EA times the mean strain of both ends of the step to the tangent r' at its middle. An
iterate with a rotation error of 1e-3 has a spurious strain of 5e-7, and EA times that exceeds all other forces:
Newton's method in displacements alone converges only once such errors have vanished. Here the increase of the strain
over the step is a separate unknown at each Gauss point, predicted by the linearisation and corrected by its error. It
is eliminated point by point, so that an iteration has the same cost and the solution is the same.

References
----------
Magisano, Leonetti, Garcea, "How to improve efficiency and robustness of the Newton method in geometrically non-linear
structural problem discretized via displacement-based finite elements", CMAME 313 (2017) 986-1005,
doi:10.1016/j.cma.2016.10.023.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from sim.beam import PAD, REORDER
from sim.dynamics.forces import Axial, Gradients, first_coordinate, spread
from tracker import FloatArray

# share of the step's displacement gradient in the linearised tangent: between the middle, on which the force acts, and
# the end, which changes the strain
BETWEEN = 0.75


class Stretch(NamedTuple):
    """Increase of twice the strain over the step at the Gauss points, each (g, ne).

    It is `offset` plus ``along`` times the step's displacement gradient, with ``along`` the value of r' when the matrix
    was factored; `before` is the strain at the start of the preceding step.
    """

    along_x: FloatArray
    along_y: FloatArray
    offset: FloatArray
    before: FloatArray


def empty_stretch(points: tuple[int, int]) -> Stretch:
    """Memory for the increase at (g, ne) Gauss points."""
    return Stretch(*(np.zeros(points) for _ in Stretch._fields))


@njit(cache=True, fastmath=REORDER)
def keep_strain(start: Gradients, stretch: Stretch) -> None:
    """Store the strain at the start of a step for the first guess of the next one."""
    for g in range(start.x.shape[0]):
        for e in range(start.x.shape[1]):
            x, y = start.x[g, e], start.y[g, e]
            stretch.before[g, e] = x + 0.5 * (x * x + y * y)


@njit(cache=True, fastmath=REORDER)
def predict(start: Gradients, stretch: Stretch, work: Gradients) -> None:
    """First guess of a step with gradients `work`: its mean strain is that of the preceding step."""
    for g in range(start.x.shape[0]):
        for e in range(start.x.shape[1]):
            x, y = start.x[g, e], start.y[g, e]
            growth = stretch.before[g, e] - x - 0.5 * (x * x + y * y)
            along = stretch.along_x[g, e] * work.x[g, e] + stretch.along_y[g, e] * work.y[g, e]
            stretch.offset[g, e] = growth - along


@njit(cache=True, fastmath=REORDER)
def axial_force(
    start: Gradients,
    n: int,
    axial: Axial,
    viscosity: tuple[float, float],
    stretch: Stretch,
    work: Gradients,
    force: FloatArray,
) -> None:
    """Add the axial force of one iterate to `force`, and update the increase of the strain.

    `work` holds the iterate's gradients and is overwritten; `force` is padded. At the solution the force is EA times
    the mean strain on the tangent at the middle, so that its work over the step equals the change of strain energy.
    ``viscosity`` is (beta / h, tau / h): beta multiplies the rate of the whole axial force, so that beta K(q) v is
    exact over the step; tau multiplies the strain rate only (Kelvin-Voigt).
    """
    points, elements = work.x.shape
    beta, both = viscosity[0], viscosity[0] + viscosity[1]
    for g in range(points):
        for e in range(elements):
            dx, dy = work.x[g, e], work.y[g, e]
            x0, y0 = start.x[g, e], start.y[g, e]
            ax, ay = stretch.along_x[g, e], stretch.along_y[g, e]
            tx, ty = 1.0 + x0 + 0.5 * dx, y0 + 0.5 * dy
            exact = tx * dx + ty * dy
            along = ax * dx + ay * dy
            growth = stretch.offset[g, e] + along
            stretch.offset[g, e] = exact - along
            ea = axial.stiffness_n_m[g, e]
            normal = ea * (x0 + 0.5 * (x0 * x0 + y0 * y0) + 0.5 * growth)
            total = normal + ea * both * growth
            missed = ea * (0.5 + both) * (exact - growth)
            work.x[g, e] = total * tx + normal * beta * dx + missed * ax
            work.y[g, e] = total * ty + normal * beta * dy + missed * ay
    spread(work, axial.dshape, n, force)


@njit(cache=True, fastmath=REORDER)
def axial_tangent(
    start: Gradients,
    n: int,
    axial: Axial,
    viscosity: tuple[float, float],
    stretch: Stretch,
    work: Gradients,
    columns: FloatArray,
) -> None:
    """Linearise about the step with gradients `work`, and add the tangent to lower columns, (n + 7, 16).

    The tangent is symmetric: one direction between the middle and the end of the step is used for both.
    """
    points, elements = work.x.shape
    both = viscosity[0] + viscosity[1]
    for e in range(elements):
        offset = first_coordinate(n, elements) - PAD + 4 * e
        for g in range(points):
            dx, dy = work.x[g, e], work.y[g, e]
            x0, y0 = start.x[g, e], start.y[g, e]
            growth = stretch.offset[g, e] + stretch.along_x[g, e] * dx + stretch.along_y[g, e] * dy
            ax, ay = 1.0 + x0 + BETWEEN * dx, y0 + BETWEEN * dy
            stretch.along_x[g, e], stretch.along_y[g, e] = ax, ay
            stretch.offset[g, e] = growth - ax * dx - ay * dy
            ea = axial.stiffness_n_m[g, e]
            normal = ea * (x0 + 0.5 * (x0 * x0 + y0 * y0) + 0.5 * growth)
            isotropic = 0.5 * (normal + ea * both * growth) + normal * viscosity[0]
            stiff = ea * (0.5 + both)
            xx, xy, yy = stiff * ax * ax + isotropic, stiff * ax * ay, stiff * ay * ay + isotropic
            for k in range(4):
                row = offset + 2 * k
                if row < 0:
                    continue
                for m in range(k, 4):
                    scale = axial.dshape[g, k] * axial.dshape[g, m]
                    apart = 2 * (m - k)
                    columns[row, apart] += scale * xx
                    columns[row, apart + 1] += scale * xy
                    columns[row + 1, apart] += scale * yy
                    if m > k:
                        columns[row + 1, apart - 1] += scale * xy

"""Compiled forces of one time step, integrated at the Gauss points: axial force in mixed form, and air drag.

Values at the Gauss points are arrays (g ne,), element by element for each Gauss point in turn. A padded
state holds the free coordinates between zeros (`sim.beam.banded`); the node at an elastic clamp is part of the state,
that at a rigid one lies in the leading zeros.

The unknowns are strain and displacement. The energy-momentum rule applies EA times the mean strain of both ends of the
step to the tangent r' at its middle. An iterate with a rotation error of 1e-3 has a spurious strain of 5e-7, and EA
times that exceeds all other forces: Newton's method in displacements alone converges only once such errors have
vanished. Here the increase of the strain over the step is a separate unknown at each Gauss point, predicted by the
linearisation and corrected by its error. It is eliminated point by point, so that an iteration has the same cost and
the solution is the same.

References
----------
Magisano, Leonetti, Garcea, "How to improve efficiency and robustness of the Newton method in geometrically non-linear
structural problem discretized via displacement-based finite elements", CMAME 313 (2017) 986-1005,
doi:10.1016/j.cma.2016.10.023.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba.extending import register_jitable

from sim.beam import PAD, REORDER
from tracker import FloatArray


class Axial(NamedTuple):
    """Derivatives of the shape functions at the Gauss points, (g, 4); EA times the Gauss weight in m, (g ne,)."""

    dshape: FloatArray
    stiffness_n_m: FloatArray


class Air(NamedTuple):
    """Still air: shape functions and derivatives at the Gauss points, (g, 4), and the resistance there, (g ne,).

    The resistance is half of density times drag coefficient times width, times the Gauss weight in m; without air there
    are no points.
    """

    shape: FloatArray
    dshape: FloatArray
    resistance: FloatArray


class Gradients(NamedTuple):
    """Displacement gradient along and across the beam at the Gauss points, each (g ne,)."""

    x: FloatArray
    y: FloatArray


def empty_gradients(points: int) -> Gradients:
    """Memory for gradients at the Gauss points."""
    return Gradients(np.zeros(points), np.zeros(points))


@register_jitable
def first_coordinate(n: int, elements: int) -> int:
    """Index in a padded state of the first coordinate of the node at the clamp."""
    return PAD + n - 4 * (elements + 1)


@register_jitable(fastmath=REORDER)
def interpolate(padded: FloatArray, n: int, weights: FloatArray, out: Gradients) -> None:
    """Write ``sum_k weights[g, k] coordinate_k`` at each Gauss point, along and across the beam."""
    elements = out.x.size // weights.shape[0]
    first = first_coordinate(n, elements)
    for g in range(weights.shape[0]):
        a, b, c, d = weights[g, 0], weights[g, 1], weights[g, 2], weights[g, 3]
        for e in range(elements):
            p = padded[first + 4 * e : first + 4 * e + 8]
            out.x[g * elements + e] = a * p[0] + b * p[2] + c * p[4] + d * p[6]
            out.y[g * elements + e] = a * p[1] + b * p[3] + c * p[5] + d * p[7]


@register_jitable(fastmath=REORDER)
def spread(pressed: Gradients, weights: FloatArray, n: int, out: FloatArray) -> None:
    """Add ``weights[g, k] pressed`` to the coordinates of each element: the transpose of `interpolate`.

    `out` is padded: forces on a rigid clamp go to the leading zeros, which are reset.
    """
    elements = pressed.x.size // weights.shape[0]
    p, last = out[first_coordinate(n, elements) :], 4 * elements
    for g in range(weights.shape[0]):
        a, b, c, d = weights[g, 0], weights[g, 1], weights[g, 2], weights[g, 3]
        x, y = pressed.x[g * elements : (g + 1) * elements], pressed.y[g * elements : (g + 1) * elements]
        p[0] += a * x[0]
        p[1] += a * y[0]
        p[2] += b * x[0]
        p[3] += b * y[0]
        # node by node, so that no addition waits for that of the element before
        for e in range(1, elements):
            p[4 * e] += a * x[e] + c * x[e - 1]
            p[4 * e + 1] += a * y[e] + c * y[e - 1]
            p[4 * e + 2] += b * x[e] + d * x[e - 1]
            p[4 * e + 3] += b * y[e] + d * y[e - 1]
        p[last] += c * x[elements - 1]
        p[last + 1] += c * y[elements - 1]
        p[last + 2] += d * x[elements - 1]
        p[last + 3] += d * y[elements - 1]
    for i in range(PAD):
        out[i] = 0.0


@register_jitable(fastmath=REORDER)
def drag_force(
    start: Gradients,
    step: FloatArray,
    n: int,
    air: Air,
    h: float,
    base_m_s: float,
    work: tuple[Gradients, Gradients],
    force: FloatArray,
) -> None:
    """Add the drag of still air over the step to `force`.

    The force on a length dx is ``rho c_d b / 2 |v_n| v_n dx`` along the normal of the beam at the middle of the step;
    v_n is the normal component of the mean velocity over the step, the base's included. `start` holds the gradients at
    the start of the step at the Gauss points of `air`.
    """
    moved, turned = work
    interpolate(step, n, air.shape, moved)
    interpolate(step, n, air.dshape, turned)
    for i in range(air.resistance.size):
        tx = 1.0 + start.x[i] + 0.5 * turned.x[i]
        ty = start.y[i] + 0.5 * turned.y[i]
        length = np.sqrt(tx * tx + ty * ty)
        nx, ny = -ty / length, tx / length
        speed = nx * moved.x[i] / h + ny * (moved.y[i] / h + base_m_s)
        # the axial strain, by which the area of the deformed beam differs, is neglected
        pressed = air.resistance[i] * abs(speed) * speed
        moved.x[i], moved.y[i] = pressed * nx, pressed * ny
    spread(moved, air.shape, n, force)


@register_jitable(fastmath=REORDER)
def axial_energy(at: Gradients, axial: Axial) -> float:
    """Axial strain energy of a state whose gradients are `at`."""
    energy = 0.0
    for i in range(at.x.size):
        x, y = at.x[i], at.y[i]
        strain = x + 0.5 * (x * x + y * y)
        energy += 0.5 * axial.stiffness_n_m[i] * strain * strain
    return energy


@dataclass(frozen=True)
class Tuning:
    """The tangent of a step."""

    #: [1] share of the step's displacement gradient in the direction of the linearised tangent
    #: physics: The force acts along r' of the middle (0.5), the strain changes with that of the end (1): their mean.
    between: float = 0.75


TUNING = Tuning()
_BETWEEN = TUNING.between


class Stretch(NamedTuple):
    """Increase of twice the strain over the step at the Gauss points, each (g ne,).

    It is `offset` plus ``along`` times the step's displacement gradient, with ``along`` the value of r' when the matrix
    was factored; `before` is the strain at the start of the preceding step. The rest are parts of the tangent.
    """

    along_x: FloatArray
    along_y: FloatArray
    offset: FloatArray
    before: FloatArray
    xx: FloatArray
    xy: FloatArray
    yy: FloatArray


def empty_stretch(points: int) -> Stretch:
    """Memory for the increase at the Gauss points."""
    return Stretch(*(np.zeros(points) for _ in Stretch._fields))


@register_jitable(fastmath=REORDER)
def keep_strain(start: Gradients, stretch: Stretch) -> None:
    """Store the strain at the start of a step for the first guess of the next one."""
    for i in range(start.x.size):
        x, y = start.x[i], start.y[i]
        stretch.before[i] = x + 0.5 * (x * x + y * y)


@register_jitable(fastmath=REORDER, forceinline=True)
def predict(start: Gradients, stretch: Stretch, work: Gradients) -> None:
    """First guess of a step with gradients `work`: its mean strain is that of the preceding step."""
    for i in range(start.x.size):
        x, y = start.x[i], start.y[i]
        growth = stretch.before[i] - x - 0.5 * (x * x + y * y)
        stretch.offset[i] = growth - stretch.along_x[i] * work.x[i] - stretch.along_y[i] * work.y[i]


@register_jitable(fastmath=REORDER, forceinline=True)
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
    beta, both = viscosity[0], viscosity[0] + viscosity[1]
    for i in range(work.x.size):
        dx, dy = work.x[i], work.y[i]
        x0, y0 = start.x[i], start.y[i]
        ax, ay = stretch.along_x[i], stretch.along_y[i]
        tx, ty = 1.0 + x0 + 0.5 * dx, y0 + 0.5 * dy
        exact = tx * dx + ty * dy
        along = ax * dx + ay * dy
        growth = stretch.offset[i] + along
        stretch.offset[i] = exact - along
        ea = axial.stiffness_n_m[i]
        normal = ea * (x0 + 0.5 * (x0 * x0 + y0 * y0) + 0.5 * growth)
        total = normal + ea * both * growth
        missed = ea * (0.5 + both) * (exact - growth)
        work.x[i] = total * tx + normal * beta * dx + missed * ax
        work.y[i] = total * ty + normal * beta * dy + missed * ay
    spread(work, axial.dshape, n, force)


@register_jitable(fastmath=REORDER)
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
    both = viscosity[0] + viscosity[1]
    for i in range(work.x.size):
        dx, dy = work.x[i], work.y[i]
        x0, y0 = start.x[i], start.y[i]
        growth = stretch.offset[i] + stretch.along_x[i] * dx + stretch.along_y[i] * dy
        ax, ay = 1.0 + x0 + _BETWEEN * dx, y0 + _BETWEEN * dy
        stretch.along_x[i], stretch.along_y[i] = ax, ay
        stretch.offset[i] = growth - ax * dx - ay * dy
        ea = axial.stiffness_n_m[i]
        normal = ea * (x0 + 0.5 * (x0 * x0 + y0 * y0) + 0.5 * growth)
        isotropic = 0.5 * (normal + ea * both * growth) + normal * viscosity[0]
        stiff = ea * (0.5 + both)
        stretch.xx[i], stretch.xy[i] = stiff * ax * ax + isotropic, stiff * ax * ay
        stretch.yy[i] = stiff * ay * ay + isotropic
    points = axial.dshape.shape[0]
    elements = work.x.size // points
    for e in range(elements):
        offset = first_coordinate(n, elements) - PAD + 4 * e
        for k in range(4):
            row = offset + 2 * k
            for m in range(k if row >= 0 else 4, 4):
                xx, xy, yy = 0.0, 0.0, 0.0
                for g in range(points):
                    scale, i = axial.dshape[g, k] * axial.dshape[g, m], g * elements + e
                    xx += scale * stretch.xx[i]
                    xy += scale * stretch.xy[i]
                    yy += scale * stretch.yy[i]
                apart = 2 * (m - k)
                columns[row, apart] += xx
                columns[row, apart + 1] += xy
                columns[row + 1, apart] += yy
                if m > k:
                    columns[row + 1, apart - 1] += xy

"""Compiled interpolation at the Gauss points for a time step, axial energy, and air drag.

Values at the Gauss points are arrays (g, ne), one row per Gauss point, so that the loops run along the elements. A
padded state holds the free coordinates between zeros (`sim.beam.banded`); the node at an elastic clamp is part of the
state, that at a rigid one lies in the leading zeros.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from sim.beam import PAD, REORDER
from tracker import FloatArray


class Axial(NamedTuple):
    """Derivatives of the shape functions at the Gauss points, (g, 4); EA times the Gauss weight in m, (g, ne)."""

    dshape: FloatArray
    stiffness_n_m: FloatArray


class Air(NamedTuple):
    """Still air: shape functions and derivatives at the Gauss points, (g, 4), and the resistance there, (g, ne).

    The resistance is half of density times drag coefficient times width, times the Gauss weight in m; without air there
    are no rows.
    """

    shape: FloatArray
    dshape: FloatArray
    resistance: FloatArray


class Gradients(NamedTuple):
    """Displacement gradient along and across the beam at the Gauss points, each (g, ne)."""

    x: FloatArray
    y: FloatArray


def empty_gradients(points: tuple[int, int]) -> Gradients:
    """Memory for gradients at (g, ne) Gauss points."""
    return Gradients(np.zeros(points), np.zeros(points))


@njit(cache=True)
def first_coordinate(n: int, elements: int) -> int:
    """Index in a padded state of the first coordinate of the node at the clamp."""
    return PAD + n - 4 * (elements + 1)


@njit(cache=True, fastmath=REORDER)
def interpolate(padded: FloatArray, n: int, weights: FloatArray, out: Gradients) -> None:
    """Write ``sum_k weights[g, k] coordinate_k`` at each Gauss point, along and across the beam."""
    points, elements = out.x.shape
    first = first_coordinate(n, elements)
    for g in range(points):
        a, b, c, d = weights[g, 0], weights[g, 1], weights[g, 2], weights[g, 3]
        for e in range(elements):
            p = padded[first + 4 * e : first + 4 * e + 8]
            out.x[g, e] = a * p[0] + b * p[2] + c * p[4] + d * p[6]
            out.y[g, e] = a * p[1] + b * p[3] + c * p[5] + d * p[7]


@njit(cache=True, fastmath=REORDER)
def spread(pressed: Gradients, weights: FloatArray, n: int, out: FloatArray) -> None:
    """Add ``weights[g, k] pressed`` to the coordinates of each element: the transpose of `interpolate`.

    `out` is padded: forces on a rigid clamp go to the leading zeros, which are reset.
    """
    points, elements = pressed.x.shape
    first = first_coordinate(n, elements)
    for g in range(points):
        a, b, c, d = weights[g, 0], weights[g, 1], weights[g, 2], weights[g, 3]
        for e in range(elements):
            p = out[first + 4 * e : first + 4 * e + 8]
            px, py = pressed.x[g, e], pressed.y[g, e]
            p[0] += a * px
            p[1] += a * py
            p[2] += b * px
            p[3] += b * py
            p[4] += c * px
            p[5] += c * py
            p[6] += d * px
            p[7] += d * py
    for i in range(PAD):
        out[i] = 0.0


@njit(cache=True, fastmath=REORDER)
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
    points, elements = air.resistance.shape
    for g in range(points):
        for e in range(elements):
            tx = 1.0 + start.x[g, e] + 0.5 * turned.x[g, e]
            ty = start.y[g, e] + 0.5 * turned.y[g, e]
            length = np.sqrt(tx * tx + ty * ty)
            nx, ny = -ty / length, tx / length
            speed = nx * moved.x[g, e] / h + ny * (moved.y[g, e] / h + base_m_s)
            # the axial strain, by which the area of the deformed beam differs, is neglected
            pressed = air.resistance[g, e] * abs(speed) * speed
            moved.x[g, e], moved.y[g, e] = pressed * nx, pressed * ny
    spread(moved, air.shape, n, force)


@njit(cache=True, fastmath=REORDER)
def axial_energy(at: Gradients, axial: Axial) -> float:
    """Axial strain energy of a state whose gradients are `at`."""
    points, elements = at.x.shape
    energy = 0.0
    for g in range(points):
        for e in range(elements):
            x, y = at.x[g, e], at.y[g, e]
            strain = x + 0.5 * (x * x + y * y)
            energy += 0.5 * axial.stiffness_n_m[g, e] * strain * strain
    return energy

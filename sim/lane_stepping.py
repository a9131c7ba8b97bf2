"""Compiled time stepping of many draws at once: `sim.stepping` without halvings, the draw innermost.

All lanes iterate together until each has converged; a lane that does not is given up and left to the stepping of single
runs, which has more to fall back on.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sim.banded import PAD, REORDER
from sim.lane_kernels import (
    Blend,
    Points,
    add_axial_force,
    add_blend,
    add_rows_lanes,
    add_scaled,
    assemble,
    factor_lanes,
    lane_gradients,
    project_lanes,
    solve_lanes,
)
from sim.step_forces import Axial

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_ITERATIONS = 16
# iterations after which the tangents are factored anew within a step, and above which for the next one
_REFRESH = 7
_WORTH_FACTORING = 4
_FADING = 0.998
# as that of `sim.stepping`; draws are compared with each other, not with the energy of a minute
_RELATIVE_TOLERANCE = 2e-9


class LaneStructure(NamedTuple):
    """What resists the motion of each lane over a step.

    Attributes
    ----------
    linear, inertia, stiffness : Blend
        What multiplies the step's displacement; -2 / h times the mass; the bending stiffness.
    rows : array, shape (r, n)
        U^T of the modal corrections.
    gain, modal_inertia : array, shape (r, lanes)
        What multiplies ``U^T u`` and ``U^T v`` of a step.
    axial : Axial
    viscosity : tuple of array, shape (lanes,)
        On the rate of the axial force, and on the rate of the strain, each over h.
    dof_scale : array, shape (n,)
    floor_m : float
    """

    linear: Blend
    inertia: Blend
    stiffness: Blend
    rows: FloatArray
    gain: FloatArray
    modal_inertia: FloatArray
    axial: Axial
    viscosity: tuple[FloatArray, FloatArray]
    dof_scale: FloatArray
    floor_m: float


class LaneForcing(NamedTuple):
    """What drives the motion: as `sim.stepping.Forcing`, with (n, lanes) against the base's motion."""

    load: FloatArray
    inertia: FloatArray
    friction: FloatArray
    acceleration: FloatArray
    velocity: FloatArray


class LaneRoom(NamedTuple):
    """Memory: padded (n + 14, lanes), factors, Gauss points, modal coordinates, the steps before, sizes a lane."""

    q: FloatArray
    v: FloatArray
    guess: FloatArray
    constant: FloatArray
    residual: FloatArray
    columns: FloatArray
    inverse_pivot: FloatArray
    start: Points
    work: Points
    coordinate: FloatArray
    past: FloatArray
    reach: FloatArray
    size: FloatArray


@njit(cache=True)
def lane_room(q: FloatArray, v: FloatArray, modes: int, points: int, elements: int) -> LaneRoom:
    """Memory for the states `q` and `v`, shape (n, lanes)."""
    n, lanes = q.shape
    room = LaneRoom(
        np.zeros((n + 2 * PAD, lanes)),
        np.zeros((n + 2 * PAD, lanes)),
        np.zeros((n + 2 * PAD, lanes)),
        np.zeros((n + 2 * PAD, lanes)),
        np.zeros((n + 2 * PAD, lanes)),
        np.zeros((n + PAD, PAD + 1, lanes)),
        np.zeros((n, lanes)),
        Points(np.zeros((points, elements, lanes)), np.zeros((points, elements, lanes))),
        Points(np.zeros((points, elements, lanes)), np.zeros((points, elements, lanes))),
        np.zeros((modes, lanes)),
        np.zeros((3, n, lanes)),
        np.zeros(lanes),
        np.zeros(lanes),
    )
    room.q[PAD : PAD + n] = q
    room.v[PAD : PAD + n] = v
    return room


@njit(cache=True, fastmath=REORDER)
def begin_step(
    structure: LaneStructure, forcing: LaneForcing, index: int, known: int, h: float, room: LaneRoom
) -> None:
    """Write the step's constant part, its gradients and the first guess."""
    n, lanes = room.past.shape[1], room.size.size
    moving = forcing.acceleration[index] != 0.0 or forcing.velocity[index] != 0.0
    for i in range(n):
        row = room.constant[PAD + i]
        row[:] = -forcing.load[i]
        if moving:
            add_scaled(row, forcing.acceleration[index], forcing.inertia[i])
            add_scaled(row, forcing.velocity[index], forcing.friction[i])
    add_blend(structure.stiffness, room.q, room.constant)
    add_blend(structure.inertia, room.v, room.constant)
    project_lanes(structure.rows, room.v, room.coordinate)
    for r in range(structure.rows.shape[0]):
        for s in range(lanes):
            room.coordinate[r, s] *= structure.modal_inertia[r, s]
    add_rows_lanes(structure.rows, room.coordinate, room.constant)
    lane_gradients(room.q, structure.axial.dshape, room.start)
    for i in range(n):
        guess, a, b, c = room.guess[PAD + i], room.past[0, i], room.past[1, i], room.past[2, i]
        if known >= 3:
            for s in range(lanes):
                guess[s] = 3.0 * (a[s] - b[s]) + c[s]
        elif known == 2:
            for s in range(lanes):
                guess[s] = 2.0 * a[s] - b[s]
        else:
            for s in range(lanes):
                guess[s] = h * room.v[PAD + i, s]


@njit(cache=True, fastmath=REORDER)
def improve(structure: LaneStructure, room: LaneRoom) -> None:
    """One iteration of all lanes; writes the increments' sizes."""
    n, lanes = room.past.shape[1], room.size.size
    room.residual[:] = room.constant
    add_blend(structure.linear, room.guess, room.residual)
    add_axial_force(
        room.start,
        room.guess,
        structure.axial,
        structure.viscosity[0],
        structure.viscosity[1],
        room.work,
        room.residual,
    )
    project_lanes(structure.rows, room.guess, room.coordinate)
    for r in range(structure.rows.shape[0]):
        for s in range(lanes):
            room.coordinate[r, s] *= structure.gain[r, s]
    add_rows_lanes(structure.rows, room.coordinate, room.residual)
    solve_lanes(room.columns, room.inverse_pivot, room.residual)
    room.size[:] = 0.0
    for i in range(n):
        scale = structure.dof_scale[i]
        for s in range(lanes):
            room.guess[PAD + i, s] -= room.residual[PAD + i, s]
            room.size[s] += (scale * room.residual[PAD + i, s]) ** 2
    for s in range(lanes):
        room.size[s] = np.sqrt(room.size[s])


@njit(cache=True)
def refresh(structure: LaneStructure, room: LaneRoom) -> None:
    """Factor all lanes' tangents at the present guess."""
    assemble(
        structure.linear,
        room.start,
        room.guess,
        structure.axial,
        structure.viscosity,
        room.work,
        room.columns,
    )
    factor_lanes(room.columns, room.inverse_pivot)


@njit(cache=True)
def solve_step(structure: LaneStructure, alive: BoolArray, fresh: bool, room: LaneRoom) -> int:  # noqa: FBT001
    """Iterate until every lane that is alive has converged; those that do not are dead. Returns the iterations."""
    if not fresh:
        refresh(structure, room)
    lanes = alive.size
    for iteration in range(_ITERATIONS):
        if iteration == _REFRESH:
            refresh(structure, room)
        improve(structure, room)
        waiting = False
        for s in range(lanes):
            # a comparison with NaN is false
            enough = room.size[s] < max(structure.floor_m, _RELATIVE_TOLERANCE * room.reach[s])
            waiting = waiting or (alive[s] and not enough)
        if not waiting:
            return iteration + 1
    for s in range(lanes):
        alive[s] = alive[s] and room.size[s] < max(structure.floor_m, _RELATIVE_TOLERANCE * room.reach[s])
    return _ITERATIONS


@njit(cache=True, fastmath=REORDER)
def end_step(h: float, dof_scale: FloatArray, alive: BoolArray, room: LaneRoom) -> None:
    """Go on to the end of the step; dead lanes stay at rest."""
    n, lanes = room.past.shape[1], room.size.size
    for s in range(lanes):
        if not alive[s]:
            room.guess[:, s] = 0.0
            room.q[:, s] = 0.0
            room.v[:, s] = 0.0
    room.size[:] = 0.0
    for i in range(n):
        guess, q, v = room.guess[PAD + i], room.q[PAD + i], room.v[PAD + i]
        add = dof_scale[i] * dof_scale[i]
        for s in range(lanes):
            q[s] += guess[s]
        for s in range(lanes):
            v[s] = 2.0 / h * guess[s] - v[s]
        for s in range(lanes):
            room.size[s] += add * guess[s] * guess[s]
    room.past[2] = room.past[1]
    room.past[1] = room.past[0]
    room.past[0] = room.guess[PAD : PAD + n]
    for s in range(lanes):
        room.reach[s] = max(_FADING * room.reach[s], np.sqrt(room.size[s]))


@njit(cache=True)
def march_lanes(
    counts: tuple[int, int],
    h: float,
    q: FloatArray,
    v: FloatArray,
    structure: LaneStructure,
    forcing: LaneForcing,
    observed: FloatArray,
    out: FloatArray,
    alive: BoolArray,
) -> None:
    """Advance the states `q`, `v`, shape (n, lanes), in place over ``counts = (steps, output_every)`` steps.

    ``observed q`` of each lane, (m, n) times (n, lanes), is stored at every output in `out`, shape (rows, m, lanes);
    `alive` says which lanes converged to the end.
    """
    n = q.shape[0]
    points, elements = structure.axial.stiffness_n_m.shape
    room = lane_room(q, v, structure.rows.shape[0], points, elements)
    fresh = False
    for index in range(counts[0] + 1):
        if index % counts[1] == 0:
            row = out[index // counts[1]]
            row[:] = 0.0
            for m in range(observed.shape[0]):
                for i in range(n):
                    if observed[m, i] != 0.0:
                        add_scaled(row[m], observed[m, i], room.q[PAD + i])
        if index == counts[0]:
            break
        begin_step(structure, forcing, index, index, h, room)
        used = solve_step(structure, alive, fresh, room)
        fresh = used <= _WORTH_FACTORING
        end_step(h, structure.dof_scale, alive, room)
    q[:] = room.q[PAD : PAD + n]
    v[:] = room.v[PAD : PAD + n]

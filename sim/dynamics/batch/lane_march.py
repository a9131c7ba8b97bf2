"""Compiled time stepping of many draws at once: `sim.dynamics.march` without halvings, the draw innermost.

A lane is one draw.

All lanes iterate together until each has converged; one that does not is simulated alone, with step halving.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from sim.beam.banded import PAD, REORDER
from sim.dynamics.batch.lane_axial import (
    LaneStretch,
    add_axial_force,
    assemble,
    keep_lane_strain,
    predict_lanes,
)
from sim.dynamics.batch.lane_kernels import (
    Blend,
    Points,
    Rows,
    add_blend,
    add_momentum,
    add_rows_lanes,
    add_scaled,
    copy,
    correct_lanes,
    factor_lanes,
    fill,
    lane_gradients,
    project_lanes,
    scale,
    solve_lanes,
    woodbury_lanes,
)
from sim.dynamics.forces import Axial
from tracker.arrays import BoolArray, FloatArray

_ITERATIONS = 20
# as in `sim.dynamics.newton`, of the slowest lane
_WORTH_FACTORING = 0.03
_RENEW_NOW = 0.25
_TRUSTED = 0.5
_SMALLEST_CONTRACTION = 3e-3
_FADING = 0.998


class LaneStructure(NamedTuple):
    """What resists the motion of each lane over a step.

    Attributes
    ----------
    linear : Blend
        What multiplies the step's displacement.
    rows : Rows
        Of the modal corrections.
    gain, modal_inertia : array, shape (r, lanes)
        What multiplies ``U^T u`` and ``U^T v`` of a step.
    axial : Axial
    viscosity : tuple of array, shape (lanes,)
        On the rate of the axial force, and on the rate of the strain, each over h.
    low_rank : int
        The first of the rows that matters to the iteration, as in `sim.dynamics.newton.Step`.
    dof_scale : array, shape (n,)
    tolerance : tuple of float
        As in `sim.dynamics.march.Structure`.
    """

    linear: Blend
    rows: Rows
    gain: FloatArray
    modal_inertia: FloatArray
    axial: Axial
    viscosity: tuple[FloatArray, FloatArray]
    low_rank: int
    dof_scale: FloatArray
    tolerance: tuple[float, float]


class LaneForcing(NamedTuple):
    """What drives the motion: as `sim.dynamics.march.Forcing`, with (n, lanes) against the base's motion."""

    load: FloatArray
    inertia: FloatArray
    friction: FloatArray
    acceleration: FloatArray
    velocity: FloatArray


class LaneWorkspace(NamedTuple):
    """Memory: padded (n + 14, lanes), factors, Gauss points, modal coordinates, the steps before, sizes a lane."""

    q: FloatArray
    v: FloatArray
    guess: FloatArray
    constant: FloatArray
    residual: FloatArray
    columns: FloatArray
    inverse_pivot: FloatArray
    spread: FloatArray
    system: FloatArray
    start: Points
    work: Points
    stretch: LaneStretch
    coordinate: FloatArray
    factor: FloatArray
    past: FloatArray
    reach: FloatArray
    size: FloatArray
    previous: FloatArray


def lane_workspace(q: FloatArray, v: FloatArray, structure: LaneStructure) -> LaneWorkspace:
    """Memory for the states `q` and `v`, shape (n, lanes)."""
    n, lanes = q.shape
    modes = structure.gain.shape[0]
    points = (*structure.axial.stiffness_n_m.shape, lanes)
    padded = (n + 2 * PAD, lanes)
    workspace = LaneWorkspace(
        q=np.zeros(padded),
        v=np.zeros(padded),
        guess=np.zeros(padded),
        constant=np.zeros(padded),
        residual=np.zeros(padded),
        columns=np.zeros((n + PAD, PAD + 1, lanes)),
        inverse_pivot=np.zeros((n, lanes)),
        spread=np.zeros((modes, *padded)),
        system=np.zeros((modes, 2 * modes, lanes)),
        start=Points(np.zeros(points), np.zeros(points)),
        work=Points(np.zeros(points), np.zeros(points)),
        stretch=LaneStretch(
            np.zeros(points), np.zeros(points), np.zeros(points), np.zeros(points), np.zeros((5, lanes))
        ),
        coordinate=np.zeros((modes, lanes)),
        factor=np.zeros((modes, lanes)),
        past=np.zeros((3, n, lanes)),
        reach=np.zeros(lanes),
        size=np.zeros(lanes),
        previous=np.zeros(lanes),
    )
    workspace.q[PAD : PAD + n] = q
    workspace.v[PAD : PAD + n] = v
    return workspace


@njit(cache=True, fastmath=REORDER)
def begin_step(
    structure: LaneStructure, forcing: LaneForcing, index: int, h: float, workspace: LaneWorkspace
) -> None:
    """Write the step's constant part, its gradients and the first guess."""
    n = workspace.past.shape[1]
    moving = forcing.acceleration[index] != 0.0 or forcing.velocity[index] != 0.0
    for i in range(n):
        row = workspace.constant[PAD + i]
        fill(row, -forcing.load[i])
        if moving:
            add_scaled(row, forcing.acceleration[index], forcing.inertia[i])
            add_scaled(row, forcing.velocity[index], forcing.friction[i])
    add_momentum(structure.linear, -2.0 / h, workspace.v, workspace.q, workspace.constant)
    project_lanes(structure.rows, workspace.v, 0, workspace.coordinate)
    for r in range(structure.gain.shape[0]):
        scale(workspace.coordinate[r], structure.modal_inertia[r])
    add_rows_lanes(structure.rows, workspace.coordinate, workspace.constant)
    if index > 0:
        keep_lane_strain(workspace.start, workspace.stretch)
    lane_gradients(workspace.q, structure.axial.dshape, workspace.start)
    if index == 0:
        keep_lane_strain(workspace.start, workspace.stretch)
    _extrapolate(index, h, workspace)


@njit(cache=True, fastmath=REORDER)
def _extrapolate(index: int, h: float, workspace: LaneWorkspace) -> None:
    """Write the first guess of the step, as `sim.dynamics.newton.extrapolate`."""
    lanes = workspace.size.size
    for i in range(workspace.past.shape[1]):
        guess, a, b, c = (
            workspace.guess[PAD + i],
            workspace.past[0, i],
            workspace.past[1, i],
            workspace.past[2, i],
        )
        if index >= 3:
            for s in range(lanes):
                guess[s] = 3.0 * (a[s] - b[s]) + c[s]
        elif index == 2:
            for s in range(lanes):
                guess[s] = 2.0 * a[s] - b[s]
        else:
            fill(guess, 0.0)
            add_scaled(guess, h, workspace.v[PAD + i])


@njit(cache=True, fastmath=REORDER)
def improve(structure: LaneStructure, workspace: LaneWorkspace) -> None:
    """One iteration of all lanes from the gradients in ``workspace.work``; writes the increments' sizes."""
    n, lanes = workspace.past.shape[1], workspace.size.size
    for i in range(n + 2 * PAD):
        copy(workspace.constant[i], workspace.residual[i])
    add_blend(structure.linear, workspace.guess, workspace.residual)
    add_axial_force(
        workspace.start,
        structure.axial,
        structure.viscosity,
        workspace.stretch,
        workspace.work,
        workspace.residual,
    )
    project_lanes(structure.rows, workspace.guess, 0, workspace.coordinate)
    for r in range(structure.gain.shape[0]):
        scale(workspace.coordinate[r], structure.gain[r])
    add_rows_lanes(structure.rows, workspace.coordinate, workspace.residual)
    solve_lanes(workspace.columns, workspace.inverse_pivot, workspace.residual)
    work = (workspace.coordinate, workspace.factor)
    correct_lanes(
        structure.rows, structure.low_rank, workspace.spread, workspace.system, work, workspace.residual
    )
    copy(workspace.size, workspace.previous)
    fill(workspace.size, 0.0)
    for i in range(n):
        metres = structure.dof_scale[i] * structure.dof_scale[i]
        add_scaled(workspace.guess[PAD + i], -1.0, workspace.residual[PAD + i])
        for s in range(lanes):
            workspace.size[s] += metres * workspace.residual[PAD + i, s] * workspace.residual[PAD + i, s]
    for s in range(lanes):
        workspace.size[s] = np.sqrt(workspace.size[s])


@njit(cache=True)
def refresh(structure: LaneStructure, workspace: LaneWorkspace) -> None:
    """Factor all lanes' tangents at the present guess, whose gradients are ``workspace.work``."""
    assemble(
        structure.linear,
        workspace.start,
        structure.axial,
        structure.viscosity,
        workspace.stretch,
        workspace.work,
        workspace.columns,
    )
    factor_lanes(workspace.columns, workspace.inverse_pivot)
    woodbury_lanes(
        structure.rows,
        structure.gain,
        structure.low_rank,
        workspace.columns,
        workspace.inverse_pivot,
        workspace.spread,
        workspace.system,
    )


@njit(cache=True)
def solve_step(structure: LaneStructure, alive: BoolArray, slowest: float, workspace: LaneWorkspace) -> float:
    """Iterate until every lane that is alive has converged; those that do not are dead.

    `slowest` is what the last iteration of the step before reduced the increment of the slowest lane to. Returns that
    of this step.
    """
    lanes = alive.size
    renew = slowest > _WORTH_FACTORING
    for iteration in range(_ITERATIONS):
        lane_gradients(workspace.guess, structure.axial.dshape, workspace.work)
        if iteration == 0:
            predict_lanes(workspace.start, workspace.stretch, workspace.work)
        if renew:
            refresh(structure, workspace)
        improve(structure, workspace)
        waiting, slowest = False, 0.0
        for s in range(lanes):
            enough = max(structure.tolerance[1], structure.tolerance[0] * workspace.reach[s])
            contraction = _TRUSTED
            if iteration > 0:
                contraction = max(
                    _SMALLEST_CONTRACTION, workspace.size[s] / max(workspace.previous[s], 1e-300)
                )
            # a comparison with NaN is false
            good = workspace.size[s] < enough
            good = good or (contraction < _TRUSTED and workspace.size[s] * contraction < enough)
            if alive[s] and not good:
                waiting = True
                if iteration == _ITERATIONS - 1 or not np.isfinite(workspace.size[s]):
                    alive[s] = False
            if alive[s] and iteration > 0 and not workspace.size[s] < enough:
                slowest = max(slowest, contraction)
        if not waiting:
            break
        renew = slowest > _RENEW_NOW
    return slowest


@njit(cache=True, fastmath=REORDER)
def end_step(h: float, dof_scale: FloatArray, alive: BoolArray, workspace: LaneWorkspace) -> None:
    """Go on to the end of the step; dead lanes stay at rest."""
    n, lanes = workspace.past.shape[1], workspace.size.size
    for s in range(lanes):
        if not alive[s]:
            for i in range(PAD, PAD + n):
                workspace.guess[i, s] = 0.0
                workspace.q[i, s] = 0.0
                workspace.v[i, s] = 0.0
        workspace.size[s] = 0.0
    for i in range(n):
        guess, q, v = workspace.guess[PAD + i], workspace.q[PAD + i], workspace.v[PAD + i]
        add = dof_scale[i] * dof_scale[i]
        for s in range(lanes):
            q[s] += guess[s]
        for s in range(lanes):
            v[s] = 2.0 / h * guess[s] - v[s]
        for s in range(lanes):
            workspace.size[s] += add * guess[s] * guess[s]
        copy(workspace.past[1, i], workspace.past[2, i])
        copy(workspace.past[0, i], workspace.past[1, i])
        copy(guess, workspace.past[0, i])
    for s in range(lanes):
        workspace.reach[s] = max(_FADING * workspace.reach[s], np.sqrt(workspace.size[s]))


@njit(cache=True)
def march_lanes(
    counts: tuple[int, int],
    h: float,
    q: FloatArray,
    v: FloatArray,
    structure: LaneStructure,
    forcing: LaneForcing,
    observed: FloatArray,
    workspace: LaneWorkspace,
    out: FloatArray,
    alive: BoolArray,
) -> None:
    """Advance the states `q`, `v`, shape (n, lanes), in place over ``counts = (steps, output_every)`` steps.

    ``observed q`` of each lane, (m, n) times (n, lanes), is stored at every output in `out`, shape (rows, m, lanes);
    `alive` says which lanes converged to the end.
    """
    n = q.shape[0]
    slowest = np.inf
    for index in range(counts[0] + 1):
        if index % counts[1] == 0:
            row = out[index // counts[1]]
            for m in range(observed.shape[0]):
                fill(row[m], 0.0)
                for i in range(n):
                    if observed[m, i] != 0.0:
                        add_scaled(row[m], observed[m, i], workspace.q[PAD + i])
        if index == counts[0]:
            break
        begin_step(structure, forcing, index, h, workspace)
        slowest = solve_step(structure, alive, slowest, workspace)
        end_step(h, structure.dof_scale, alive, workspace)
    for i in range(n):
        copy(workspace.q[PAD + i], q[i])
        copy(workspace.v[PAD + i], v[i])

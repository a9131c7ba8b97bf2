"""Compiled time stepping of the ANCF beam: energy-momentum midpoint rule with low-rank modal corrections.

The equations are in `sim.dynamics.simulate`; `sim.dynamics.newton` solves a step. Functions of structures of arrays
are inlined into `march`: to pass these took a quarter of a step.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numba.extending import register_jitable

from sim.beam import PAD, REORDER, add_product
from sim.dynamics.forces import Air, Axial, Gradients, axial_energy, empty_gradients, interpolate, keep_strain
from sim.dynamics.newton import (
    FACTORED_LEVEL,
    HALVINGS,
    HISTORY,
    ITERATIONS,
    STEP,
    Step,
    Workspace,
    add_rows,
    empty_workspace,
    extrapolate,
    project,
    solve_step,
)
from tracker import FloatArray, IntArray

DONE = 0
DIVERGED = 1


@dataclass(frozen=True)
class Tuning:
    """Scale of a step's tolerance."""

    #: [1] factor per step on the largest displacement of the preceding steps
    #: physics: Forgets over 500 steps, half a period of the paper's mode 1 at 0.5 ms: the scale stays where the beam
    #: turns.
    fading: float = 0.998


TUNING = Tuning()
_FADING = TUNING.fading


class Structure(NamedTuple):
    """Inertia, stiffness and damping; for each halving level where they depend on the step.

    Attributes
    ----------
    mass, bending, linear : array, shape (15, n) or (7, n), the last (levels, ...)
        Diagonals: all, or those that are not zero. `linear` multiplies the displacement of the step.
    linear_columns : array, shape (levels, n + 7, 16)
    rows : array, shape (r, n)
        U^T of the modal corrections.
    modal_mass, gain : array, shape (levels, r)
        The latter is the factor of ``U^T u`` in a step, ``2 mu / h^2 + d / h``.
    low_rank : array of int, shape (levels,)
        As in `sim.dynamics.newton.Step`.
    relaxation_s : tuple of float
        Stiffness-proportional damping on K(q), and Kelvin-Voigt damping of the axial strain.
    dof_scale : array, shape (n,)
    tolerance : tuple of float
        A step has converged when its error is less than the first times the largest displacement of the preceding
        steps, or less than the second in m.
    """

    mass: FloatArray
    bending: FloatArray
    linear_columns: FloatArray
    linear: FloatArray
    rows: FloatArray
    modal_mass: FloatArray
    gain: FloatArray
    low_rank: IntArray
    axial: Axial
    air: Air
    relaxation_s: tuple[float, float]
    dof_scale: FloatArray
    tolerance: tuple[float, float]


class Forcing(NamedTuple):
    """Dead load and force of a unit base acceleration, (n,); mean base acceleration and velocity of each step."""

    load: FloatArray
    inertia: FloatArray
    acceleration: FloatArray
    velocity: FloatArray


class Moment(NamedTuple):
    """A padded state with what the energy and the next step need: products, ``U^T v``, gradients."""

    q: FloatArray
    v: FloatArray
    mass_v: FloatArray
    bending_q: FloatArray
    rate: FloatArray
    axial: Gradients
    air: Gradients


class Memory(NamedTuple):
    """Work memory: state, iteration, guesses, constant part, last three displacements, counts of `newton`."""

    now: Moment
    workspace: Workspace
    guess: FloatArray
    constant: FloatArray
    first: FloatArray
    past: FloatArray
    kept: IntArray


@register_jitable(forceinline=True)
def observe(q: FloatArray, v: FloatArray, structure: Structure, now: Moment) -> None:
    """Fill `now` with a state."""
    for i in range(q.size):
        now.q[PAD + i] = q[i]
        now.v[PAD + i] = v[i]
        now.mass_v[i] = 0.0
        now.bending_q[i] = 0.0
    add_product(structure.mass, now.v, now.mass_v)
    add_product(structure.bending, now.q, now.bending_q)
    project(structure.rows, v, 0, now.rate)
    interpolate(now.q, q.size, structure.axial.dshape, now.axial)
    if structure.air.resistance.size > 0:
        interpolate(now.q, q.size, structure.air.dshape, now.air)


@register_jitable(fastmath=REORDER)
def total_energy(now: Moment, structure: Structure, load: FloatArray) -> float:
    """Kinetic, strain and potential energy, which the step conserves; the kinetic one with the modal correction."""
    energy = axial_energy(now.axial, structure.axial)
    for i in range(load.size):
        energy += 0.5 * now.v[PAD + i] * now.mass_v[i] + (0.5 * now.bending_q[i] - load[i]) * now.q[PAD + i]
    for r in range(now.rate.size):
        energy += 0.5 * structure.modal_mass[0, r] * now.rate[r] * now.rate[r]
    return energy


@register_jitable(fastmath=REORDER, forceinline=True)
def equation(
    h: float,
    now: Moment,
    structure: Structure,
    level: int,
    forcing: Forcing,
    index: int,
    factors: FloatArray,
    constant: FloatArray,
) -> Step:
    """Equation of the step that begins at `now`; writes its part without the displacement to `constant`."""
    for i in range(constant.size):
        constant[i] = now.bending_q[i] - 2.0 / h * now.mass_v[i] - forcing.load[i]
        constant[i] += forcing.acceleration[index] * forcing.inertia[i]
    for r in range(now.rate.size):
        factors[r] = -2.0 / h * structure.modal_mass[level, r] * now.rate[r]
    add_rows(structure.rows, factors, 0, constant)
    return Step(
        constant,
        structure.linear_columns[level],
        structure.linear[level],
        structure.rows,
        structure.gain[level],
        structure.low_rank[level],
        structure.axial,
        structure.air,
        now.axial,
        now.air,
        (structure.relaxation_s[0] / h, structure.relaxation_s[1] / h),
        h,
        forcing.velocity[index],
    )


def memory_for(structure: Structure) -> Memory:
    """Allocated memory for a run."""
    r, n = structure.rows.shape
    points, windy = structure.axial.stiffness_n_m.size, structure.air.resistance.size
    now = Moment(
        q=np.zeros(n + 2 * PAD),
        v=np.zeros(n + 2 * PAD),
        mass_v=np.zeros(n),
        bending_q=np.zeros(n),
        rate=np.zeros(r),
        axial=empty_gradients(points),
        air=empty_gradients(windy),
    )
    return Memory(
        now=now,
        workspace=empty_workspace(n, r, points, windy),
        guess=np.zeros(n + 2 * PAD),
        constant=np.zeros(n),
        first=np.zeros(n),
        past=np.zeros((3, n)),
        kept=np.array([-1, 0], dtype=np.int64),
    )


@register_jitable(fastmath=REORDER, forceinline=True)
def accept(
    h: float, guess: FloatArray, dof_scale: FloatArray, history: FloatArray, q: FloatArray, v: FloatArray
) -> float:
    """Advance to the end of the step; returns the norm of its displacement."""
    square = 0.0
    for i in range(q.size):
        u = guess[PAD + i]
        history[2, i], history[1, i], history[0, i] = history[1, i], history[0, i], u
        q[i] += u
        v[i] = 2.0 / h * u - v[i]
        square += (u * dof_scale[i]) ** 2
    return float(np.sqrt(square))


# Nothing is allocated here, so that references are not counted: counting took half of the time.
@njit(cache=True, _nrt=False)  # type: ignore[call-overload]  # numba's own option, absent from its types
def march(
    counts: tuple[int, int],
    step_s: float,
    q: FloatArray,
    v: FloatArray,
    structure: Structure,
    forcing: Forcing,
    memory: Memory,
    out_q: FloatArray,
    out_energy: FloatArray,
    info: IntArray,
) -> int:
    """Advance `q`, `v` in place over ``counts = (steps, output_every)`` steps and store every output.

    A step that does not converge is halved, down to ``step / 2^(levels - 1)``. `info` counts iterations, factorisations
    and halvings, and holds the step reached.

    Returns
    -------
    int
        `DONE` or `DIVERGED`; after the latter ``info[STEP]`` is the step that failed.
    """
    n, levels = q.size, structure.linear_columns.shape[0]
    parts = 1 << (levels - 1)
    now, workspace, guess, constant, first, past, kept = memory
    # read from an array, so that the compiler infers a 64-bit integer
    level = kept[HISTORY]
    observe(q, v, structure, now)
    keep_strain(now.axial, workspace.stretch)
    reach = 0.0
    for index in range(counts[0]):
        info[STEP] = index
        position = 0
        while position < parts:
            h = step_s / (1 << level)
            observe(q, v, structure, now)
            if position == 0 and index % counts[1] == 0:
                for i in range(n):
                    out_q[index // counts[1], i] = q[i]
                out_energy[index // counts[1]] = total_energy(now, structure, forcing.load)
            step = equation(h, now, structure, level, forcing, index, workspace.factors, constant)
            for i in range(n):
                first[i] = h * v[i]
            tolerance = max(structure.tolerance[1], structure.tolerance[0] * reach / (1 << level))
            extrapolate(past, kept[HISTORY], first, guess)
            used = solve_step(level, step, guess, structure.dof_scale, tolerance, workspace, kept, info)
            if used < 0:
                kept[FACTORED_LEVEL], kept[HISTORY] = -1, 0
                if level == levels - 1:
                    return DIVERGED
                level += 1
                info[HALVINGS] += 1
                continue
            info[ITERATIONS] += used
            reach = max(_FADING * reach, accept(h, guess, structure.dof_scale, past, q, v) * (1 << level))
            keep_strain(now.axial, workspace.stretch)
            kept[HISTORY] += 1
            position += parts >> level
            if level > 0 and position % (parts >> (level - 1)) == 0:
                level -= 1
                kept[FACTORED_LEVEL], kept[HISTORY] = -1, 0
    if counts[0] % counts[1] == 0:
        observe(q, v, structure, now)
        for i in range(n):
            out_q[counts[0] // counts[1], i] = q[i]
        out_energy[counts[0] // counts[1]] = total_energy(now, structure, forcing.load)
    return DONE

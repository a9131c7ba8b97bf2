"""Compiled time stepping of the ANCF beam: energy-momentum midpoint rule with low-rank modal corrections."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sim.banded import PAD, REORDER, add_product
from sim.step_forces import Air, Axial, Gradients, axial_energy, empty_gradients, interpolate
from sim.step_newton import (
    FACTORED_LEVEL,
    FULL_FOR,
    HALVINGS,
    HISTORY,
    ITERATIONS,
    STEP,
    Room,
    Step,
    attempt,
    empty_room,
    project,
)

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

DONE = 0
DIVERGED = 1

# A step's iteration ends at an increment of this share of the largest displacement of the steps just past (their memory
# fades at the rate below), or at the floor; the error left is smaller by the contraction of the last iteration.
RELATIVE_TOLERANCE = 5e-10
_FADING = 0.998


class Structure(NamedTuple):
    """What resists the motion, at each of the step's halving levels where it depends on the step.

    Attributes
    ----------
    mass, bending : array, shape (15, n)
        Transposed bands.
    linear, linear_transposed : array, shape (levels, n, 15) and (levels, 15, n)
        What multiplies the step's displacement.
    rows : array, shape (r, n)
        U^T of the modal corrections.
    modal_mass : array, shape (levels, r)
    gain : array, shape (levels, r)
        What multiplies ``U^T u`` in a step: ``2 mu / h^2 + d / h``.
    low_rank : array of bool, shape (levels,)
        As in `sim.step_newton.Step`.
    axial, air : Axial, Air
    relaxation_s : tuple of float
        Stiffness-proportional damping on K(q), and Kelvin-Voigt damping of the axial strain.
    dof_scale : array, shape (n,)
    floor_m : float
        Increment below which any step's iteration ends.
    """

    mass: FloatArray
    bending: FloatArray
    linear: FloatArray
    linear_transposed: FloatArray
    rows: FloatArray
    modal_mass: FloatArray
    gain: FloatArray
    low_rank: BoolArray
    axial: Axial
    air: Air
    relaxation_s: tuple[float, float]
    dof_scale: FloatArray
    floor_m: float


class Forcing(NamedTuple):
    """What drives the motion: dead load, and mean acceleration and velocity of the base over each step.

    Attributes
    ----------
    load, inertia, friction : array, shape (n,)
        Dead load; what resists a unit acceleration and a unit velocity of the base.
    acceleration, velocity : array, shape (steps,)
    """

    load: FloatArray
    inertia: FloatArray
    friction: FloatArray
    acceleration: FloatArray
    velocity: FloatArray


class Moment(NamedTuple):
    """What energy and next step need of a state.

    Attributes
    ----------
    q, v : array, shape (n + 14,)
        Padded.
    mass_v, bending_q : array, shape (n,)
    rate : array, shape (r,)
        ``U^T v``.
    axial, air : Gradients
        At the Gauss points of the axial force and of the air.
    """

    q: FloatArray
    v: FloatArray
    mass_v: FloatArray
    bending_q: FloatArray
    rate: FloatArray
    axial: Gradients
    air: Gradients


@njit(cache=True)
def observe(q: FloatArray, v: FloatArray, structure: Structure, now: Moment) -> None:
    """Fill `now` with a state."""
    n = q.size
    now.q[PAD : PAD + n] = q
    now.v[PAD : PAD + n] = v
    now.mass_v[:] = 0.0
    now.bending_q[:] = 0.0
    add_product(structure.mass, 1.0, now.v, now.mass_v)
    add_product(structure.bending, 1.0, now.q, now.bending_q)
    project(structure.rows, v, now.rate)
    interpolate(now.q, n, structure.axial.dshape, now.axial)
    if structure.air.resistance.shape[0] > 0:
        interpolate(now.q, n, structure.air.dshape, now.air)


@njit(cache=True, fastmath=REORDER)
def total_energy(now: Moment, structure: Structure, load: FloatArray) -> float:
    """Kinetic, strain and potential energy, which the step conserves; the kinetic one with the modal correction."""
    energy = axial_energy(now.axial, structure.axial)
    for i in range(load.size):
        energy += 0.5 * now.v[PAD + i] * now.mass_v[i] + (0.5 * now.bending_q[i] - load[i]) * now.q[PAD + i]
    for r in range(now.rate.size):
        energy += 0.5 * structure.modal_mass[0, r] * now.rate[r] * now.rate[r]
    return energy


@njit(cache=True, fastmath=REORDER)
def constant_part(
    h: float,
    now: Moment,
    structure: Structure,
    level: int,
    forcing: Forcing,
    index: int,
    out: FloatArray,
) -> None:
    """Write what of the residual does not depend on the step's displacement."""
    acceleration, velocity = forcing.acceleration[index], forcing.velocity[index]
    for i in range(out.size):
        out[i] = now.bending_q[i] - 2.0 / h * now.mass_v[i] - forcing.load[i]
        out[i] += acceleration * forcing.inertia[i] + velocity * forcing.friction[i]
    for r in range(now.rate.size):
        factor = -2.0 / h * structure.modal_mass[level, r] * now.rate[r]
        for i in range(out.size):
            out[i] += factor * structure.rows[r, i]


@njit(cache=True)
def equation(
    h: float,
    now: Moment,
    structure: Structure,
    level: int,
    forcing: Forcing,
    index: int,
    constant: FloatArray,
) -> Step:
    """Equation of the step from `now` on; writes its constant part to `constant`."""
    constant_part(h, now, structure, level, forcing, index, constant)
    return Step(
        constant,
        structure.linear[level],
        structure.linear_transposed[level],
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


@njit(cache=True)
def memory_for(n: int, structure: Structure) -> tuple[Moment, Room]:
    """Memory for a state and for the iteration."""
    r = structure.rows.shape[0]
    points, elements = structure.axial.stiffness_n_m.shape
    windy = structure.air.resistance.shape[0]
    now = Moment(
        np.zeros(n + 2 * PAD),
        np.zeros(n + 2 * PAD),
        np.zeros(n),
        np.zeros(n),
        np.zeros(r),
        empty_gradients(points, elements),
        empty_gradients(windy, elements),
    )
    room = empty_room(
        n,
        r,
        empty_gradients(points, elements),
        empty_gradients(windy, elements),
        empty_gradients(windy, elements),
    )
    return now, room


@njit(cache=True, fastmath=REORDER)
def accept(
    h: float, guess: FloatArray, dof_scale: FloatArray, history: FloatArray, q: FloatArray, v: FloatArray
) -> float:
    """Go on to the end of the step; returns the size of its displacement, measured as increments are."""
    square = 0.0
    for i in range(q.size):
        u = guess[PAD + i]
        history[2, i], history[1, i], history[0, i] = history[1, i], history[0, i], u
        q[i] += u
        v[i] = 2.0 / h * u - v[i]
        square += (u * dof_scale[i]) ** 2
    return float(np.sqrt(square))


@njit(cache=True)
def march(
    counts: tuple[int, int],
    step_s: float,
    q: FloatArray,
    v: FloatArray,
    structure: Structure,
    forcing: Forcing,
    out_q: FloatArray,
    out_energy: FloatArray,
    info: IntArray,
) -> int:
    """Advance `q`, `v` in place over ``counts = (steps, output_every)`` steps and store every output.

    A step that the symmetric tangent does not solve is tried with the full one, then in halves, down to
    ``step / 2^(levels - 1)``. `info` counts iterations, factorisations, attempts with the full tangent, halvings,
    and the step reached.

    Returns
    -------
    int
        `DONE` or `DIVERGED`; after the latter ``info[STEP]`` is the step that failed.
    """
    n, levels = q.size, structure.linear.shape[0]
    parts = 1 << (levels - 1)
    guess, constant, first = np.zeros(n + 2 * PAD), np.empty(n), np.empty(n)
    now, room = memory_for(n, structure)
    past = np.zeros((3, n))
    memory = np.array([-1, 0, 0, -1], dtype=np.int64)
    # an array's element is an integer to the compiler, a plain 0 would be a type of its own
    level = memory[FULL_FOR]
    reach = 0.0
    for index in range(counts[0]):
        info[STEP] = index
        position = 0
        while position < parts:
            h = step_s / (1 << level)
            observe(q, v, structure, now)
            if position == 0 and index % counts[1] == 0:
                out_q[index // counts[1]] = q
                out_energy[index // counts[1]] = total_energy(now, structure, forcing.load)
            step = equation(h, now, structure, level, forcing, index, constant)
            first[:] = h * v
            tolerance = max(structure.floor_m, RELATIVE_TOLERANCE * reach / (1 << level))
            used = attempt(
                level, step, first, guess, structure.dof_scale, tolerance, past, room, memory, info
            )
            if used < 0:
                memory[FACTORED_LEVEL], memory[HISTORY] = -1, 0
                if level == levels - 1:
                    return DIVERGED
                level += 1
                info[HALVINGS] += 1
                continue
            info[ITERATIONS] += used
            reach = max(_FADING * reach, accept(h, guess, structure.dof_scale, past, q, v) * (1 << level))
            memory[HISTORY] += 1
            position += parts >> level
            if level > 0 and position % (parts >> (level - 1)) == 0:
                level -= 1
                memory[FACTORED_LEVEL], memory[HISTORY] = -1, 0
    if counts[0] % counts[1] == 0:
        observe(q, v, structure, now)
        out_q[counts[0] // counts[1]] = q
        out_energy[counts[0] // counts[1]] = total_energy(now, structure, forcing.load)
    return DONE

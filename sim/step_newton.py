"""Compiled solution of one time step: Newton's iteration with a symmetric tangent that is kept, or the full one.

The low-rank modal terms ``U gain U^T`` stand beside the band (Woodbury). Padded vectors, shape (n + 14,), are those
of `sim.banded`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sim.banded import (
    BAND,
    COLUMN,
    PAD,
    REORDER,
    add_product,
    factor_symmetric,
    lower_columns,
    solve_general,
    solve_symmetric,
)
from sim.step_forces import Air, Axial, Gradients, axial_force, drag_force, full_tangent, symmetric_tangent

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_SYMMETRIC_ITERATIONS = 12
_FULL_ITERATIONS = 20
_STEPS_WITH_FULL = 16
# multiple of the tolerance below which increments that fall no further are taken for round-off
_STALLED = 50.0
# iterations above which the symmetric tangent is factored anew for the next step
_WORTH_FACTORING = 3
# and iterations above which the low-rank part is prepared anew as well
_WORTH_WOODBURY = 4

# places in the array of counts
ITERATIONS, FACTORISATIONS, FULL_ATTEMPTS, HALVINGS, STEP = range(5)
# places in the array of what is remembered from step to step
FACTORED_LEVEL, FULL_FOR, HISTORY, MODAL_LEVEL = range(4)


class Step(NamedTuple):
    """Equation of one step, ``constant + linear u + U gain U^T u + axial(u) + drag(u) = 0``.

    Attributes
    ----------
    constant : array, shape (n,)
    band, transposed : array, shape (n, 15) and (15, n)
        The linear part, twice.
    rows, gain : array, shape (r, n) and (r,)
        U^T, and its factors.
    low_rank : bool
        Whether they matter to the iteration: of the tangent they are (omega h)^2 / 12, at short steps nothing.
    axial, air : Axial, Air
    start, windward : Gradients
        At the start of the step, at the Gauss points of `axial` and of `air`.
    viscosity : tuple of float
        As in `axial_force`.
    h, base_m_s : float
        Length of the step in s, mean velocity of the base.
    """

    constant: FloatArray
    band: FloatArray
    transposed: FloatArray
    rows: FloatArray
    gain: FloatArray
    low_rank: bool
    axial: Axial
    air: Air
    start: Gradients
    windward: Gradients
    viscosity: tuple[float, float]
    h: float
    base_m_s: float


class Room(NamedTuple):
    """Memory of the iteration: factors kept from step to step, and what is written over every time.

    Attributes
    ----------
    columns : array, shape (n + 7, 16)
    inverse_pivot : array, shape (n,)
    spread : array, shape (r, n)
        ``(A^-1 U)^T``.
    small : array, shape (r, r)
        ``(1 + gain U^T A^-1 U)^-1 gain``.
    residual : array, shape (n + 14,)
    coordinate : array, shape (r,)
    work : Gradients
        At the axial Gauss points.
    moved, turned : Gradients
        At those of the air.
    """

    columns: FloatArray
    inverse_pivot: FloatArray
    spread: FloatArray
    small: FloatArray
    residual: FloatArray
    coordinate: FloatArray
    work: Gradients
    moved: Gradients
    turned: Gradients


@njit(cache=True)
def empty_room(n: int, r: int, work: Gradients, moved: Gradients, turned: Gradients) -> Room:
    """Room for the iteration of a beam of n coordinates with r modal terms."""
    return Room(
        np.zeros((n + PAD, COLUMN)),
        np.ones(n),
        np.zeros((r, n)),
        np.zeros((r, r)),
        np.zeros(n + 2 * PAD),
        np.zeros(r),
        work,
        moved,
        turned,
    )


@njit(cache=True, fastmath=REORDER)
def project(modal: FloatArray, x: FloatArray, out: FloatArray) -> None:
    """Write ``modal x`` to `out`; `modal` has one row a mode."""
    for r in range(modal.shape[0]):
        total = 0.0
        for i in range(x.size):
            total += modal[r, i] * x[i]
        out[r] = total


@njit(cache=True, fastmath=REORDER)
def add_rows(modal: FloatArray, factors: FloatArray, out: FloatArray) -> None:
    """Add ``modal^T factors`` to `out`."""
    for r in range(modal.shape[0]):
        factor = factors[r]
        for i in range(out.size):
            out[i] += factor * modal[r, i]


@njit(cache=True)
def woodbury(room: Room, rows: FloatArray, gain: FloatArray) -> None:
    """Prepare the solution with ``A + U gain U^T`` from the factors of A."""
    n, r = room.inverse_pivot.size, rows.shape[0]
    system = np.zeros((r, 2 * r))
    column = np.zeros(n + PAD)
    for a in range(r):
        column[:n] = rows[a]
        solve_symmetric(room.columns, room.inverse_pivot, column)
        room.spread[a] = column[:n]
    for a in range(r):
        project(room.spread, rows[a], system[a, :r])
        for b in range(r):
            system[a, b] *= gain[a]
        system[a, a] += 1.0
        system[a, r + a] = gain[a]
    # the gains are small beside the tangent, so that the diagonal is near one and needs no pivoting
    for a in range(r):
        system[a] /= system[a, a]
        for b in range(r):
            if b != a:
                system[b] -= system[b, a] * system[a]
    room.small[:] = system[:, r:]


@njit(cache=True)
def solve_kept(room: Room, rows: FloatArray, low_rank: bool) -> None:  # noqa: FBT001
    """Solve for the residual in place with the factors that are kept and, where wanted, their low-rank part."""
    n, r = room.inverse_pivot.size, rows.shape[0]
    solve_symmetric(room.columns, room.inverse_pivot, room.residual[PAD:])
    if not low_rank:
        return
    x = room.residual[PAD : PAD + n]
    project(rows, x, room.coordinate)
    for a in range(r):
        total = 0.0
        for b in range(r):
            total -= room.small[a, b] * room.coordinate[b]
        for i in range(n):
            x[i] += total * room.spread[a, i]


@njit(cache=True, fastmath=REORDER)
def residual_of(step: Step, guess: FloatArray, room: Room) -> None:
    """Write the step's equation at `guess`, with the opposite sign, to ``room.residual``."""
    n = step.constant.size
    out = room.residual
    out[:PAD] = 0.0
    out[PAD + n :] = 0.0
    inner = out[PAD : PAD + n]
    inner[:] = step.constant
    add_product(step.transposed, 1.0, guess, inner)
    axial_force(step.start, guess, n, step.axial, step.viscosity, room.work, out)
    if step.air.resistance.size > 0:
        drag_force(step.windward, guess, n, step.air, step.h, step.base_m_s, (room.moved, room.turned), out)
    project(step.rows, guess[PAD : PAD + n], room.coordinate)
    for a in range(step.gain.size):
        room.coordinate[a] *= step.gain[a]
    add_rows(step.rows, room.coordinate, inner)
    for i in range(n):
        inner[i] = -inner[i]


@njit(cache=True, fastmath=REORDER)
def advance(guess: FloatArray, increment: FloatArray, dof_scale: FloatArray) -> float:
    """Add the increment to the padded guess; its size is the root of its sum of squares, which NaN cannot hide in."""
    square = 0.0
    for i in range(increment.size):
        guess[PAD + i] += increment[i]
        scaled = increment[i] * dof_scale[i]
        square += scaled * scaled
    return float(np.sqrt(square))


@njit(cache=True)
def iterate(
    step: Step,
    guess: FloatArray,
    dof_scale: FloatArray,
    tolerance: float,
    full: bool,  # noqa: FBT001 - numba takes no keyword-only arguments
    room: Room,
) -> int:
    """Newton's iteration for the displacement of one step, `guess` (padded) being improved in place.

    With `full` the exact tangent is factored anew in every iteration and the low-rank part stays out of it; else the
    symmetric factors of the room are used throughout, with the low-rank part.

    Returns
    -------
    int
        Iterations used, or -1 when the increments did not fall below `tolerance`.
    """
    n = step.constant.size
    previous = np.inf
    for iteration in range(_FULL_ITERATIONS if full else _SYMMETRIC_ITERATIONS):
        residual_of(step, guess, room)
        increment = room.residual[PAD : PAD + n]
        if full:
            tangent = step.band.copy()
            full_tangent(step.start, guess, step.axial, step.viscosity, room.work, tangent)
            if not solve_general(tangent, np.empty((n, BAND)), increment):
                return -1
        else:
            solve_kept(room, step.rows, step.low_rank)
        size = advance(guess, increment, dof_scale)
        if not np.isfinite(size):
            return -1
        if size < tolerance:
            return iteration + 1
        if iteration >= 4 and size > 0.7 * previous:
            # round-off of the axial force may keep the increments from falling further
            return iteration + 1 if size < _STALLED * tolerance else -1
        previous = size
    return -1


@njit(cache=True)
def extrapolate(history: FloatArray, known: int, first: FloatArray, guess: FloatArray) -> None:
    """Write a first guess of the step: a parabola through the last three steps, or less where fewer are known."""
    n = first.size
    inner = guess[PAD : PAD + n]
    if known >= 3:
        for i in range(n):
            inner[i] = 3.0 * (history[0, i] - history[1, i]) + history[2, i]
    elif known == 2:
        for i in range(n):
            inner[i] = 2.0 * history[0, i] - history[1, i]
    else:
        inner[:] = first


@njit(cache=True)
def prepare(level: int, step: Step, guess: FloatArray, room: Room, memory: IntArray, info: IntArray) -> bool:
    """Factor the symmetric tangent anew unless that of this step size is at hand; False when it is singular."""
    if memory[FACTORED_LEVEL] == level:
        return True
    lower_columns(step.band, room.columns)
    symmetric_tangent(
        step.start, guess, step.constant.size, step.axial, step.viscosity, room.work, room.columns
    )
    info[FACTORISATIONS] += 1
    if not factor_symmetric(room.columns, room.inverse_pivot):
        return False
    # what an older factor says of the low-rank part is good enough to iterate with
    if step.low_rank and memory[MODAL_LEVEL] != level:
        woodbury(room, step.rows, step.gain)
        memory[MODAL_LEVEL] = level
    memory[FACTORED_LEVEL] = level
    return True


@njit(cache=True)
def attempt(
    level: int,
    step: Step,
    first: FloatArray,
    guess: FloatArray,
    dof_scale: FloatArray,
    tolerance: float,
    history: FloatArray,
    room: Room,
    memory: IntArray,
    info: IntArray,
) -> int:
    """Solve one step with the symmetric tangent, and where that fails, or failed lately, with the full one.

    Returns
    -------
    int
        Iterations used, or -1 when both failed.
    """
    used = -1
    # a loop, and not two calls, so that the iteration is compiled once
    for full in (False, True):
        if used >= 0 or (not full and memory[FULL_FOR] > 0):
            continue
        extrapolate(history, memory[HISTORY], first, guess)
        if not full and not prepare(level, step, guess, room, memory, info):
            continue
        used = iterate(step, guess, dof_scale, tolerance, full, room)
        if full:
            memory[FULL_FOR] = _STEPS_WITH_FULL if memory[FULL_FOR] == 0 else memory[FULL_FOR] - 1
            memory[FACTORED_LEVEL] = -1
            info[FULL_ATTEMPTS] += 1
        elif used < 0 or used > _WORTH_FACTORING:
            memory[FACTORED_LEVEL] = -1
            if used < 0 or used > _WORTH_WOODBURY:
                memory[MODAL_LEVEL] = -1
    return used

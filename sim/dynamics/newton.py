"""Compiled solution of one time step: Newton's iteration with a symmetric tangent that is reused while it converges.

The low-rank modal terms ``U gain U^T`` are added to the band matrix by the Woodbury identity.

Padded vectors, shape (n + 14,), are those of `sim.beam.banded`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba.extending import register_jitable

from sim.beam import COLUMN, PAD, REORDER, add_product, factor_symmetric, solve_symmetric
from sim.dynamics.forces import (
    Air,
    Axial,
    Gradients,
    Stretch,
    axial_force,
    axial_tangent,
    drag_force,
    empty_gradients,
    empty_stretch,
    interpolate,
    predict,
)
from tracker import FloatArray, IntArray


@dataclass(frozen=True)
class Tuning:
    """When an iteration ends and when its tangent is factored again."""

    #: [1] iterations of a step before it is halved
    #: convention: A step of 0.5 ms takes 2 to 4 at the tip amplitudes of the paper and at 200 mm; the rest is reserve.
    iterations: int = 20
    #: [tolerances] increment below which one that no longer decreases counts as rounding, and the step as solved
    stalled: float = 50.0
    #: [1] iterations after which an increment may count as stalled
    #: convention: Chosen; a usual step has ended by then.
    stalled_after: int = 4
    #: [1] contraction per iteration above which an increment counts as no longer decreasing
    stalled_contraction: float = 0.7
    #: [1] contraction of the increment per iteration above which the next step factors the tangent anew
    #: convention: Chosen: one factorisation saves iterations of the later steps.
    worth_factoring: float = 0.015
    #: [1] contraction above which the tangent is factored anew within the step
    #: convention: Chosen, as the contraction of a tangent that has aged.
    renew_now: float = 0.25
    #: [1] contraction above which it does not predict the error of an iterate
    #: physics: The remaining error is c / (1 - c) of the increment, which the estimate c meets within a factor of 2.
    trusted: float = 0.5
    #: [1] lower limit of a contraction in the prediction of the error
    #: convention: The first ratio of increments may be that of a fast-converging part; chosen.
    smallest_contraction: float = 3e-3


TUNING = Tuning()
_ITERATIONS = TUNING.iterations
_STALLED = TUNING.stalled
_STALLED_AFTER = TUNING.stalled_after
_STALLED_CONTRACTION = TUNING.stalled_contraction
_WORTH_FACTORING = TUNING.worth_factoring
_RENEW_NOW = TUNING.renew_now
_TRUSTED = TUNING.trusted
_SMALLEST_CONTRACTION = TUNING.smallest_contraction

# indices into the array of counts
ITERATIONS, FACTORISATIONS, HALVINGS, STEP = range(4)
# indices into the array of values kept from step to step
FACTORED_LEVEL, HISTORY = range(2)


class Step(NamedTuple):
    """Equation of one step, ``constant + linear u + U gain U^T u + axial(u) + drag(u) = 0``.

    Attributes
    ----------
    columns, linear : array, shape (n + 7, 16), and (15, n) or (7, n)
        The linear part, as lower columns and by diagonals.
    rows, gain : array, shape (r, n) and (r,)
        U^T and the factors of its rows.
    low_rank : int
        First row, in order of frequency, that is included in the tangent: their share of it is (omega h)^2 / 12,
        negligible for short steps.
    start, windward : Gradients
        At the start of the step, at the Gauss points of `axial` and `air`.
    viscosity : tuple of float
        As in `axial_force`.
    h, base_m_s : float
        Length of the step in s, mean velocity of the base.
    """

    constant: FloatArray
    columns: FloatArray
    linear: FloatArray
    rows: FloatArray
    gain: FloatArray
    low_rank: int
    axial: Axial
    air: Air
    start: Gradients
    windward: Gradients
    viscosity: tuple[float, float]
    h: float
    base_m_s: float


class Workspace(NamedTuple):
    """Memory of the iteration: factors kept from step to step, and scratch.

    Attributes
    ----------
    columns, inverse_pivot : array, shape (n + 7, 16) and (n,)
    spread : array, shape (r, n)
        ``(A^-1 U)^T``.
    system : array, shape (r, 2 r)
        Its right half is ``(1 + gain U^T A^-1 U)^-1 gain``.
    residual : array, shape (n + 14,)
    work : Gradients
        At the axial Gauss points; `moved` and `turned` are at those of the air.
    """

    columns: FloatArray
    inverse_pivot: FloatArray
    spread: FloatArray
    system: FloatArray
    column: FloatArray
    residual: FloatArray
    coordinate: FloatArray
    factors: FloatArray
    work: Gradients
    moved: Gradients
    turned: Gradients
    stretch: Stretch


def empty_workspace(n: int, r: int, points: int, windy: int) -> Workspace:
    """Memory for a beam of n coordinates, r modal terms, and these numbers of Gauss points."""
    return Workspace(
        columns=np.zeros((n + PAD, COLUMN)),
        inverse_pivot=np.ones(n),
        spread=np.zeros((r, n)),
        system=np.zeros((r, 2 * r)),
        column=np.zeros(n + PAD),
        residual=np.zeros(n + 2 * PAD),
        coordinate=np.zeros(r),
        factors=np.zeros(r),
        work=empty_gradients(points),
        moved=empty_gradients(windy),
        turned=empty_gradients(windy),
        stretch=empty_stretch(points),
    )


@register_jitable(fastmath=REORDER)
def project(modal: FloatArray, x: FloatArray, first: int, out: FloatArray) -> None:
    """Write ``modal x`` to `out`, of the rows from `first` on; `modal` has one row a mode, `x` may be longer."""
    for r in range(first, modal.shape[0]):
        total = 0.0
        for i in range(modal.shape[1]):
            total += modal[r, i] * x[i]
        out[r] = total


@register_jitable(fastmath=REORDER)
def add_rows(modal: FloatArray, factors: FloatArray, first: int, out: FloatArray) -> None:
    """Add ``modal^T factors`` of the rows from `first` on to `out`."""
    r, last = first, modal.shape[0]
    # four rows at a time, to read and write `out` less often
    while r + 4 <= last:
        a, b, c, d = factors[r], factors[r + 1], factors[r + 2], factors[r + 3]
        for i in range(out.size):
            out[i] += a * modal[r, i] + b * modal[r + 1, i] + c * modal[r + 2, i] + d * modal[r + 3, i]
        r += 4
    while r < last:
        a = factors[r]
        for i in range(out.size):
            out[i] += a * modal[r, i]
        r += 1


@register_jitable
def woodbury(workspace: Workspace, rows: FloatArray, gain: FloatArray, first: int) -> None:
    """Prepare the solution with ``A + U gain U^T``, the rows of U^T from `first` on, from the factors of A."""
    n, r = workspace.inverse_pivot.size, rows.shape[0]
    system, column = workspace.system, workspace.column
    for a in range(first, r):
        for i in range(n):
            column[i] = rows[a, i]
        solve_symmetric(workspace.columns, workspace.inverse_pivot, column)
        for i in range(n):
            workspace.spread[a, i] = column[i]
        project(rows, column, first, system[a])
    # system[a, b] = U_b A^-1 U_a is symmetric; its right half becomes (1 + gain U^T A^-1 U)^-1 gain
    for a in range(first, r):
        for b in range(first, r):
            system[a, b] *= gain[a]
            system[a, r + b] = gain[a] if a == b else 0.0
        system[a, a] += 1.0
    # the gains are small relative to the tangent: the diagonal is near one, and pivoting is not needed
    for a in range(first, r):
        pivot = 1.0 / system[a, a]
        for c in range(first, 2 * r):
            system[a, c] *= pivot
        for b in range(first, r):
            if b != a:
                share = system[b, a]
                for c in range(first, 2 * r):
                    system[b, c] -= share * system[a, c]


@register_jitable(fastmath=REORDER, forceinline=True)
def solve_kept(workspace: Workspace, rows: FloatArray, first: int) -> None:
    """Solve for the residual in place with the stored factors and the low-rank part of the rows from `first` on."""
    n, r = workspace.inverse_pivot.size, rows.shape[0]
    x = workspace.residual[PAD:]
    solve_symmetric(workspace.columns, workspace.inverse_pivot, x)
    if first == r:
        return
    project(rows, x, first, workspace.coordinate)
    for a in range(first, r):
        total = 0.0
        for b in range(first, r):
            total -= workspace.system[a, r + b] * workspace.coordinate[b]
        workspace.factors[a] = total
    add_rows(workspace.spread, workspace.factors, first, x[:n])


@register_jitable(fastmath=REORDER, forceinline=True)
def residual_of(step: Step, guess: FloatArray, workspace: Workspace) -> None:
    """Write the negative residual of the step at `guess` to ``workspace.residual``.

    ``workspace.work`` holds the gradients of the guess and is overwritten.
    """
    n = step.constant.size
    out = workspace.residual
    inner = out[PAD : PAD + n]
    for i in range(n):
        inner[i] = step.constant[i]
    for i in range(PAD):
        out[i] = 0.0
        out[PAD + n + i] = 0.0
    add_product(step.linear, guess, inner)
    axial_force(step.start, n, step.axial, step.viscosity, workspace.stretch, workspace.work, out)
    if step.air.resistance.size > 0:
        drag_force(
            step.windward, guess, n, step.air, step.h, step.base_m_s, (workspace.moved, workspace.turned), out
        )
    project(step.rows, guess[PAD:], 0, workspace.coordinate)
    for a in range(step.gain.size):
        workspace.coordinate[a] *= step.gain[a]
    add_rows(step.rows, workspace.coordinate, 0, inner)
    for i in range(n):
        inner[i] = -inner[i]


@register_jitable(fastmath=REORDER, forceinline=True)
def advance(guess: FloatArray, increment: FloatArray, dof_scale: FloatArray) -> float:
    """Add the increment to the padded guess; returns its Euclidean norm in m, which is NaN if any part is."""
    square = 0.0
    for i in range(increment.size):
        guess[PAD + i] += increment[i]
        scaled = increment[i] * dof_scale[i]
        square += scaled * scaled
    return float(np.sqrt(square))


@register_jitable(forceinline=True)
def factor(level: int, step: Step, workspace: Workspace, memory: IntArray, info: IntArray) -> bool:
    """Factor the tangent at the iterate whose gradients are ``workspace.work``; False when it is singular."""
    for i in range(step.columns.shape[0]):
        for k in range(COLUMN):
            workspace.columns[i, k] = step.columns[i, k]
    axial_tangent(
        step.start,
        step.constant.size,
        step.axial,
        step.viscosity,
        workspace.stretch,
        workspace.work,
        workspace.columns,
    )
    info[FACTORISATIONS] += 1
    memory[FACTORED_LEVEL] = level
    if not factor_symmetric(workspace.columns, workspace.inverse_pivot):
        return False
    woodbury(workspace, step.rows, step.gain, step.low_rank)
    return True


@register_jitable(forceinline=True)
def extrapolate(history: FloatArray, known: int, first: FloatArray, guess: FloatArray) -> None:
    """Write the first guess of the step: a parabola through the last three steps, or a lower order with fewer."""
    for i in range(first.size):
        if known >= 3:
            guess[PAD + i] = 3.0 * (history[0, i] - history[1, i]) + history[2, i]
        elif known == 2:
            guess[PAD + i] = 2.0 * history[0, i] - history[1, i]
        else:
            guess[PAD + i] = first[i]


@register_jitable(forceinline=True)
def solve_step(
    level: int,
    step: Step,
    guess: FloatArray,
    dof_scale: FloatArray,
    tolerance: float,
    workspace: Workspace,
    memory: IntArray,
    info: IntArray,
) -> int:
    """Newton's iteration for the displacement of one step, `guess` (padded) being improved in place.

    The factors are reused, across steps too, as long as every iteration reduces the increment sufficiently.

    Returns
    -------
    int
        Number of iterations, or -1 when the error did not fall below `tolerance`.
    """
    n = step.constant.size
    increment = workspace.residual[PAD : PAD + n]
    previous, contraction = np.inf, 0.0
    renew = memory[FACTORED_LEVEL] != level
    for iteration in range(_ITERATIONS):
        interpolate(guess, n, step.axial.dshape, workspace.work)
        if iteration == 0:
            predict(step.start, workspace.stretch, workspace.work)
        if renew and not factor(level, step, workspace, memory, info):
            return -1
        residual_of(step, guess, workspace)
        solve_kept(workspace, step.rows, step.low_rank)
        size = advance(guess, increment, dof_scale)
        if not np.isfinite(size):
            return -1
        # the contraction is known from the second iteration on
        if iteration > 0:
            contraction = max(_SMALLEST_CONTRACTION, size / previous)
        renew = contraction > _RENEW_NOW
        if size < tolerance or (iteration > 0 and size * contraction < tolerance and contraction < _TRUSTED):
            if contraction > _WORTH_FACTORING:
                memory[FACTORED_LEVEL] = -1
            return iteration + 1
        if iteration >= _STALLED_AFTER and contraction > _STALLED_CONTRACTION and size < _STALLED * tolerance:
            # round-off of the axial force may prevent a further decrease
            return iteration + 1
        previous = size
    return -1

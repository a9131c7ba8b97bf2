"""Compiled time stepping of the ANCF beam: energy-momentum midpoint rule with low-rank modal corrections."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from sim.ancf_kernels import add_block, gradient_at
from sim.banded import BAND, PAD, band_product, factor_symmetric, solve_general, solve_symmetric

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
# derivatives of the shape functions at the Gauss points (g, 4), Gauss weights in m (g,), EA of each element (ne,)
Axial = tuple[FloatArray, FloatArray, FloatArray]
# symmetric factors with what the low-rank part adds: arrays lower (n, 15), pivot (n,), spread (r, n) and small (r, r)
Factors = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
# rows of U^T (r, n), and what multiplies U^T u in this step's residual (r,)
Modal = tuple[FloatArray, FloatArray]

DONE = 0
DIVERGED = 1

# places in the array of counts
ITERATIONS, FACTORISATIONS, FULL_ATTEMPTS, HALVINGS, STEP = range(5)
# places in the array of what is remembered from step to step
FACTORED_LEVEL, FULL_FOR, HISTORY, MODAL_LEVEL = range(4)

_SYMMETRIC_ITERATIONS = 12
_FULL_ITERATIONS = 20
_STEPS_WITH_FULL = 16
# multiple of the tolerance below which increments that fall no further are taken for round-off
_STALLED = 50.0
# iterations above which the symmetric tangent is factored anew for the next step
_WORTH_FACTORING = 3


@njit(cache=True)
def axial_force(
    start: FloatArray,
    step: FloatArray,
    axial: Axial,
    viscosity: tuple[float, float],
    force: FloatArray,
) -> None:
    """Add the axial force of one step to `force`.

    The axial force is EA times the mean of the strains at both ends of the step, on the tangent r' of the middle
    (Simo and Tarnow): its work over the step is the change of strain energy exactly. ``viscosity`` is (beta / h,
    tau / h): beta multiplies the rate of the whole axial force, so that beta K(q) v is exact over the step, tau only
    that of the strain (Kelvin-Voigt).
    """
    n = force.size
    dshape, weight, axial_stiffness = axial
    for e in range(axial_stiffness.size):
        offset = 4 * e - 4 + PAD
        for g in range(weight.size):
            x0, y0 = gradient_at(start, offset, dshape[g])
            dx, dy = gradient_at(step, offset, dshape[g])
            tx, ty = 1.0 + x0 + 0.5 * dx, y0 + 0.5 * dy
            growth = tx * dx + ty * dy
            ea = axial_stiffness[e] * weight[g]
            normal = ea * (x0 + 0.5 * (x0 * x0 + y0 * y0) + 0.5 * growth)
            total = normal + ea * (viscosity[0] + viscosity[1]) * growth
            px = total * tx + normal * viscosity[0] * dx
            py = total * ty + normal * viscosity[0] * dy
            for k in range(4):
                row = offset + 2 * k - PAD
                if 0 <= row < n:
                    force[row] += dshape[g, k] * px
                    force[row + 1] += dshape[g, k] * py


@njit(cache=True)
def axial_tangent(
    start: FloatArray,
    step: FloatArray,
    axial: Axial,
    viscosity: tuple[float, float],
    full: float,
    tangent: FloatArray,
) -> None:
    """Add the derivative of `axial_force` with respect to the step.

    With ``full = 1`` it is exact; with 0 a symmetric stand-in, which takes the tangent r' of the middle of the
    step for that of its end.
    """
    dshape, weight, axial_stiffness = axial
    for e in range(axial_stiffness.size):
        offset = 4 * e - 4 + PAD
        for g in range(weight.size):
            x0, y0 = gradient_at(start, offset, dshape[g])
            dx, dy = gradient_at(step, offset, dshape[g])
            tx, ty = 1.0 + x0 + 0.5 * dx, y0 + 0.5 * dy
            growth = tx * dx + ty * dy
            ea = axial_stiffness[e] * weight[g]
            normal = ea * (x0 + 0.5 * (x0 * x0 + y0 * y0) + 0.5 * growth)
            total = normal + ea * (viscosity[0] + viscosity[1]) * growth
            stretch = ea * (0.5 + viscosity[0] + viscosity[1])
            spread = 0.5 * total + normal * viscosity[0]
            ex, ey = tx + 0.5 * full * dx, ty + 0.5 * full * dy
            along = 0.5 * full * ea * viscosity[0]
            ax, ay = stretch * tx + along * dx, stretch * ty + along * dy
            add_block(tangent, offset, dshape[g], (ax * ex + spread, ax * ey, ay * ex, ay * ey + spread))


@njit(cache=True)
def project(modal: FloatArray, x: FloatArray, out: FloatArray) -> None:
    """Write ``modal x`` to `out`; `modal` has one row a mode."""
    for r in range(modal.shape[0]):
        total = 0.0
        for i in range(x.size):
            total += modal[r, i] * x[i]
        out[r] = total


@njit(cache=True)
def woodbury(factors: Factors, modal: Modal) -> None:
    """Prepare the solution with ``A + U gain U^T`` from the factors of A.

    Writes ``spread = (A^-1 U)^T``, shape (r, n), and ``small = (1 + gain U^T A^-1 U)^-1 gain``, shape (r, r);
    the solution is ``y - spread^T small U^T y`` with ``A y = b``.
    """
    lower, pivot, spread, small = factors
    rows, gain = modal
    r = rows.shape[0]
    system = np.zeros((r, 2 * r))
    for a in range(r):
        spread[a] = rows[a]
        solve_symmetric(lower, pivot, spread[a])
    for a in range(r):
        project(spread, rows[a], system[a, :r])
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
    small[:] = system[:, r:]


@njit(cache=True)
def correct(
    modal: FloatArray, spread: FloatArray, small: FloatArray, coordinate: FloatArray, x: FloatArray
) -> None:
    """Apply the preparation of `woodbury` to a solution `x` in place."""
    project(modal, x, coordinate)
    for a in range(small.shape[0]):
        total = 0.0
        for b in range(small.shape[0]):
            total += small[a, b] * coordinate[b]
        for i in range(x.size):
            x[i] -= total * spread[a, i]


@njit(cache=True)
def strain_energy(
    padded: FloatArray,
    axial: Axial,
) -> float:
    """Axial strain energy of a state."""
    dshape, weight, axial_stiffness = axial
    energy = 0.0
    for e in range(axial_stiffness.size):
        for g in range(weight.size):
            x, y = gradient_at(padded, 4 * e - 4 + PAD, dshape[g])
            strain = x + 0.5 * (x * x + y * y)
            energy += 0.5 * axial_stiffness[e] * weight[g] * strain * strain
    return energy


@njit(cache=True)
def total_energy(
    q: FloatArray,
    v: FloatArray,
    axial: Axial,
    mass: FloatArray,
    bending: FloatArray,
    load: FloatArray,
    modal: FloatArray,
    modal_mass: FloatArray,
) -> float:
    """Kinetic, strain and potential energy, which the step conserves; the kinetic one with the modal correction."""
    n = q.size
    padded = np.zeros(n + 2 * PAD)
    product = np.empty(n)
    padded[PAD : PAD + n] = v
    band_product(mass, padded, product)
    energy = 0.0
    for i in range(n):
        energy += 0.5 * v[i] * product[i]
    for r in range(modal.shape[0]):
        speed = 0.0
        for i in range(n):
            speed += modal[r, i] * v[i]
        energy += 0.5 * modal_mass[r] * speed * speed
    padded[PAD : PAD + n] = q
    band_product(bending, padded, product)
    for i in range(n):
        energy += (0.5 * product[i] - load[i]) * q[i]
    return energy + strain_energy(padded, axial)


@njit(cache=True)
def residual_of(
    start: FloatArray,
    guess: FloatArray,
    constant: FloatArray,
    linear: FloatArray,
    axial: Axial,
    viscosity: tuple[float, float],
    modal: Modal,
    coordinate: FloatArray,
    out: FloatArray,
) -> None:
    """Write ``-(constant + linear u + modal^T gain modal u + axial(u))`` to `out`."""
    n = constant.size
    rows, gain = modal
    band_product(linear, guess, out)
    axial_force(start, guess, axial, viscosity, out)
    project(rows, guess[PAD : PAD + n], coordinate)
    for r in range(rows.shape[0]):
        scaled = gain[r] * coordinate[r]
        for i in range(n):
            out[i] += scaled * rows[r, i]
    for i in range(n):
        out[i] = -out[i] - constant[i]


@njit(cache=True)
def iterate(
    start: FloatArray,
    guess: FloatArray,
    constant: FloatArray,
    linear: FloatArray,
    axial: Axial,
    viscosity: tuple[float, float],
    modal: Modal,
    dof_scale: FloatArray,
    tolerance: float,
    full: bool,  # noqa: FBT001 - numba takes no keyword-only arguments
    tangent: FloatArray,
    factors: Factors,
) -> int:
    """Newton's iteration for the displacement of one step, `guess` (padded) being improved in place.

    With `full` the exact tangent is factored anew in every iteration and the low-rank part stays out of it; else the
    symmetric factors given are used throughout, with the low-rank part.

    Returns
    -------
    int
        Iterations used, or -1 when the increments did not fall below `tolerance`.
    """
    n = constant.size
    lower, pivot, spread, small = factors
    increment = np.empty(n)
    coordinate = np.empty(spread.shape[0])
    work = np.empty((n, BAND))
    previous = np.inf
    for iteration in range(_FULL_ITERATIONS if full else _SYMMETRIC_ITERATIONS):
        residual_of(start, guess, constant, linear, axial, viscosity, modal, coordinate, increment)
        if full:
            tangent[:] = linear
            axial_tangent(start, guess, axial, viscosity, 1.0, tangent)
            if not solve_general(tangent, work, increment):
                return -1
        else:
            solve_symmetric(lower, pivot, increment)
            correct(modal[0], spread, small, coordinate, increment)
        size = 0.0
        for i in range(n):
            guess[PAD + i] += increment[i]
            size = max(size, abs(increment[i]) * dof_scale[i])
        # a maximum passes over NaN, a sum does not
        if not np.isfinite(np.sum(increment)):
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
def prepare(
    level: int,
    start: FloatArray,
    guess: FloatArray,
    linear: FloatArray,
    axial: Axial,
    viscosity: tuple[float, float],
    modal: Modal,
    tangent: FloatArray,
    factors: Factors,
    memory: IntArray,
    info: IntArray,
) -> bool:
    """Factor the symmetric tangent anew unless that of this step size is at hand; False when it is singular."""
    if memory[FACTORED_LEVEL] != level:
        tangent[:] = linear
        axial_tangent(start, guess, axial, viscosity, 0.0, tangent)
        info[FACTORISATIONS] += 1
        if not factor_symmetric(tangent, factors[0], factors[1]):
            return False
        # what an older factor says of the low-rank part is good enough to iterate with
        if memory[MODAL_LEVEL] != level:
            woodbury(factors, modal)
            memory[MODAL_LEVEL] = level
        memory[FACTORED_LEVEL] = level
    return True


@njit(cache=True)
def attempt(
    level: int,
    start: FloatArray,
    first: FloatArray,
    guess: FloatArray,
    constant: FloatArray,
    linear: FloatArray,
    axial: Axial,
    viscosity: tuple[float, float],
    modal: Modal,
    dof_scale: FloatArray,
    tolerance: float,
    history: FloatArray,
    tangent: FloatArray,
    factors: Factors,
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
        if not full and not prepare(
            level, start, guess, linear, axial, viscosity, modal, tangent, factors, memory, info
        ):
            continue
        used = iterate(
            start,
            guess,
            constant,
            linear,
            axial,
            viscosity,
            modal,
            dof_scale,
            tolerance,
            full,
            tangent,
            factors,
        )
        if full:
            memory[FULL_FOR] = _STEPS_WITH_FULL if memory[FULL_FOR] == 0 else memory[FULL_FOR] - 1
            memory[FACTORED_LEVEL] = -1
            info[FULL_ATTEMPTS] += 1
        elif used < 0 or used > _WORTH_FACTORING:
            memory[FACTORED_LEVEL] = -1
    return used


@njit(cache=True)
def constant_part(
    h: float,
    start: FloatArray,
    speed: FloatArray,
    mass: FloatArray,
    bending: FloatArray,
    load: FloatArray,
    rows: FloatArray,
    modal_mass: FloatArray,
    out: FloatArray,
) -> None:
    """Write what of the residual does not depend on the step's displacement; `start`, `speed` are padded q and v."""
    n = load.size
    product = np.empty(n)
    rate = np.empty(rows.shape[0])
    band_product(bending, start, out)
    band_product(mass, speed, product)
    project(rows, speed[PAD : PAD + n], rate)
    for i in range(n):
        out[i] -= load[i] + 2.0 / h * product[i]
    for r in range(rows.shape[0]):
        push = 2.0 * modal_mass[r] / h * rate[r]
        for i in range(n):
            out[i] -= push * rows[r, i]


@njit(cache=True)
def march(
    counts: tuple[int, int],
    step_s: float,
    q: FloatArray,
    v: FloatArray,
    axial: Axial,
    mass: FloatArray,
    bending: FloatArray,
    linear: FloatArray,
    load: FloatArray,
    base_force: FloatArray,
    base_acceleration: FloatArray,
    rows: FloatArray,
    modal_mass: FloatArray,
    modal_damping: FloatArray,
    viscosity_s: tuple[float, float],
    dof_scale: FloatArray,
    tolerance: float,
    out_q: FloatArray,
    out_energy: FloatArray,
    info: IntArray,
) -> int:
    """Advance `q`, `v` in place over ``counts = (steps, output_every)`` steps and store every output.

    A step that the symmetric tangent does not solve is tried with the full one, then in halves, down to
    ``step / 2^(levels - 1)``; the arrays `linear` (levels, n, 15), `modal_mass` and `modal_damping` (levels, r) hold
    the matrices of each level. `info` counts iterations, factorisations, attempts with the full tangent,
    halvings, and the step reached.

    Returns
    -------
    int
        `DONE` or `DIVERGED`; after the latter ``info[STEP]`` is the step that failed.
    """
    n, r, levels = q.size, rows.shape[0], linear.shape[0]
    parts = 1 << (levels - 1)
    start, guess, speed = np.zeros(n + 2 * PAD), np.zeros(n + 2 * PAD), np.zeros(n + 2 * PAD)
    constant, pushed, tangent = np.empty(n), np.empty(n), np.zeros((n, BAND))
    factors = (np.zeros((n, BAND)), np.ones(n), np.empty((r, n)), np.empty((r, r)))
    history = np.zeros((3, n))
    memory = np.array([-1, 0, 0, -1], dtype=np.int64)
    # an array's element is an integer to the compiler, a plain 0 would be a type of its own
    level = memory[FULL_FOR]
    out_q[0] = q
    out_energy[0] = total_energy(q, v, axial, mass, bending, load, rows, modal_mass[0])
    for index in range(counts[0]):
        info[STEP] = index
        pushed[:] = load - base_force * base_acceleration[index]
        position = 0
        while position < parts:
            h = step_s / (1 << level)
            start[PAD : PAD + n] = q
            speed[PAD : PAD + n] = v
            constant_part(h, start, speed, mass, bending, pushed, rows, modal_mass[level], constant)
            gain = 2.0 * modal_mass[level] / (h * h) + modal_damping[level] / h
            used = attempt(
                level, start, h * v, guess, constant, linear[level], axial, (viscosity_s[0] / h, viscosity_s[1] / h),
                (rows, gain), dof_scale, tolerance, history, tangent, factors, memory, info,
            )  # fmt: skip
            if used < 0:
                memory[FACTORED_LEVEL], memory[HISTORY] = -1, 0
                if level == levels - 1:
                    return DIVERGED
                level += 1
                info[HALVINGS] += 1
                continue
            info[ITERATIONS] += used
            history[2], history[1] = history[1], history[0]
            history[0] = guess[PAD : PAD + n]
            q += history[0]
            v[:] = 2.0 / h * history[0] - v
            memory[HISTORY] += 1
            position += parts >> level
            if level > 0 and position % (parts >> (level - 1)) == 0:
                level -= 1
                memory[FACTORED_LEVEL], memory[HISTORY] = -1, 0
        if (index + 1) % counts[1] == 0:
            row = (index + 1) // counts[1]
            out_q[row] = q
            out_energy[row] = total_energy(q, v, axial, mass, bending, load, rows, modal_mass[0])
    return DONE

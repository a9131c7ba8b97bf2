"""Damping and frequency that change with the amplitude: always fitted, tested, and told."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modal_id.fit.linear import FitData, LinearSolution, Problem, real_columns, solve_linear
from modal_id.fit.tangent import normal_equations, turns
from modal_id.fit.varpro import PoleFit, mode_functions, objective, thinning
from tracker.arrays import ComplexArray, FloatArray

_MAX_ITERATIONS = 25
_MAX_HALVINGS = 8
# Twice the log likelihood that a further step would gain: a thirtieth of a standard deviation.
_SETTLED = 1e-3
# What is tolerated where rounding lets no step succeed.
_STUCK_YET_SETTLED = 0.05
_MAX_CONDITION = 1e12


@dataclass(frozen=True)
class AmplitudeFit:
    """Fit of one mode with d ln a / dt = -(p0 + p2 a) and d phase / dt = p1 + p3 a^2.

    Attributes
    ----------
    parameters : array, shape (4,)
        p0, p2 in 1/s and p1, p3 in rad/s, in the order p0, p1, p2, p3; a is 1 at the start of the fit.
    covariance : array, shape (4, 4)
        For white noise.
    linear : LinearSolution
        Of all modes with this one bent, which comes first.
    slopes : array, shape (n, 8)
        Real and imaginary part of the derivatives of the bent decay.
    turn : array, shape (k, 8, 4)
        From `tangent.turns`: how they act on each channel.
    """

    parameters: FloatArray
    covariance: FloatArray
    linear: LinearSolution
    slopes: FloatArray
    turn: FloatArray


@dataclass(frozen=True)
class BentDecay:
    """``a(t) exp(i phase(t))`` of a mode whose damping is linear and whose frequency is quadratic in a.

    Attributes
    ----------
    wave : complex array, shape (n,)
    slopes : complex array, shape (n, 4)
        Its derivatives by p0, p1, p2, p3.
    """

    wave: ComplexArray
    slopes: ComplexArray


def bent_decay(time_s: FloatArray, parameters: FloatArray) -> BentDecay | None:
    """The decay of a mode bent by its amplitude, and its derivatives.

    Parameters
    ----------
    time_s : array, shape (n,)
        From 0.
    parameters : array, shape (4,)
        As in `AmplitudeFit`.

    Returns
    -------
    BentDecay or None
        None where the amplitude would grow without bound.

    Notes
    -----
    ``a = E / (1 + p2 (1 - E) / p0)``, ``E = exp(-p0 t)``, solves ``da/dt = -(p0 + p2 a) a`` with a(0) = 1.
    """
    p0, p1, p2, p3 = parameters
    if np.any(np.abs(p0 * time_s) > 300.0):
        return None
    decay = np.exp(-p0 * time_s)
    grown, grown_slope = time_s, -0.5 * time_s**2
    if abs(p0) * time_s[-1] > 1e-6:
        grown = -np.expm1(-p0 * time_s) / p0
        grown_slope = (time_s * decay - grown) / p0
    denominator = 1.0 + p2 * grown
    if np.any(denominator <= 1e-6):
        return None
    a = decay / denominator
    a0 = -a * (time_s + p2 * grown_slope / denominator)
    a2 = -a * grown / denominator
    area = _integral(time_s, a**2)
    turning = np.exp(1j * (p1 * time_s + p3 * area))
    wave = a * turning
    slopes = np.stack(
        [
            (a0 + 2j * p3 * a * _integral(time_s, a * a0)) * turning,
            1j * time_s * wave,
            (a2 + 2j * p3 * a * _integral(time_s, a * a2)) * turning,
            1j * area * wave,
        ],
        axis=1,
    )
    return BentDecay(wave, slopes)


def _integral(time_s: FloatArray, values: FloatArray) -> FloatArray:
    return np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(time_s))])


def fit_amplitude_dependence(problem: Problem, fit: PoleFit, mode: int) -> AmplitudeFit | None:
    """Least squares with one mode bent, the other poles held.

    Returns
    -------
    AmplitudeFit or None
        None when the four parameters cannot be told (too little amplitude lost, for example).
    """
    pole = fit.poles[mode]
    others = mode_functions(problem.data.time_s, np.delete(fit.poles, mode))
    start = np.array([-pole.real, pole.imag, 0.0, 0.0])
    near = _on_thinned(problem, fit, mode, start)
    return _gauss_newton(problem, others, start if near is None else near.parameters)


def _on_thinned(problem: Problem, fit: PoleFit, mode: int, start: FloatArray) -> AmplitudeFit | None:
    """The fit on averages of neighbouring samples, the other modes subtracted: a starting value that costs little."""
    data, linear = problem.data, fit.linear
    factor = thinning(data.time_s, fit.poles[mode : mode + 1])
    if factor < 2:
        return None
    own = np.real(
        mode_functions(data.time_s, fit.poles[mode : mode + 1]) @ linear.amplitudes[mode : mode + 1]
    )
    alone = Problem(FitData(data.time_s, linear.residual + own, data.weights), problem.baseline)
    thin = alone.thinned(factor)
    return _gauss_newton(thin, np.empty((thin.data.time_s.size, 0), dtype=complex), start)


def _gauss_newton(problem: Problem, others: ComplexArray, start: FloatArray) -> AmplitudeFit | None:
    found = _solve(problem, start, others)
    for _ in range(_MAX_ITERATIONS):
        if found is None:
            return None
        tangent = found.tangent()
        information, gradient = normal_equations(problem, found.linear, *tangent)
        scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
        scaled = information * np.outer(scale, scale)
        if not np.all(np.isfinite(information)) or np.linalg.cond(scaled) > _MAX_CONDITION:
            return None
        covariance = np.asarray(np.linalg.inv(scaled) * np.outer(scale, scale), dtype=float)
        step = covariance @ gradient
        left = float(gradient @ step)
        moved = None if left < _SETTLED else _move(problem, step, others, found)
        if moved is None:
            settled = left < _STUCK_YET_SETTLED
            return AmplitudeFit(found.parameters, covariance, found.linear, *tangent) if settled else None
        found = moved
    return None


@dataclass(frozen=True)
class _Solved:
    parameters: FloatArray
    linear: LinearSolution
    slopes: ComplexArray

    def tangent(self) -> tuple[FloatArray, FloatArray]:
        first = np.broadcast_to(self.linear.amplitudes[0], (4, self.linear.amplitudes.shape[1]))
        return real_columns(self.slopes), turns(first, np.arange(4), np.ones(4, dtype=complex))


def _solve(problem: Problem, parameters: FloatArray, others: ComplexArray) -> _Solved | None:
    bent = bent_decay(problem.data.time_s, parameters)
    if bent is None:
        return None
    linear = solve_linear(problem, np.concatenate([bent.wave[:, None], others], axis=1))
    return _Solved(parameters, linear, bent.slopes)


def _move(problem: Problem, step: FloatArray, others: ComplexArray, now: _Solved) -> _Solved | None:
    before = objective(problem.data, now.linear)
    for _ in range(_MAX_HALVINGS):
        trial = _solve(problem, now.parameters + step, others)
        if trial is not None and objective(problem.data, trial.linear) < before:
            return trial
        step = 0.4 * step
    return None

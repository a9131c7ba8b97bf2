"""Damping and frequency that change with the amplitude: always fitted, tested, and told."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modal_id.linear import LinearSolution, Problem, projected_gram, real_columns, solve_linear
from modal_id.varpro import PoleFit, mode_functions

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

_MAX_ITERATIONS = 25
_MAX_HALVINGS = 8


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
        Of all modes with this one bent.
    """

    parameters: FloatArray
    covariance: FloatArray
    linear: LinearSolution


def bent_decay(time_s: FloatArray, parameters: FloatArray) -> ComplexArray | None:
    """``a(t) exp(i phase(t))`` of a mode whose damping is linear and whose frequency is quadratic in a.

    Parameters
    ----------
    time_s : array, shape (n,)
        From 0.
    parameters : array, shape (4,)
        As in `AmplitudeFit`.

    Returns
    -------
    complex array, shape (n,), or None
        None where the amplitude would grow without bound.

    Notes
    -----
    ``a = E / (1 + p2 (1 - E) / p0)``, ``E = exp(-p0 t)``, solves ``da/dt = -(p0 + p2 a) a`` with a(0) = 1.
    """
    p0, p1, p2, p3 = parameters
    if np.any(np.abs(p0 * time_s) > 300.0):
        return None
    grown = time_s if abs(p0) < 1e-12 else -np.expm1(-p0 * time_s) / p0
    denominator = 1.0 + p2 * grown
    if np.any(denominator <= 1e-6):
        return None
    amplitude = np.exp(-p0 * time_s) / denominator
    square = amplitude**2
    area = np.concatenate([[0.0], np.cumsum(0.5 * (square[1:] + square[:-1]) * np.diff(time_s))])
    return np.asarray(amplitude * np.exp(1j * (p1 * time_s + p3 * area)))


def fit_amplitude_dependence(problem: Problem, fit: PoleFit, mode: int) -> AmplitudeFit | None:
    """Least squares with one mode bent, the other poles held.

    Returns
    -------
    AmplitudeFit or None
        None when the four parameters cannot be told (too little amplitude lost, for example).
    """
    data = problem.data
    pole = fit.poles[mode]
    others = mode_functions(data.time_s, np.delete(fit.poles, mode))
    parameters = np.array([-pole.real, pole.imag, 0.0, 0.0])
    scale = np.array([1.0, 1.0, 1.0, 1.0]) / max(data.span_s, 1e-300)
    found = _solve(problem, parameters, others)
    if found is None:
        return None
    for _ in range(_MAX_ITERATIONS):
        information, gradient = _normal_equations(problem, parameters, scale, found)
        if not np.all(np.isfinite(information)) or np.linalg.cond(information) > 1e14:
            return None
        covariance: FloatArray = np.asarray(np.linalg.inv(information), dtype=float)
        step = covariance @ gradient
        if float(gradient @ step) < 1e-6:
            return AmplitudeFit(parameters, covariance, found)
        moved = _move(problem, parameters, step, others, found)
        if moved is None:
            if float(gradient @ step) < 0.05:
                return AmplitudeFit(parameters, covariance, found)
            return None
        parameters, found = moved
    return None


def _solve(problem: Problem, parameters: FloatArray, others: ComplexArray) -> LinearSolution | None:
    bent = bent_decay(problem.data.time_s, parameters)
    if bent is None:
        return None
    return solve_linear(problem, np.concatenate([bent[:, None], others], axis=1))


def _misfit(solution: LinearSolution, counts: FloatArray) -> float:
    return float(0.5 * np.sum(counts * np.log(solution.rss + 1e-300)))


def _move(
    problem: Problem, parameters: FloatArray, step: FloatArray, others: ComplexArray, now: LinearSolution
) -> tuple[FloatArray, LinearSolution] | None:
    counts = problem.data.counts
    for _ in range(_MAX_HALVINGS):
        trial = _solve(problem, parameters + step, others)
        if trial is not None and _misfit(trial, counts) < _misfit(now, counts):
            return parameters + step, trial
        step = 0.4 * step
    return None


def _normal_equations(
    problem: Problem, parameters: FloatArray, scale: FloatArray, solution: LinearSolution
) -> tuple[FloatArray, FloatArray]:
    data = problem.data
    here = solution.columns[:, 0] + 1j * solution.columns[:, 1]
    slopes = np.empty((data.time_s.size, 4), dtype=complex)
    for index in range(4):
        trial = parameters.copy()
        trial[index] += 1e-6 * scale[index]
        there = bent_decay(data.time_s, trial)
        if there is None:
            return np.full((4, 4), np.nan), np.zeros(4)
        slopes[:, index] = (there - here) / (1e-6 * scale[index])
    columns = real_columns(slopes)
    information, gradient = np.zeros((4, 4)), np.zeros(4)
    for group, (channels, _) in enumerate(data.groups):
        gram, score = projected_gram(problem, solution, group, columns)
        for position, channel in enumerate(channels):
            c = solution.amplitudes[0, channel]
            turn = np.zeros((8, 4))
            turn[2 * np.arange(4), np.arange(4)] = c.real
            turn[2 * np.arange(4) + 1, np.arange(4)] = -c.imag
            inverse = 1.0 / solution.noise_variance[channel]
            information += inverse * (turn.T @ gram @ turn)
            gradient += inverse * (turn.T @ score[:, position])
    return information, gradient

"""Least squares of a piecewise model whose mean is continuous at an unknown instant.

The instant is the first nonlinear parameter. Linear coefficients are eliminated per channel, so that the search has a
dozen dimensions for any number of channels.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from modal_id.data import FitData
from tracker import FloatArray

FIRST_STEPS = 3


@dataclass(frozen=True)
class Tuning:
    """Convergence of the fit on both sides of a stop."""

    #: [1] number of minima that are refined
    minima: int = 3
    #: [1] relative ridge of the normal equations
    #: physics: Above rounding.
    ridge: float = 1e-12
    #: [1] largest number of steps of the fit
    max_steps: int = 40
    #: [1] largest number of halvings of a step
    halvings: int = 8
    #: [1] relative step of the numerical derivatives
    difference: float = 1e-4
    #: [samples] samples required on each side of the instant
    margin: int = 12
    #: [1] largest number of instants in the coarse search
    coarse_points: int = 300
    #: [1] number of instants per cycle in the coarse search
    points_per_cycle: float = 24.0


TUNING = Tuning()
_MAX_STEPS = TUNING.max_steps


@dataclass(frozen=True)
class PiecewiseProblem:
    """Data and piecewise model.

    Attributes
    ----------
    data : FitData
    variance : array, shape (k,)
        Noise variance of a sample with weight 1.
    model : callable
        Columns, shape (n, p), for nonlinear parameters, the instant first.
    scale : array, shape (q,)
        Changes of the nonlinear parameters over which the model is linear; one sample for the instant.
    stride : float
        Samples by which one step may move the instant: the model is not linear over a larger part of a cycle.
    """

    data: FitData
    variance: FloatArray
    model: Callable[[FloatArray], FloatArray]
    scale: FloatArray
    stride: float = 3.0


@dataclass(frozen=True)
class PiecewiseFit:
    """Best linear coefficients for given nonlinear parameters."""

    nonlinear: FloatArray
    columns: FloatArray
    coefficients: FloatArray
    residual: FloatArray
    chi_square: float


def solve(problem: PiecewiseProblem, nonlinear: FloatArray) -> PiecewiseFit | None:
    """Best linear coefficients; None where the columns are not finite."""
    columns = problem.model(nonlinear)
    if not np.all(np.isfinite(columns)):
        return None
    coefficients, residual = _project(problem.data, columns, problem.data.values[:, None, :])
    residual = residual[:, 0, :]
    chi_square = float(np.sum(problem.data.weights / problem.variance * residual**2))
    return PiecewiseFit(nonlinear, columns, coefficients[:, 0, :], residual, chi_square)


def _project(data: FitData, columns: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Weighted regression of `values`, shape (n, q, k), on the columns: coefficients (p, q, k) and residuals."""
    n, q, k = values.shape
    p = columns.shape[1]
    coefficients, residual = np.empty((p, q, k)), np.empty_like(values)
    for channels, weights in data.groups:
        weighted = columns * weights[:, None]
        gram = weighted.T @ columns
        size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
        gram = gram / np.outer(size, size) + TUNING.ridge * np.eye(p)
        flat = values[:, :, channels].reshape(n, -1)
        solved = np.linalg.solve(gram, (weighted.T @ flat) / size[:, None]) / size[:, None]
        coefficients[:, :, channels] = solved.reshape(p, q, channels.size)
        residual[:, :, channels] = (flat - columns @ solved).reshape(n, q, channels.size)
    return coefficients, residual


def _normal_equations(problem: PiecewiseProblem, at: PiecewiseFit) -> tuple[FloatArray, FloatArray]:
    """Information and gradient of the scaled nonlinear parameters, linear ones eliminated (Kaufman 1975)."""
    count = at.nonlinear.size
    slopes = np.empty((problem.data.time_s.size, count, problem.variance.size))
    for index in range(count):
        trial = at.nonlinear.copy()
        trial[index] += TUNING.difference * problem.scale[index]
        slopes[:, index] = (problem.model(trial) - at.columns) @ at.coefficients
    slopes = _project(problem.data, at.columns, slopes / TUNING.difference)[1]
    root = np.sqrt(problem.data.weights / problem.variance)
    flat = np.moveaxis(slopes * root[:, None, :], 1, 0).reshape(count, -1)
    return flat @ flat.T, flat @ (root * at.residual).ravel()


def _inverse(information: FloatArray) -> FloatArray:
    """Pseudo-inverse of an information matrix with parameters of different scale; 0 in undetermined directions."""
    size = np.sqrt(np.maximum(np.diag(information), 1e-300))
    outer = np.outer(size, size)
    return np.asarray(np.linalg.pinv(information / outer, rcond=1e-11, hermitian=True) / outer)


def descend(problem: PiecewiseProblem, start: PiecewiseFit, max_steps: int = _MAX_STEPS) -> PiecewiseFit:
    """Gauss-Newton on all nonlinear parameters."""
    best = start
    for _ in range(max_steps):
        information, gradient = _normal_equations(problem, best)
        step = _inverse(information) @ gradient
        if float(gradient @ step) < 1e-3:
            break
        moved = _line_search(problem, best, step)
        if moved is None:
            break
        best = moved
    return best


def _line_search(problem: PiecewiseProblem, best: PiecewiseFit, step: FloatArray) -> PiecewiseFit | None:
    step = step * min(1.0, problem.stride / max(abs(float(step[0])), 1e-300))
    for _ in range(TUNING.halvings):
        trial = best.nonlinear + step * problem.scale
        trial[0] = _bounds(problem, trial[0], trial[0])[0]
        moved = solve(problem, trial)
        if moved is not None and moved.chi_square < best.chi_square:
            return moved
        step = 0.4 * step
    return None


def instant_sd(problem: PiecewiseProblem, best: PiecewiseFit) -> float:
    """Standard deviation of the instant for white noise, all other parameters refitted."""
    information, _ = _normal_equations(problem, best)
    return float(np.sqrt(max(_inverse(information)[0, 0], 0.0))) * float(problem.scale[0])


def _bounds(problem: PiecewiseProblem, low: float, high: float) -> tuple[float, float]:
    """An interval of instants, restricted to those with samples on both sides."""
    time = problem.data.time_s
    margin = min(TUNING.margin, time.size // 4)
    first, last = float(time[margin]), float(time[-margin - 1])
    return min(max(low, first), last), max(min(high, last), first)


def _instants_within(problem: PiecewiseProblem, start: FloatArray, reach_s: float) -> FloatArray:
    """Instants to try within `reach_s` of the start, at most half a sample and a 24th of a cycle apart if possible."""
    low, high = _bounds(problem, start[0] - reach_s, start[0] + reach_s)
    finest = 2.0 * (high - low) / float(problem.scale[0])
    per_cycle = TUNING.points_per_cycle * (high - low) * float(start[1]) / (2.0 * np.pi)
    return np.linspace(low, high, int(min(max(9.0, min(finest, per_cycle)), TUNING.coarse_points)))


def scan(problem: PiecewiseProblem, start: FloatArray, reach_s: float, count: int) -> list[PiecewiseFit]:
    """The best local minima over instants within `reach_s` of the start, at most `count`; other parameters held."""
    instants = _instants_within(problem, start, reach_s)
    solutions = [solve(problem, np.concatenate([[instant], start[1:]])) for instant in instants]
    misfit = np.array([np.inf if s is None else s.chi_square for s in solutions])
    padded = np.concatenate([[np.inf], misfit, [np.inf]])
    minima = (misfit <= padded[:-2]) & (misfit <= padded[2:]) & np.isfinite(misfit)
    order = sorted(np.flatnonzero(minima), key=lambda index: misfit[index])
    return [s for index in order[:count] if (s := solutions[index]) is not None]


def search_instant(problem: PiecewiseProblem, start: FloatArray, reach_s: float) -> PiecewiseFit | None:
    """The best fit with the instant within `reach_s` of the start; None where nothing can be solved."""
    found = [descend(problem, one, FIRST_STEPS) for one in scan(problem, start, reach_s, TUNING.minima)]
    return min(found, key=lambda one: one.chi_square, default=None)

"""Least squares of a piecewise model whose mean is continuous at an unknown instant: a kink.

The first nonlinear parameter is the instant; the columns that belong to the nonlinear parameters are eliminated per
channel, so that what is searched has a dozen dimensions, however many channels there are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from modal_id.fit.linear import FitData
from tracker.arrays import FloatArray

_RIDGE = 1e-12
_MAX_STEPS = 40
_HALVINGS = 8
_DIFFERENCE = 1e-4
# Fewer samples than this on one side tell nothing about it.
_MARGIN = 12


@dataclass(frozen=True)
class Shape:
    """Model at given nonlinear parameters: channel k is ``columns @ coefficients[:, k] + gain[k] known``."""

    columns: FloatArray
    known: FloatArray


@dataclass(frozen=True)
class Kink:
    """A problem for `scan`, `descend` and `instant_sd`.

    Attributes
    ----------
    data : FitData
    variance : array, shape (k,)
        Noise variance of a sample of weight 1.
    shape : callable
        Columns, shape (n, p), and known part, shape (n,), for nonlinear parameters, the instant first.
    gain : array, shape (k,)
        Share of the known part in each channel.
    scale : array, shape (q,)
        Changes of the nonlinear parameters over which the model is linear; that of the instant a sample.
    stride : float
        Samples by which one step may move the instant: over a larger part of a cycle the model is not linear in it.
    """

    data: FitData
    variance: FloatArray
    shape: Callable[[FloatArray], Shape]
    gain: FloatArray
    scale: FloatArray
    stride: float = 3.0


@dataclass(frozen=True)
class Solution:
    """Linear parameters at their best for given nonlinear ones."""

    nonlinear: FloatArray
    shape: Shape
    coefficients: FloatArray
    residual: FloatArray
    chi_square: float


def solve(kink: Kink, nonlinear: FloatArray) -> Solution | None:
    """Best linear parameters; None where the columns are not finite."""
    shape = kink.shape(nonlinear)
    if not (np.all(np.isfinite(shape.columns)) and np.all(np.isfinite(shape.known))):
        return None
    values = kink.data.values - shape.known[:, None] * kink.gain
    coefficients, residual = _project(kink.data, shape.columns, values[:, None, :])
    left = residual[:, 0, :]
    chi_square = float(np.sum(kink.data.weights / kink.variance * left**2))
    return Solution(nonlinear, shape, coefficients[:, 0, :], left, chi_square)


def _project(data: FitData, columns: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Weighted regression of `values`, shape (n, q, k), on the columns: coefficients (p, q, k) and residuals."""
    n, q, k = values.shape
    p = columns.shape[1]
    coefficients, residual = np.empty((p, q, k)), np.empty_like(values)
    for channels, weights in data.groups:
        weighted = columns * weights[:, None]
        gram = weighted.T @ columns
        size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
        gram = gram / np.outer(size, size) + _RIDGE * np.eye(p)
        flat = values[:, :, channels].reshape(n, -1)
        solved = np.linalg.solve(gram, (weighted.T @ flat) / size[:, None]) / size[:, None]
        coefficients[:, :, channels] = solved.reshape(p, q, channels.size)
        residual[:, :, channels] = (flat - columns @ solved).reshape(n, q, channels.size)
    return coefficients, residual


def normal_equations(kink: Kink, at: Solution) -> tuple[FloatArray, FloatArray]:
    """Information and gradient of the scaled nonlinear parameters, linear ones eliminated (Kaufman 1975)."""
    count = at.nonlinear.size
    slopes = np.empty((kink.data.time_s.size, count, kink.gain.size))
    for index in range(count):
        trial = at.nonlinear.copy()
        trial[index] += _DIFFERENCE * kink.scale[index]
        there = kink.shape(trial)
        change = (there.columns - at.shape.columns) @ at.coefficients
        slopes[:, index] = change + (there.known - at.shape.known)[:, None] * kink.gain
    slopes = _project(kink.data, at.shape.columns, slopes / _DIFFERENCE)[1]
    root = np.sqrt(kink.data.weights / kink.variance)
    flat = np.moveaxis(slopes * root[:, None, :], 1, 0).reshape(count, -1)
    return flat @ flat.T, flat @ (root * at.residual).ravel()


def _inverse(information: FloatArray) -> FloatArray:
    """Pseudo-inverse of an information matrix whose parameters differ in scale; undetermined directions stay put."""
    size = np.sqrt(np.maximum(np.diag(information), 1e-300))
    outer = np.outer(size, size)
    return np.asarray(np.linalg.pinv(information / outer, rcond=1e-11, hermitian=True) / outer)


def bounds(kink: Kink, low: float, high: float) -> tuple[float, float]:
    """An interval of instants cut to those with samples on both sides."""
    time = kink.data.time_s
    margin = min(_MARGIN, time.size // 4)
    first, last = float(time[margin]), float(time[-margin - 1])
    return min(max(low, first), last), max(min(high, last), first)


def scan(kink: Kink, starts: list[FloatArray], count: int) -> list[Solution]:
    """The best local minima along a row of nonlinear parameters, `count` at most."""
    solutions = [solve(kink, start) for start in starts]
    misfit = np.array([np.inf if s is None else s.chi_square for s in solutions])
    padded = np.concatenate([[np.inf], misfit, [np.inf]])
    lowest = (misfit <= padded[:-2]) & (misfit <= padded[2:]) & np.isfinite(misfit)
    order = sorted(np.flatnonzero(lowest), key=lambda index: misfit[index])
    return [s for index in order[:count] if (s := solutions[index]) is not None]


def descend(kink: Kink, start: Solution, max_steps: int = _MAX_STEPS) -> Solution:
    """Gauss-Newton on all nonlinear parameters from `start`."""
    best = start
    for _ in range(max_steps):
        information, gradient = normal_equations(kink, best)
        step = _inverse(information) @ gradient
        if float(gradient @ step) < 1e-3:
            break
        moved = _line_search(kink, best, step)
        if moved is None:
            break
        best = moved
    return best


def _line_search(kink: Kink, best: Solution, step: FloatArray) -> Solution | None:
    step = step * min(1.0, kink.stride / max(abs(float(step[0])), 1e-300))
    for _ in range(_HALVINGS):
        trial = best.nonlinear + step * kink.scale
        trial[0] = bounds(kink, trial[0], trial[0])[0]
        moved = solve(kink, trial)
        if moved is not None and moved.chi_square < best.chi_square:
            return moved
        step = 0.4 * step
    return None


def instant_sd(kink: Kink, best: Solution) -> float:
    """Standard deviation of the instant, everything else re-fitted, for white noise."""
    information, _ = normal_equations(kink, best)
    return float(np.sqrt(max(_inverse(information)[0, 0], 0.0))) * float(kink.scale[0])

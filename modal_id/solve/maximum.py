"""Gauss-Newton to the maximum of a likelihood, for the fits that are not made of poles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from tracker import ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Steps and convergence."""

    #: [1] largest number of iterations
    max_iterations: int = 40
    #: [1] largest number of times that a step is shortened
    shortened: int = 10
    #: [1] factor by which a step is shortened
    shorter: float = 0.4
    #: [1] twice the gain in log likelihood of a further step, below which the fit has converged
    #: statistics: A step of a thirtieth of a standard deviation.
    converged: float = 1e-3
    #: [1] the same where rounding or a quadrature lets no step succeed
    #: statistics: A step of a fifth of a standard deviation.
    converged_to_rounding: float = 0.05
    #: [1] condition number above which the record does not determine the parameters
    #: physics: Rounding of 1e-16 leaves three digits.
    max_condition: float = 1e13


TUNING = Tuning()
MAX_ITERATIONS, MAX_CONDITION = TUNING.max_iterations, TUNING.max_condition

T = TypeVar("T")
Step = TypeVar("Step", FloatArray, ComplexArray)


def maximum(
    start: T | None,
    equations: Callable[[T], tuple[FloatArray, FloatArray]],
    moved: Callable[[T, FloatArray], T | None],
) -> tuple[T, FloatArray] | None:
    """The maximum and the covariance there; None where it is not reached or the parameters are not determined.

    Parameters
    ----------
    start : T or None
    equations : callable
        Information, shape (q, q), and gradient, shape (q,), of the log likelihood.
    moved : callable
        A better point in the direction of a step, as from `shortened`, or None.
    """
    now = start
    for _ in range(MAX_ITERATIONS):
        if now is None:
            return None
        information, gradient = equations(now)
        scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
        scaled = information * np.outer(scale, scale)
        if not np.all(np.isfinite(scaled)):
            return None
        values, vectors = np.linalg.eigh(scaled)
        if values[0] <= values[-1] / MAX_CONDITION:
            return None
        vectors *= scale[:, None]
        covariance = np.asarray((vectors / values) @ vectors.T)
        step = covariance @ gradient
        gain = float(gradient @ step)
        better = None if gain < TUNING.converged else moved(now, step)
        if better is None:
            return (now, covariance) if gain <= TUNING.converged_to_rounding else None
        now = better
    return None


def shortened(step: Step, trial: Callable[[Step], T | None]) -> T | None:
    """What `trial` returns for the longest of ever shorter steps that succeeds; None where none does."""
    for _ in range(TUNING.shortened):
        found = trial(step)
        if found is not None:
            return found
        step = TUNING.shorter * step
    return None

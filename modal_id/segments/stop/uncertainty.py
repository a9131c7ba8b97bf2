"""Uncertainty of the instant of a stop: standard deviation, competing cycles, autocorrelation of the noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modal_id.segments.stop.piecewise_fit import (
    FIRST_STEPS,
    PiecewiseFit,
    PiecewiseProblem,
    descend,
    instant_sd,
    scan,
    solve,
)
from tracker import BoolArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Competing instants."""

    #: [1] increase of chi-square up to which another instant competes
    #: statistics: A probability of 5e-4 for one instant.
    competing: float = 12.0
    #: [1] the same, before the instant is refined
    competing_before_descent: float = 300.0
    #: [1] largest number of competing instants that are followed
    #: convention: Limits the computing time.
    most_competing: int = 5


TUNING = Tuning()


def envelope_sd(problem: PiecewiseProblem, start: FloatArray) -> float:
    """Standard deviation of the instant where the envelope of the decay meets the steady amplitude, without phases."""
    at = solve(problem, start)
    if at is None:
        return 0.0
    rate = max(-float(start[2]), 1e-300)
    data = problem.data
    before = float(np.count_nonzero(data.time_s < start[0]))
    after = min(data.time_s.size - before, 0.5 / (rate * float(problem.scale[0])))
    power = float(np.sum((at.coefficients[2] ** 2 + at.coefficients[3] ** 2) / problem.variance))
    relative = 2.0 / max(power, 1e-300) * (1.0 / max(before, 1.0) + 4.0 / max(after, 1.0))
    return min(float(np.sqrt(relative)) / rate, 0.25 * data.span_s)


def posterior_sd(problem: PiecewiseProblem, best: PiecewiseFit, inflation: float, reach_s: float) -> float:
    """Standard deviation of the instant about the best one, including other cycles that fit nearly as well.

    `inflation` is the factor on the noise variance for misfit and autocorrelation.
    """
    limit = best.chi_square + TUNING.competing_before_descent * inflation
    near = scan(problem, best.nonlinear, reach_s, TUNING.most_competing)
    rivals = [descend(problem, one, FIRST_STEPS) for one in near if one.chi_square < limit]
    distances: list[float] = []
    mass, square = 0.0, 0.0
    for one in [best, *rivals]:
        offset_s = float(one.nonlinear[0] - best.nonlinear[0])
        excess = one.chi_square - best.chi_square
        if excess > TUNING.competing * inflation or any(
            abs(offset_s - d) < 0.2 * problem.scale[0] for d in distances
        ):
            continue
        distances.append(offset_s)
        # Where both curves touch (a force that ends) the instant has no first-order effect, and the linear value is far
        # too large: other instants of one cycle are competing minima, if they fit.
        radian_s = 1.0 / float(one.nonlinear[1])
        own = min(instant_sd(problem, one) * float(np.sqrt(inflation)), radian_s)
        weight = own * float(np.exp(-0.5 * excess / inflation))
        mass += weight
        square += weight * (own**2 + offset_s**2)
    longest = problem.data.span_s
    return min(float(np.sqrt(square / mass)), longest) if mass > 0.0 else longest


def mean_square(problem: PiecewiseProblem, solution: PiecewiseFit, rows: BoolArray) -> float:
    """Mean square residual of some rows relative to the noise variance, per degree of freedom."""
    weight = problem.data.weights[rows] / problem.variance
    dof = 0.5 * solution.coefficients.size
    count = max(np.count_nonzero(weight) - dof, 1.0)
    return float(np.sum(weight * solution.residual[rows] ** 2) / count)


def correlation_inflation(problem: PiecewiseProblem, solution: PiecewiseFit) -> float:
    """Sum of the residual's autocorrelation up to where it vanishes, at least 1: factor on the variance of a mean."""
    scaled = solution.residual * np.sqrt(problem.data.weights / problem.variance)
    power = float(np.sum(scaled**2))
    total = 1.0
    for lag in range(1, min(200, scaled.shape[0] // 4)):
        rho = float(np.sum(scaled[lag:] * scaled[:-lag])) / max(power, 1e-300)
        if rho < 2.0 / np.sqrt(scaled.size):
            break
        total += 2.0 * rho
    return total

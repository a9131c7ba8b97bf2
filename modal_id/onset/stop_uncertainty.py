"""Uncertainty of the instant of a stop: standard deviation, competing cycles, autocorrelation of the noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modal_id.onset.piecewise_fit import (
    FIRST_STEPS,
    LARGEST_GAIN,
    PiecewiseFit,
    PiecewiseProblem,
    at_instant,
    descend,
    instant_sd,
    instants_within,
    scan,
    solve,
)
from modal_id.onset.stop_models import moved_to
from tracker.arrays import BoolArray, FloatArray

RIVAL_CHI_SQUARE = 12.0
_RIVALS = 5


def envelope_sd(loose: PiecewiseProblem, start: FloatArray) -> float:
    """Standard deviation of the instant where the envelope of the decay meets the steady amplitude, without phases."""
    at = solve(loose, start)
    if at is None:
        return 0.0
    rate = max(-float(start[2]), 1e-300)
    data = loose.data
    before = float(np.count_nonzero(data.time_s < start[0]))
    after = min(data.time_s.size - before, 0.5 / (rate * float(loose.scale[0])))
    power = float(np.sum((at.coefficients[2] ** 2 + at.coefficients[3] ** 2) / loose.variance))
    relative = 2.0 / max(power, 1e-300) * (1.0 / max(before, 1.0) + 4.0 / max(after, 1.0))
    return min(float(np.sqrt(relative)) / rate, 0.25 * data.span_s)


@dataclass(frozen=True)
class Instant:
    """A locally best instant relative to the best one, its standard deviation and its unnormalised posterior mass."""

    after_s: float
    sd_s: float
    weight: float


def mixed(instants: list[Instant], longest_s: float) -> tuple[float, float]:
    """Distance of the most probable of several instants from the first, and the standard deviation about it."""
    weight = np.array([one.weight for one in instants])
    position = np.array([one.after_s for one in instants])
    own = np.array([one.sd_s for one in instants])
    if not np.sum(weight) > 0.0:
        return 0.0, longest_s
    weight = weight / np.sum(weight)
    # One of the candidates, not their mean: the instant does not lie between two cycles.
    best = int(np.argmax(weight))
    square = float(np.sum(weight * (own**2 + (position - position[best]) ** 2)))
    return float(position[best]), min(float(np.sqrt(square)), longest_s)


def spread(
    problem: PiecewiseProblem, best: PiecewiseFit, inflation: float, reach_s: float, *, sudden: bool
) -> Instant:
    """Standard deviation of the instant about the best one, including other cycles that fit nearly as well."""
    move = moved_to if sudden else at_instant
    starts = [move(best.nonlinear, t) for t in instants_within(problem, best.nonlinear, reach_s)]
    near = scan(problem, starts, _RIVALS)
    limit = best.chi_square + RIVAL_CHI_SQUARE * inflation
    limit_before_descent = best.chi_square + LARGEST_GAIN * inflation
    rivals = [descend(problem, one, FIRST_STEPS) for one in near if one.chi_square < limit_before_descent]
    instants: list[Instant] = []
    for one in [best, *rivals]:
        away = float(one.nonlinear[0] - best.nonlinear[0])
        if one.chi_square > limit or any(abs(away - i.after_s) < 0.2 * problem.scale[0] for i in instants):
            continue
        own = instant_sd(problem, one) * float(np.sqrt(inflation))
        weight = own * float(np.exp(-0.5 * (one.chi_square - best.chi_square) / inflation))
        instants.append(Instant(away, own, weight))
    return Instant(
        0.0, _about_best(instants, problem.data.span_s), float(np.sum([i.weight for i in instants]))
    )


def _about_best(instants: list[Instant], longest_s: float) -> float:
    weight = np.array([one.weight for one in instants])
    if not np.sum(weight) > 0.0:
        return longest_s
    square = np.array([one.sd_s**2 + one.after_s**2 for one in instants])
    return min(float(np.sqrt(np.sum(weight * square) / np.sum(weight))), longest_s)


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

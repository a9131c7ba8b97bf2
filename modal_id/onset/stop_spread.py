"""How well the instant of a stop is known: its standard deviation, rival cycles and memory of the noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modal_id.onset.piecewise import Kink, Solution, descend, instant_sd, scan, solve
from modal_id.onset.stop_search import FIRST_STEPS, HOPELESS, at_instant, instants_within, moved_to
from tracker.arrays import BoolArray, FloatArray

RIVAL_CHI_SQUARE = 12.0
_RIVALS = 5


def envelope_sd(loose: Kink, start: FloatArray) -> float:
    """Standard deviation of the instant at which the decay's envelope meets the steady amplitude, all phases aside."""
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
    """A local best instant after the best one, its standard deviation, and its posterior mass but for a factor."""

    after_s: float
    sd_s: float
    weight: float


def mixed(instants: list[Instant], longest_s: float) -> tuple[float, float]:
    """How far the most likely of several instants is behind the first, and the standard deviation about it."""
    weight = np.array([one.weight for one in instants])
    place = np.array([one.after_s for one in instants])
    own = np.array([one.sd_s for one in instants])
    if not np.sum(weight) > 0.0:
        return 0.0, longest_s
    weight = weight / np.sum(weight)
    # The instant stays at one of the candidates: between two of them it is certainly not.
    best = int(np.argmax(weight))
    square = float(np.sum(weight * (own**2 + (place - place[best]) ** 2)))
    return float(place[best]), min(float(np.sqrt(square)), longest_s)


def spread(kink: Kink, best: Solution, inflation: float, reach_s: float, *, sudden: bool) -> Instant:
    """Standard deviation of the instant about the best one, other cycles that fit nearly as well counted in."""
    move = moved_to if sudden else at_instant
    starts = [move(best.nonlinear, t) for t in instants_within(kink, best.nonlinear, reach_s)]
    near = scan(kink, starts, _RIVALS)
    limit = best.chi_square + RIVAL_CHI_SQUARE * inflation
    hopeless = best.chi_square + HOPELESS * inflation
    rivals = [descend(kink, one, FIRST_STEPS) for one in near if one.chi_square < hopeless]
    instants: list[Instant] = []
    for one in [best, *rivals]:
        away = float(one.nonlinear[0] - best.nonlinear[0])
        if one.chi_square > limit or any(abs(away - i.after_s) < 0.2 * kink.scale[0] for i in instants):
            continue
        own = instant_sd(kink, one) * float(np.sqrt(inflation))
        weight = own * float(np.exp(-0.5 * (one.chi_square - best.chi_square) / inflation))
        instants.append(Instant(away, own, weight))
    return Instant(0.0, _about_best(instants, kink.data.span_s), float(np.sum([i.weight for i in instants])))


def _about_best(instants: list[Instant], longest_s: float) -> float:
    weight = np.array([one.weight for one in instants])
    if not np.sum(weight) > 0.0:
        return longest_s
    square = np.array([one.sd_s**2 + one.after_s**2 for one in instants])
    return min(float(np.sqrt(np.sum(weight * square) / np.sum(weight))), longest_s)


def mean_square(kink: Kink, solution: Solution, rows: BoolArray) -> float:
    """Mean square of the residual of some rows over that of the noise, per degree of freedom."""
    weight = kink.data.weights[rows] / kink.variance
    freedom = 0.5 * solution.coefficients.size
    count = max(np.count_nonzero(weight) - freedom, 1.0)
    return float(np.sum(weight * solution.residual[rows] ** 2) / count)


def memory(kink: Kink, solution: Solution) -> float:
    """Sum of the residual's autocorrelation up to where it dies out, at least 1: what memory does to a mean."""
    scaled = solution.residual * np.sqrt(kink.data.weights / kink.variance)
    power = float(np.sum(scaled**2))
    total = 1.0
    for lag in range(1, min(200, scaled.shape[0] // 4)):
        rho = float(np.sum(scaled[lag:] * scaled[:-lag])) / max(power, 1e-300)
        if rho < 2.0 / np.sqrt(scaled.size):
            break
        total += 2.0 * rho
    return total

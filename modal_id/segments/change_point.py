"""Change from driven motion to a free decay, with the time of the change as a parameter.

The mean is continuous at the change, which is the first nonlinear parameter. Linear coefficients are eliminated per
channel, so that the search has a dozen dimensions for any number of channels.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from modal_id.data import MIN_SAMPLES, FitData
from modal_id.solve import LongArray, PoleFit, Problem, fit_poles, real_columns, shortened
from tracker import BoolArray, ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """The end of driving, and the convergence of the fit on both sides of it."""

    #: [1] number of minima that are refined
    minima: int = 3
    #: [1] relative ridge of the normal equations
    #: physics: Above rounding.
    ridge: float = 1e-12
    #: [1] largest number of steps of the fit
    max_steps: int = 40
    #: [1] relative step of the numerical derivatives
    difference: float = 1e-4
    #: [1] largest number of instants in the coarse search
    coarse_points: int = 300
    #: [1] number of instants per cycle in the coarse search
    points_per_cycle: float = 24.0
    #: [samples] number of samples to which a longer record is thinned for the fits, up to a factor of two
    #: convention: The time is found from all.
    search_samples: int = 3000
    #: [1] largest number of channels of the search
    #: convention: Limits the computing time.
    max_channels: int = 4
    #: [samples] fewest samples of a side
    least_samples: int = 8
    #: [sd] least difference of the rates before and after
    #: statistics: 0.3 % of steady drives exceed it.
    rate_sd: float = 3.0
    #: [cycles] least driven motion
    least_driven_cycles: float = 2.0


TUNING = Tuning()


# Steps of a fit from one of the best minima over the instant.
FIRST_STEPS = 3
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

    def trial(shorter: FloatArray) -> PiecewiseFit | None:
        at = best.nonlinear + shorter * problem.scale
        at[0] = _bounds(problem, at[0], at[0])[0]
        moved = solve(problem, at)
        return moved if moved is not None and moved.chi_square < best.chi_square else None

    return shortened(step, trial)


def instant_sd(problem: PiecewiseProblem, best: PiecewiseFit) -> float:
    """Standard deviation of the instant for white noise, all other parameters refitted."""
    information, _ = _normal_equations(problem, best)
    return float(np.sqrt(max(_inverse(information)[0, 0], 0.0))) * float(problem.scale[0])


def _bounds(problem: PiecewiseProblem, low: float, high: float) -> tuple[float, float]:
    """An interval of instants, restricted to those with samples on both sides."""
    time = problem.data.time_s
    margin = min(MIN_SAMPLES, time.size // 4)
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


# Samples at a time.
_BLOCK = 8192


@dataclass(frozen=True)
class ChangeSearch:
    """Time of a change with its standard deviation; it is looked for up to a distance, 0 where it is known."""

    time_s: float
    sd_s: float
    reach_s: float = 0.0


@dataclass(frozen=True)
class DrivenThenFree:
    """Time of the change relative to the data, its standard deviation, and the probability that there is one.

    ``drive_hz`` is the frequency of the driven motion.
    """

    time_s: float
    sd_s: float
    probability: float
    drive_hz: float


@dataclass(frozen=True)
class _Split:
    time_s: float
    misfit: float
    driven: PoleFit
    free: PoleFit


def driven_then_free(
    data: FitData, variance: FloatArray, frequency_hz: float, place: ChangeSearch
) -> DrivenThenFree | None:
    """The change from driven to free motion at a place; None where a side is too short.

    Before it every channel moves with the drive (a sinusoid) and the transient of its start, after it with the free
    decay; offsets differ, since the base may stop anywhere. A motion that decays before the change as it does after is
    not a driven one. `frequency_hz` is that of the dominant motion.
    """
    kept = _strongest_channels(data, variance)
    data = data.channels(kept)
    variance = variance[kept]
    thin = _thinned(data, frequency_hz)
    single_segment = _segment(thin, np.ones(thin.time_s.size, dtype=bool), frequency_hz)
    time, sd = place.time_s, place.sd_s
    best = split = _split(thin, time, frequency_hz, variance)
    for _ in range(2 if place.reach_s > 0.0 else 0):
        if split is None or best is None:
            break
        time, sd = _locate(data, variance, split, place.reach_s)
        split = _split(thin, time, frequency_hz, variance)
        best = best if split is None else replace(split, misfit=min(best.misfit, split.misfit))
    if best is None:
        return None
    one = float("inf") if single_segment is None else _chi_square(single_segment, variance)
    probability = _probability(one, best, int(np.count_nonzero(thin.weights)), thin.values.shape[1])
    drive_hz = abs(float(best.driven.poles[0].imag)) / (2.0 * np.pi)
    if time * drive_hz < TUNING.least_driven_cycles:
        probability = 0.0
    return DrivenThenFree(time, sd, probability, drive_hz)


def _strongest_channels(data: FitData, variance: FloatArray) -> NDArray[np.intp]:
    # Ranked by signal over noise; the first marker, closest to the base, hardly moves but determines the stop best.
    power = np.sum(data.weights * data.values**2, axis=0) / variance
    order = np.argsort(-power)[: TUNING.max_channels]
    first = np.array([0], dtype=np.intp)
    return np.unique(np.concatenate([order, first]))


def _thinned(data: FitData, frequency_hz: float) -> FitData:
    n = data.time_s.size
    step = data.step_s
    stride = max(1, min(n // TUNING.search_samples, int(1.0 / (8.0 * frequency_hz * step))))
    return data.rows(slice(None, None, stride))


def _segment(data: FitData, rows: BoolArray, frequency_hz: float) -> PoleFit | None:
    time = data.time_s[rows]
    if time.size < TUNING.least_samples:
        return None
    part = data.rows(rows).from_time(float(time[0]))
    if np.max(part.counts) < TUNING.least_samples:
        return None
    start = np.array([-0.3 / max(part.span_s, 1e-9) + 2j * np.pi * frequency_hz])
    return fit_poles(Problem(part, np.ones((time.size, 1))), start)


def _chi_square(fit: PoleFit, variance: FloatArray) -> float:
    return float(np.sum(fit.linear.rss / variance))


def _split(data: FitData, time_s: float, frequency_hz: float, variance: FloatArray) -> _Split | None:
    before = data.time_s < time_s
    driven, free = _segment(data, before, frequency_hz), _segment(data, ~before, frequency_hz)
    if driven is None or free is None:
        return None
    return _Split(time_s, _chi_square(driven, variance) + _chi_square(free, variance), driven, free)


def _probability(one: float, split: _Split, samples: int, channels: int) -> float:
    """Posterior probability of a change by the information criterion; 0 unless a faster decay follows it."""
    driven, free = float(split.driven.poles[0].real), float(split.free.poles[0].real)
    uncertainty = np.hypot(split.driven.pole_sd[0, 0], split.free.pole_sd[0, 0])
    if driven - free < TUNING.rate_sd * uncertainty or free >= 0.0:
        return 0.0
    # Additional parameters: a complex pole, the time, and a complex amplitude and an offset per channel.
    extra = 3.0 + 3.0 * channels
    gain = samples * np.log(one / split.misfit) - extra * np.log(samples)
    return float(1.0 / (1.0 + np.exp(-0.5 * np.clip(gain, -200.0, 200.0))))


def _locate(data: FitData, variance: FloatArray, split: _Split, window_s: float) -> tuple[float, float]:
    """Time of the change and its standard deviation, with poles held and every sample in the window a candidate."""
    time = data.time_s
    begin = np.searchsorted(time, split.time_s - window_s)
    end = np.searchsorted(time, split.time_s + window_s)
    step, margin = data.step_s, 6
    rows = np.arange(max(int(begin), margin), min(int(end), time.size - margin))
    if rows.size < 3:
        return split.time_s, step
    shifted = time - split.time_s
    poles = np.concatenate([split.driven.poles, split.free.poles])
    left = _Waves(shifted, poles if abs(poles[0] - poles[1]) * window_s > 0.05 else poles[:1])
    right = _Waves(shifted[::-1], poles[1:])
    total = np.zeros(rows.size)
    for channel in range(data.values.shape[1]):
        y, w = data.values[:, channel], data.weights[:, channel]
        before = _running_rss(left, y, w, rows[0] - 1, rows.size)
        after = _running_rss(right, y[::-1], w[::-1], time.size - 1 - rows[-1], rows.size)[::-1]
        total += (before + after) / variance[channel]
    samples = float(np.count_nonzero(data.weights))
    scaled = total / max(float(np.min(total)) / samples, 1.0)
    mass = np.exp(-0.5 * (scaled - np.min(scaled)))
    mass /= np.sum(mass)
    # The change may lie anywhere between the last driven and the first free sample.
    middle = 0.5 * (time[rows] + time[rows - 1])
    mean = float(np.sum(mass * middle))
    sd = float(np.sqrt(np.sum(mass * (middle - mean) ** 2) + step**2 / 12.0))
    return mean, sd


@dataclass(frozen=True)
class _Waves:
    """An offset and decaying waves, real and imaginary parts, made row by row; times from the change."""

    time_s: FloatArray
    poles: ComplexArray

    @property
    def shape(self) -> tuple[int, ...]:
        return self.time_s.size, 1 + 2 * self.poles.size

    def __getitem__(self, rows: slice) -> FloatArray:
        time_s = self.time_s[rows, None]
        # Bounded far from the change, where the waves carry no information about it.
        growth = np.clip(time_s * self.poles.real, -20.0, 20.0)
        waves = np.exp(growth + 1j * time_s * self.poles.imag)
        return np.concatenate([np.ones_like(time_s), real_columns(waves)], axis=1)


def _running_rss(
    columns: LongArray, values: FloatArray, weights: FloatArray, first: int, count: int
) -> FloatArray:
    """Residual sum of squares of the fits to the first i + 1 samples, for `count` values of i from `first` on."""
    p = columns.shape[1]
    total = np.zeros((p + 1, p + 1))
    for begin in range(0, first, _BLOCK):
        rows = slice(begin, min(begin + _BLOCK, first))
        joined = np.concatenate([columns[rows], values[rows, None]], axis=1)
        total += (weights[rows, None] * joined).T @ joined
    found, end = [], min(first + count, values.size)
    for begin in range(first, end, _BLOCK):
        rows = slice(begin, min(begin + _BLOCK, end))
        joined = np.concatenate([columns[rows], values[rows, None]], axis=1)
        products = weights[rows, None, None] * joined[:, :, None] * joined[:, None, :]
        products[0] += total
        np.cumsum(products, axis=0, out=products)
        total = products[-1].copy()
        gram, cross, square = products[:, :p, :p], products[:, :p, p], products[:, p, p]
        ridge = 1e-10 * np.trace(gram, axis1=1, axis2=2) / p + 1e-300
        solved = np.linalg.solve(gram + ridge[:, None, None] * np.eye(p), cross[..., None])[..., 0]
        found.append(np.maximum(square - np.sum(cross * solved, axis=1), 0.0))
    return np.concatenate(found)

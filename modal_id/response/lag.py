"""A measured input of another clock: its values at the times of the outputs, its lag with a posterior."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft
from scipy.optimize import minimize_scalar
from scipy.signal import kaiser_beta

from modal_id.data import BEYOND_SD, row_blocks
from modal_id.response.columns import FIXED, PER_MODE, Channel, Samples
from modal_id.response.known_input import TUNING as TRIED
from modal_id.response.known_input import (
    Weighted,
    criterion,
    fit_response,
    is_mode,
    most_iterated_s,
    with_free_lag,
)
from modal_id.response.solution import ResponseFit, solve_at, with_lag_variance
from modal_id.sentences import Reason, Refusal
from modal_id.solve import RIDGE
from tracker import ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Low-pass filter between two rates, search for the lag, its posterior."""

    #: [dB] attenuation of the filter
    #: physics: The pass band is then unchanged to 2e-4.
    attenuation: float = 80.0
    #: [1] end of its pass band over the outputs' Nyquist frequency, that of the fit
    #: physics: Above it the spline through the input loses more than 4 % of it. What the outputs' rate folds lies above
    #: where the stop band begins as far above the Nyquist frequency.
    highest: float = 0.6
    #: [1] rate of the input over that of the outputs below which it is refused
    #: physics: An input that was recorded slower does not hold the whole band; 1 % for clocks that differ.
    least_rate: float = 0.99
    #: [1] change of a constant by missing samples under the filter from which the value is missing
    #: statistics: Of an impact, that share of its momentum; the noise of forces is about as large.
    most_lost: float = 0.01
    #: [1] largest lag over the span of the record
    #: physics: Outputs at whose times the input is not known do not count.
    most_share: float = 0.1
    #: [rounds] searches of `first_modes` modes, each at the lag that the one before gave
    #: measurement: After one, what an error of a tenth of a sample left was taken for a mode of damping ratio 0.5.
    first_rounds: int = 2
    #: [rounds] most searches of all modes, each at the lag that the one before gave
    lag_rounds: int = 4
    #: [modes] most modes of the first search
    #: measurement: What a wrong lag leaves is taken for further modes: 8 of them take 30 s of CPU.
    first_modes: int = 2
    #: [1] loss of log likelihood at which a lag is improbable
    #: statistics: Probability 5e-5; a normal posterior ends at 4.5 sd.
    improbable: float = 10.0
    #: [1] factor between the lags that are tried for it
    #: convention: The end is passed by at most half.
    growth: float = 1.5
    #: [lags] between both ends
    #: statistics: At most a third of an sd apart for a normal posterior.
    lags: int = 41
    #: [1] steps of the grid over which lags are not improbable, at least
    #: statistics: Nine sd of a normal posterior: the mean is then exact to 1e-3 sd.
    least_probable: int = 12
    #: [s] length of the grid below which it is not narrowed
    #: physics: Rounding of the times of a record of a day.
    finest_s: float = 1e-10
    #: [lags] number of lags whose normal equations are solved together
    #: convention: Limits the memory.
    together: int = 500


TUNING = Tuning()
HIGHEST = TUNING.highest

# Parameter of Kaiser's window, and half length of the filter in steps of the outputs, by his formulas.
_BETA = float(kaiser_beta(TUNING.attenuation))
_HALF_LENGTH = 0.5 * (TUNING.attenuation - 7.95) / (2.285 * 2.0 * np.pi * (1.0 - HIGHEST))


def at_other_times(given_s: FloatArray, values: FloatArray, time_s: FloatArray) -> FloatArray | Refusal:
    """Values of an input, low-passed to the rate of the outputs; a reason where it was recorded slower.

    Parameters
    ----------
    given_s, values : array, shape (n,)
        The input, from which NaN are left out; steps may be uneven.
    time_s : array, shape (k,)
        Times of the outputs on the same clock.

    Returns
    -------
    array, shape (k,), or Refusal
        NaN where the input was not recorded. Frequencies up to 0.6 of the outputs' Nyquist frequency are unchanged to
        2e-4; an impact that is shorter than a step keeps its momentum.

    Notes
    -----
    The integral of the input and a sinc with Kaiser's window (IEEE Int. Symp. on Circuits and Systems 1974, pp. 20-23),
    by the trapezoidal rule over the input's samples. The response to what is left out lies above the band of the fit.
    """
    known = np.isfinite(values)
    given_s, values = given_s[known], values[known]
    steps_s = np.diff(given_s)
    weights = 0.5 * (np.append(steps_s, steps_s[-1]) + np.append(steps_s[0], steps_s))
    weights = np.minimum(weights, 2.0 * np.median(steps_s))
    step_s = float(np.median(np.diff(time_s)))
    rate, own_rate = 1.0 / float(np.median(steps_s)), 1.0 / step_s
    if rate < TUNING.least_rate * own_rate:
        return Reason.INPUT_SLOWER(rate_hz=rate, own_hz=own_rate)
    reach_s = _HALF_LENGTH * step_s
    first, last = np.searchsorted(given_s, time_s - reach_s), np.searchsorted(given_s, time_s + reach_s)
    found = np.full(time_s.size, np.nan)
    for k, at_s in enumerate(time_s):
        near = slice(int(first[k]), int(last[k]))
        x = (given_s[near] - at_s) / step_s
        window = np.i0(_BETA * np.sqrt(np.maximum(1.0 - (x / _HALF_LENGTH) ** 2, 0.0)))
        kernel = np.sinc(x) * window * weights[near]
        total = float(np.sum(kernel)) / (step_s * float(np.i0(_BETA)))
        if abs(total - 1.0) < TUNING.most_lost:
            found[k] = float(kernel @ values[near]) / float(np.sum(kernel))
    return found


def fit_with_lag(
    samples: Samples, max_modes: int, lowest_hz: float, input_sd: float
) -> ResponseFit | Refusal | None:
    """Modes and the lag of the input; why there is no lag; or None where no mode exceeds the noise.

    The residues of all modes are free complex numbers, which take up the phase of a lag at the resonances: modes are
    found without it. The lag is then the one with the largest likelihood at their poles; modes are searched again
    with it. In the last iteration it is one more parameter beside the poles: its standard deviation, and what it adds
    to theirs, are in the covariance.

    Notes
    -----
    The lag is seen where the response is not that of one resonance alone: in the motion of the base itself, and between
    resonances. That residues are real for proportional damping is not used.
    """
    channel = Channel.through(samples.time_s, samples.input)
    limit_s = TUNING.most_share * samples.span_s
    lag_s = 0.0
    for _ in range(TUNING.first_rounds):
        few = min(max_modes, TUNING.first_modes)
        first = fit_response(samples.late(channel, lag_s), few, lowest_hz, input_sd)
        if first is None:
            return None
        lag_s = most_likely_lag(first, channel, limit_s)
    for _ in range(TUNING.lag_rounds):
        found = _with_all_modes(samples, channel, lag_s, (max_modes, lowest_hz, input_sd))
        if found is None:
            return None
        moved_s, lag_s = found.samples.lag_s - lag_s, found.samples.lag_s
        other_s = most_likely_lag(found, channel, limit_s)
        if abs(other_s) >= limit_s - samples.step_s:
            return Reason.LAG_AT_LIMIT(limit_ms=1e3 * limit_s)
        if abs(other_s - lag_s) > samples.step_s:
            lag_s = other_s
        elif found.lag_sd_s > limit_s:
            return Reason.LAG_UNCERTAIN(sd_ms=1e3 * found.lag_sd_s)
        # What a wrong lag leaves is then below the noise, and taken for no mode.
        elif abs(moved_s) < BEYOND_SD * found.lag_sd_s:
            better_s = _lag_of_fewer_modes(found, channel, limit_s)
            if better_s is None:
                return _with_posterior(found, limit_s)
            lag_s = better_s
    return Reason.LAG_AMBIGUOUS()


def _with_all_modes(
    samples: Samples, channel: Channel, lag_s: float, options: tuple[int, float, float]
) -> ResponseFit | None:
    """Modes searched at one lag, then iterated with it."""
    late = samples.late(channel, lag_s, most_iterated_s(samples))
    fixed = fit_response(replace(late, channel=None), *options)
    return None if fixed is None else with_free_lag(replace(fixed, samples=late), options[2])


def _lag_of_fewer_modes(found: ResponseFit, channel: Channel, limit_s: float) -> float | None:
    """A lag at which fewer modes explain the outputs as well, by the criterion of the modes; None without any.

    Below its resonance a mode turns the phase as a lag does: at a wrong lag, modes are found that make up for it.
    """

    def score(samples: Samples, poles: ComplexArray) -> float:
        return Weighted(samples, poles, found.weights).score

    size, penalty = found.poles.size, criterion(found.samples)
    least = score(found.samples, found.poles)
    loss = [score(found.samples, np.delete(found.poles, index)) for index in range(size)] if size > 1 else []
    strongest = found.poles[np.argsort(loss)[::-1]]
    for count in range(1, size):
        poles = strongest[:count]
        near_s, reach_s = most_likely_lag(replace(found, poles=poles), channel, limit_s), found.samples.step_s
        best = minimize_scalar(
            lambda lag_s, poles=poles: score(found.samples.with_lag(float(lag_s)), poles),
            bounds=(near_s - reach_s, near_s + reach_s),
            method="bounded",
            options={"xatol": 1e-3 * reach_s},
        )
        if best.fun < least + (size - count) * penalty:
            return float(best.x)
    return None


def _with_posterior(found: ResponseFit, limit_s: float) -> ResponseFit | Refusal:
    """The fit at the mean lag of the posterior, with its standard deviation; why there is none.

    The likelihood may be flat between two maxima, of which the iteration finds one with the curvature there. The poles
    follow the lag as in the covariance.
    """
    before_s, sd_s = found.samples.lag_s, found.lag_sd_s
    follow = found.covariance[:-1, -1] / sd_s**2

    def moved(lag_s: float) -> tuple[Samples, ComplexArray]:
        move = follow * (lag_s - before_s)
        return found.samples.with_lag(lag_s), found.poles + move[0::2] + 1j * move[1::2]

    def score(lag_s: float) -> float:
        samples, poles = moved(lag_s)
        return Weighted(samples, poles, found.weights).score if is_mode(poles).all() else np.inf

    least, ends = score(before_s), []
    for turn in (-1.0, 1.0):
        reach_s, own = 2.0 * sd_s, least
        while own < least + TUNING.improbable and abs(before_s + turn * reach_s) < limit_s:
            reach_s *= TUNING.growth
            own = score(before_s + turn * reach_s)
            least = min(least, own)
        ends.append(before_s + turn * reach_s)
    if np.max(np.abs(ends)) >= limit_s:
        return Reason.LAG_WIDE(low_ms=1e3 * ends[0], high_ms=1e3 * ends[1])
    lags, odds = _probable(score, ends[0], ends[1])
    lag_s = float(np.sum(odds * lags) / np.sum(odds))
    variance = float(np.sum(odds * (lags - lag_s) ** 2) / np.sum(odds))
    samples, poles = moved(lag_s)
    return with_lag_variance(solve_at(samples, samples, poles, found.noise, found.weights), variance)


def _probable(score: Callable[[float], float], low_s: float, high_s: float) -> tuple[FloatArray, FloatArray]:
    """Lags between both limits and their odds, on a grid that is narrowed until it resolves them."""
    while True:
        lags = np.linspace(low_s, high_s, TUNING.lags)
        scores = np.array([score(lag_s) for lag_s in lags])
        near = np.flatnonzero(scores < np.min(scores) + TUNING.improbable)
        if near[-1] - near[0] >= TUNING.least_probable or high_s - low_s < TUNING.finest_s:
            return lags, np.exp(np.min(scores) - scores)
        low_s, high_s = lags[max(near[0] - 1, 0)], lags[min(near[-1] + 1, lags.size - 1)]


def most_likely_lag(found: ResponseFit, channel: Channel, limit_s: float) -> float:
    """The lag of the largest likelihood at the narrow poles of a fit, within the limit on both sides, in s.

    Outputs count alike at all frequencies: weights of a fit at a wrong lag are small where that lag shows, and those of
    the power of the outputs are large where only what leaks from the ends of the record is left.
    """
    narrow = -found.poles.real < TRIED.most_damping * np.abs(found.poles)
    poles = found.poles[narrow] if narrow.any() else found.poles
    samples = replace(found.samples, channel=channel)
    half_step_s = 0.5 * samples.step_s
    count = int(limit_s / half_step_s)
    shifts = np.arange(-count, count + 1) - round(samples.lag_s / half_step_s)
    near_s = samples.lag_s + half_step_s * float(shifts[int(np.argmin(_scores(samples, poles, shifts)))])
    weights = np.ones((samples.frequency_hz.size, samples.values.shape[1]))

    def score(lag_s: float) -> float:
        return Weighted(samples.with_lag(float(lag_s)), poles, weights).score

    # The grid takes the record as periodic: where much motion is left at its end, the minimum lies beside.
    least, turn = (
        score(near_s),
        1.0 if score(near_s + samples.step_s) < score(near_s - samples.step_s) else -1.0,
    )
    while abs(near_s) < limit_s and (beside := score(near_s + turn * samples.step_s)) < least:
        near_s, least = near_s + turn * samples.step_s, beside
    reach = near_s - samples.step_s, near_s + samples.step_s
    best = minimize_scalar(score, bounds=reach, method="bounded", options={"xatol": 1e-3 * samples.step_s})
    return float(np.clip(best.x, -limit_s, limit_s))


def better_lag(found: ResponseFit) -> float | None:
    """Lag in s that explains the outputs better than none at the poles of a fit without one, beyond doubt; or None.

    Both with the outputs counted alike at all frequencies and with the weights of the fit: each alone is misled, by a
    strong line that is no mode, or by what a wrong lag left.
    """
    channel = Channel.through(found.samples.time_s, found.samples.input)
    late_s = most_likely_lag(found, channel, TUNING.most_share * found.samples.span_s)
    none = replace(found.samples, channel=channel)
    late = none.with_lag(late_s)
    gains = (
        Weighted(none, found.poles, weights).score - Weighted(late, found.poles, weights).score
        for weights in (np.ones_like(found.weights), found.weights)
    )
    return late_s if all(gain > TUNING.improbable for gain in gains) else None


def _scores(samples: Samples, poles: ComplexArray, shifts: NDArray[np.intp]) -> FloatArray:
    """Negative log likelihood of lags, by whole numbers of half samples more than that of the fit, shape (lags,).

    A lag turns the transform of what the input drives by a phase, as if the record were periodic: the normal equations
    of all lags are Fourier transforms of the products of the columns at one lag.
    """
    n, size = samples.time_s.size, samples.frequency_hz.size
    columns = samples.bins(samples.in_time(poles))
    is_driven = np.zeros(columns.shape[1], dtype=bool)
    is_driven[:2] = True
    is_driven[FIXED:] = np.arange(columns.shape[1] - FIXED) % PER_MODE < 2
    both = (columns[:, is_driven], columns[:, ~is_driven], samples.bins(samples.values))
    driven, free, outputs = (one / np.linalg.norm(one, axis=0) for one in both)
    products = np.zeros((n + 1, driven.shape[1], free.shape[1] + outputs.shape[1]), dtype=complex)
    products[: samples.last] = driven[:, :, None] * np.conj(np.hstack([free, outputs]))[:, None, :]
    # Real parts of the sums over the bins: the inverse transform counts all but the first and the last twice.
    products[[0, n]] *= 2.0
    turned = n * irfft(products, 2 * n, axis=0)
    of_driven, of_free = np.real(np.conj(driven.T) @ driven), np.real(np.conj(free.T) @ free)
    of_outputs = np.real(np.conj(free.T) @ outputs)
    total = np.zeros(shifts.size)
    for chosen in row_blocks(shifts.size, TUNING.together):
        left = _left(of_driven, of_free, of_outputs, turned[shifts[chosen] % (2 * n)])
        total[chosen] = size * np.sum(np.log(left), axis=1)
    return total


def _left(
    of_driven: FloatArray, of_free: FloatArray, of_outputs: FloatArray, turned: FloatArray
) -> FloatArray:
    """Share of each output that no combination of the columns explains, at each lag; shape (lags, outputs)."""
    p, q = len(of_driven), len(of_free)
    normal = np.empty((len(turned), p + q, p + q))
    normal[:, :p, :p], normal[:, p:, p:] = of_driven, of_free
    normal[:, :p, p:] = turned[:, :, :q]
    normal[:, p:, :p] = np.swapaxes(turned[:, :, :q], 1, 2)
    normal += RIDGE * np.eye(p + q)
    free = np.broadcast_to(of_outputs, (len(turned), *of_outputs.shape))
    right = np.concatenate([turned[:, :, q:], free], axis=1)
    solved = np.linalg.solve(normal, right)
    return np.asarray(np.maximum(1.0 - np.sum(solved * right, axis=1), RIDGE))

"""Modes that a measured input drives: their number, poles and participation, the noise, and the lag of the input."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from modal_id.response.candidates import candidates, drives
from modal_id.response.columns import FIXED, OF_MODE, Channel, Samples
from modal_id.response.noise import TUNING as NOISE
from modal_id.response.noise import InputNoise, Noise, noise_after
from modal_id.response.solution import ResponseFit, pole_slopes, scaled, significant, solve_at
from tracker import BoolArray, ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Search for modes, iteration of their poles, search for the lag."""

    #: [1] largest number of steps of the poles in a search
    search_steps: int = 12
    #: [1] largest number of halvings of such a step
    halvings: int = 8
    #: [1] gain of log likelihood by a step that ends a search
    #: statistics: About one sd; the rounds with the noise spectra follow.
    negligible: float = 0.5
    #: [1] places at which a mode beside others is tried before the search ends
    places: int = 3
    #: [1] gain of a local fit, over what the criterion asks for, below which a mode is not tried
    #: physics: A local fit takes part of a wide response for background.
    promising: float = 0.25
    #: [1] damping ratio above which a fitted motion is no mode
    #: physics: The response of a mode damped more has no resonance to tell its poles from a polynomial.
    most_damping: float = 0.5
    #: [1] factor by which the damping ratio of a new mode may grow in the iteration
    #: physics: Twice that between the damping ratios that are tried; beyond, the pole follows other modes.
    most_growth: float = 6.0
    #: [1] shift of its frequency, in half-widths
    most_shift: float = 3.0
    #: [1] largest response to the noise of the input, over the noise of the outputs (variances), that is neglected
    #: statistics: The bias of a pole is then a thirtieth of its standard deviation at most.
    negligible_noise: float = 1e-3
    #: [1] the same as `rounds`, while modes are still being added
    search_rounds: int = 2
    #: [1] rounds of noise spectrum, noise in the input and steps of the poles
    #: measurement: benchmarks/known_input.py; the fourth round changes zeta by less than a tenth of its sd.
    rounds: int = 4
    #: [1] largest lag over the span of the record
    #: physics: Outputs at whose times the input is not known do not count.
    most_share: float = 0.1
    #: [rounds] searches of `first_modes` modes, each at the lag that the one before gave
    #: measurement: After one, what an error of a tenth of a sample left was taken for a mode of damping ratio 0.5.
    first_rounds: int = 2
    #: [rounds] most searches of all modes, each at the lag that the one before gave
    lag_rounds: int = 4
    #: [sd] change of the lag that needs no further search
    #: statistics: What a wrong lag leaves is then below the noise, and taken for no mode.
    settled: float = 3.0
    #: [modes] most modes of the first search
    #: measurement: What a wrong lag leaves is taken for further modes: 8 of them take 30 s of CPU.
    first_modes: int = 2
    #: [1] damping ratio from which a pole found at a wrong lag is left out of the search for the lag
    #: measurement: What a wrong lag leaves of a motion of the base over the whole band is taken for modes of 0.02 to
    #: 0.5, which then follow any lag (seeds 0 and 1 of the broad records of benchmarks/known_input.py).
    narrow_damping: float = 0.05
    #: [lags] number of lags whose normal equations are solved together
    #: convention: Limits the memory.
    together: int = 500
    #: [1] added to the diagonal of normal equations of unit columns
    #: physics: Well above rounding, and below the noise of any record.
    ridge: float = 1e-11


TUNING = Tuning()


def fit_response(samples: Samples, max_modes: int, lowest_hz: float, input_sd: float) -> ResponseFit | None:
    """Modes of the response to the samples' input; None where no mode exceeds the noise.

    Modes are added one by one at peaks of the residual spectrum, with the noise of outputs and input iterated in
    between, while the likelihood improves by more than the Bayesian information criterion asks for and the input
    exceeds its noise there. A mode that is not significant after others were added is removed. `input_sd` is the
    standard deviation of the noise of the input, NaN where unknown: it is then taken from the data (`InputNoise`).

    Notes
    -----
    Errors in variables. With noise in input and outputs the residual ``e = y - G u`` has the covariance ``S =
    diag(n_y^2) + n_u^2 G G^H``, and the regressors correlate with it: least squares on the measured input is biased
    in damping. The regressors are therefore made from ``u - E[noise of u | e] = u + n_u^2 G^H S^-1 e``, whose error
    is independent of e, as an instrument (the maximum-likelihood score of Pintelon & Schoukens, *System
    Identification*, 2nd ed., 2012, section 9.12, doi:10.1002/9781118287422). Weights are ``1 / S_kk``; the
    covariance of the result contains the correlation of the outputs that the common input causes.
    """
    known = InputNoise.of(samples, input_sd)
    penalty = criterion(samples)
    level = np.maximum(np.mean(samples.outputs**2, axis=0), 1e-300)
    noise = Noise(np.tile(level, (samples.frequency_hz.size, 1)), 0.0)
    found = _refined(samples, np.empty(0, dtype=complex), known, noise, TUNING.search_rounds)
    better: ResponseFit | None = found
    while better is not None:
        found = better
        if found.poles.size >= max_modes:
            break
        before = Weighted(found.likely, found.poles, found.weights)
        places = candidates(found, lowest_hz, TUNING.promising * penalty)
        places.sort(key=before.gain, reverse=True)
        if found.poles.size:
            places = places[: TUNING.places]
        tried = (_with_mode(found, before, pole, known, penalty) for pole in places)
        better = next((one for one in tried if one is not None), None)
    if not found.poles.size:
        return None
    order = np.argsort(np.abs(found.poles))
    return _without_weak(found, found.poles[order], known, penalty, TUNING.rounds)


def with_free_lag(found: ResponseFit, input_sd: float) -> ResponseFit | None:
    """A fit iterated with the lag of the input (`Samples.channel`) as one more parameter; None as in `fit_response`."""
    known = InputNoise.of(found.samples, input_sd)
    return _without_weak(found, found.poles, known, criterion(found.samples), TUNING.rounds)


def criterion(samples: Samples) -> float:
    """Gain of log likelihood from which a mode is accepted: the Bayesian information criterion."""
    return float(0.5 * (2 + OF_MODE * samples.values.shape[1]) * np.log(2 * samples.frequency_hz.size))


def _with_mode(
    found: ResponseFit, before: Weighted, pole: complex, known: InputNoise, penalty: float
) -> ResponseFit | None:
    """The fit with one more mode, or with others that explain more; None where the criterion asks for more."""
    trial = Weighted(found.likely, np.append(found.poles, pole), found.weights).converged()
    if before.score - trial.score < penalty or _has_left(pole, trial.poles[-1]):
        return None
    better = _without_weak(found, trial.poles, known, penalty, TUNING.search_rounds)
    if better is None or better.poles.size != found.poles.size:
        return None if better is None or better.poles.size < found.poles.size else better
    # As many modes as before, elsewhere.
    after = Weighted(found.likely, better.poles, found.weights)
    return better if before.score - after.score > penalty else None


def _without_weak(
    found: ResponseFit, poles: ComplexArray, known: InputNoise, penalty: float, rounds: int
) -> ResponseFit | None:
    """The fit from these poles without those that are not significant or not driven; None where none is left."""
    while poles.size:
        better = _refined(found.samples, poles, known, found.noise, rounds)
        kept = significant(better, penalty) & drives(better)
        if kept.all():
            return better
        poles = better.poles[kept]
    return None


class Weighted:
    """Least squares with given weights, shape (b, k), up to the noise level of each output."""

    def __init__(self, samples: Samples, poles: ComplexArray, weights: FloatArray) -> None:
        self.samples, self.poles, self._weights = samples, poles, weights
        root = np.sqrt(np.concatenate([weights, weights]))
        self._root = root / np.sqrt(np.mean(root**2, axis=0))
        columns, self._scale = scaled(samples.columns(poles))
        self._factors = [np.linalg.qr(columns * own[:, None]) for own in self._root.T]
        values = samples.outputs * self._root
        self._explained = [q.T @ values[:, out] for out, (q, _) in enumerate(self._factors)]
        self.residual = np.column_stack(
            [values[:, out] - q @ self._explained[out] for out, (q, _) in enumerate(self._factors)]
        )
        floor = NOISE.least_noise * np.sum(values**2, axis=0) + 1e-300
        self.rss = np.maximum(np.sum(self.residual**2, axis=0), floor)
        #: Negative log likelihood.
        self.score = float(0.5 * values.shape[0] * np.sum(np.log(self.rss)))

    def gain(self, pole: complex) -> float:
        """Log likelihood gained by a mode with this pole."""
        columns = scaled(self.samples.rows(self.samples.of_mode(pole)))[0]
        left = self.rss.copy()
        for out, (basis, _) in enumerate(self._factors):
            own = columns * self._root[:, [out]]
            own = np.linalg.qr(own - basis @ (basis.T @ own))[0]
            left[out] -= np.sum((own.T @ self.residual[:, out]) ** 2)
        return float(0.5 * len(columns) * np.sum(np.log(self.rss / np.maximum(left, 1e-12 * self.rss))))

    def stepped(self) -> Weighted | None:
        """After one step of the poles that lowers the score; None where there is none."""
        solved = [
            np.linalg.lstsq(r, own, rcond=1e-12)[0]
            for (_, r), own in zip(self._factors, self._explained, strict=True)
        ]
        slopes = pole_slopes(self.samples.slopes(self.poles), np.column_stack(solved) / self._scale[:, None])
        m = 2 * self.poles.size
        information, gradient = np.zeros((m, m)), np.zeros(m)
        for out, (basis, _) in enumerate(self._factors):
            own = slopes[:, :, out] * self._root[:, [out]]
            own -= basis @ (basis.T @ own)
            information += own.T @ own / self.rss[out]
            gradient += own.T @ self.residual[:, out] / self.rss[out]
        change = _limited(np.linalg.pinv(information) @ gradient, self.poles, self.samples)
        for _ in range(TUNING.halvings):
            if _is_mode(self.poles + change).all():
                trial = Weighted(self.samples, self.poles + change, self._weights)
                if trial.score < self.score:
                    return trial
            change = 0.4 * change
        return None

    def converged(self) -> Weighted:
        """After as many steps as help."""
        found = self
        for _ in range(TUNING.search_steps):
            trial = found.stepped()
            if trial is None:
                break
            done = found.score - trial.score < TUNING.negligible
            found = trial
            if done:
                break
        return found


def _refined(
    samples: Samples,
    poles: ComplexArray,
    known: InputNoise,
    noise: Noise,
    rounds: int,
) -> ResponseFit:
    """Poles with the noise spectra of outputs and input, all iterated together from a first noise."""
    found = solve_at(samples, samples, poles, noise, 1.0 / noise.output)
    for _ in range(rounds):
        samples = _with_missing_filled(found)
        response = found.transfer(samples.frequency_hz)
        noise = noise_after(samples, found.residual_bins, found.leverage, response, known)
        likely = _with_likely_input(samples, found, noise, response)
        found = solve_at(samples, likely, found.poles, noise, noise.weights(response))
        step = _limited(found.step[: 2 * found.poles.size], found.poles, samples)
        if _is_mode(found.poles + step).all():
            if samples.channel is not None:
                samples = samples.with_lag(samples.lag_s + _lag_step(found))
                likely = _with_likely_input(samples, found, noise, response)
            found = solve_at(samples, likely, found.poles + step, noise, noise.weights(response))
    return found


def _with_missing_filled(found: ResponseFit) -> Samples:
    """The samples with the fitted motion where outputs are missing: they then add no information."""
    samples = found.samples
    if samples.given.all() or not found.poles.size:
        return samples
    fitted = samples.in_time(found.poles) @ found.coefficients
    return replace(samples, values=np.where(samples.given, samples.values, fitted))


def _with_likely_input(samples: Samples, found: ResponseFit, noise: Noise, response: ComplexArray) -> Samples:
    """The samples with the most likely input, given outputs and measured input."""
    if np.all(noise.input * np.abs(response) ** 2 <= TUNING.negligible_noise * noise.output):
        return samples
    error = -np.sum(np.conj(response) / noise.output * found.residual_bins, axis=1) / (
        1.0 / noise.input + np.sum(np.abs(response) ** 2 / noise.output, axis=1)
    )
    return samples.with_input(samples.drive.at_samples() - samples.to_time(error))


def _has_left(start: complex, pole: complex) -> bool:
    """Whether the iteration took a mode away from the resonance at which it began."""
    wide = max(-start.real, -pole.real)
    return (
        -pole.real > TUNING.most_growth * -start.real
        or abs(pole.imag - start.imag) > TUNING.most_shift * wide
    )


def _limited(step: FloatArray, poles: ComplexArray, samples: Samples) -> ComplexArray:
    """A step of the poles within the reach of the linearisation: a phase of a radian over the record."""
    change = step[0::2] + 1j * step[1::2]
    limit = 1.0 / samples.span_s + 0.3 * np.abs(poles.real)
    return np.asarray(
        change * np.min(np.minimum(1.0, limit / np.maximum(np.abs(change), 1e-300)), initial=1.0)
    )


def _lag_step(found: ResponseFit) -> float:
    """Within the reach of the linearisation: half a sample."""
    limit = 0.5 * found.samples.step_s
    return float(np.clip(found.step[-1], -limit, limit))


def _is_mode(poles: ComplexArray) -> BoolArray:
    """Whether each motion decays, and oscillates."""
    return np.asarray(
        (poles.real < 0.0) & (poles.imag > 0.0) & (-poles.real < TUNING.most_damping * np.abs(poles))
    )


def fit_with_lag(
    samples: Samples, max_modes: int, lowest_hz: float, input_sd: float
) -> ResponseFit | str | None:
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
    channel = Channel.through(samples.time_s, samples.input, samples.given)
    limit_s = TUNING.most_share * samples.span_s
    lag_s = 0.0
    for _ in range(TUNING.first_rounds):
        few = min(max_modes, TUNING.first_modes)
        first = fit_response(_at(samples, channel, lag_s), few, lowest_hz, input_sd)
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
            return f"lies at the limit of the search, {1e3 * limit_s:.3g} ms"
        if abs(other_s - lag_s) > samples.step_s:
            lag_s = other_s
        elif found.lag_sd_s > limit_s:
            return f"is not determined: its standard deviation is {1e3 * found.lag_sd_s:.3g} ms"
        elif abs(moved_s) < TUNING.settled * found.lag_sd_s:
            return found
    return "is not unique: several explain the outputs alike"


def _with_all_modes(
    samples: Samples, channel: Channel, lag_s: float, options: tuple[int, float, float]
) -> ResponseFit | None:
    """Modes searched at one lag, then iterated with it."""
    fixed = fit_response(_at(samples, channel, lag_s), *options)
    late = replace(samples, channel=channel).with_lag(lag_s)
    return None if fixed is None else with_free_lag(replace(fixed, samples=late), options[2])


def _at(samples: Samples, channel: Channel, lag_s: float) -> Samples:
    """The samples with an input of a lag that is not to be iterated."""
    return replace(replace(samples, channel=channel).with_lag(lag_s), channel=None) if lag_s else samples


def most_likely_lag(found: ResponseFit, channel: Channel, limit_s: float) -> float:
    """The lag of the largest likelihood at the narrow poles of a fit, within the limit on both sides, in s.

    Outputs count alike at all frequencies: weights of a fit at a wrong lag are small where that lag shows.
    """
    narrow = -found.poles.real < TUNING.narrow_damping * np.abs(found.poles)
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


def _scores(samples: Samples, poles: ComplexArray, shifts: NDArray[np.intp]) -> FloatArray:
    """Negative log likelihood of lags, by whole numbers of half samples more than that of the fit, shape (lags,).

    A lag turns the transform of what the input drives by a phase, as if the record were periodic: the normal equations
    of all lags are Fourier transforms of the products of the columns at one lag.
    """
    n = samples.time_s.size
    size = samples.frequency_hz.size
    columns = samples.bins(samples.in_time(poles))
    is_driven = np.zeros(columns.shape[1], dtype=bool)
    is_driven[:2] = True
    is_driven[FIXED:] = np.arange(columns.shape[1] - FIXED) % OF_MODE < 2
    driven, free = columns[:, is_driven], columns[:, ~is_driven]
    total = np.zeros(shifts.size)
    for out in range(samples.values.shape[1]):
        y = samples.bins(samples.values[:, [out]])
        d, f, y = (one / np.linalg.norm(one, axis=0) for one in (driven, free, y))
        products = np.zeros((2 * n, d.shape[1], f.shape[1] + 1), dtype=complex)
        products[samples.first : samples.last] = np.conj(d)[:, :, None] * np.column_stack([f, y])[:, None, :]
        turned = np.real(np.fft.fft(products, axis=0))
        of_driven, of_free = np.real(np.conj(d.T) @ d), np.real(np.conj(f.T) @ f)
        of_output = np.real(np.conj(f.T) @ y)[:, 0]
        for start in range(0, shifts.size, TUNING.together):
            own = turned[shifts[start : start + TUNING.together] % (2 * n)]
            total[start : start + len(own)] += size * np.log(_left(of_driven, of_free, of_output, own))
    return total


def _left(
    of_driven: FloatArray, of_free: FloatArray, of_output: FloatArray, turned: FloatArray
) -> FloatArray:
    """Share of an output that no combination of the columns explains, at each lag."""
    p = len(of_driven)
    normal = np.empty((len(turned), p + len(of_free), p + len(of_free)))
    normal[:, :p, :p], normal[:, p:, p:] = of_driven, of_free
    normal[:, :p, p:] = turned[:, :, :-1]
    normal[:, p:, :p] = np.swapaxes(turned[:, :, :-1], 1, 2)
    normal += TUNING.ridge * np.eye(normal.shape[1])
    right = np.column_stack([turned[:, :, -1], np.broadcast_to(of_output, (len(turned), len(of_free)))])
    solved = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
    return np.asarray(np.maximum(1.0 - np.sum(solved * right, axis=1), TUNING.ridge))

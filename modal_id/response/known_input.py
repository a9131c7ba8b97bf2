"""Modes that a measured input drives: their number, poles and participation, and the noise."""

from __future__ import annotations

from dataclasses import dataclass, replace
from operator import itemgetter

import numpy as np
from scipy.ndimage import uniform_filter1d

from modal_id.fit import MAX_DAMPING, PLACES
from modal_id.response.columns import PER_MODE, Samples
from modal_id.response.noise import TUNING as NOISE
from modal_id.response.noise import InputNoise, Noise, noise_after
from modal_id.response.solution import ResponseFit, pole_slopes, scaled, significant, solve_at
from modal_id.solve import MAX_ITERATIONS, shortened
from tracker import BoolArray, ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Peaks, poles that are tried about them, search for modes, iteration of their poles."""

    #: [1] peaks of the residual spectrum about which a pole is sought
    peaks: int = 8
    #: [1] smallest damping ratio that is tried
    #: convention: That of a tuning fork.
    least_damping: float = 0.001
    #: [1] largest one, from which a pole is left out of the search for the lag
    #: measurement: What a wrong lag leaves of a motion of the base over the whole band is taken for modes of 0.02 to
    #: 0.5, which then follow any lag (seeds 0 and 1 of the broad records of benchmarks/known_input.py).
    most_damping: float = 0.05
    #: [1] number of damping ratios that are tried
    #: physics: The iteration covers the factor of three between neighbours.
    ratios: int = 5
    #: [1] damping ratio up to which a mode is slightly damped
    #: physics: The window of a stronger one holds other modes of a beam.
    slight: float = 0.01
    #: [1] frequencies that are tried about a peak for each damping ratio
    frequencies: int = 7
    #: [1] their reach on both sides, in half-widths of the mode, a bin at least
    #: physics: Noise moves the highest bin within the width of a resonance.
    reach: float = 1.5
    #: [1] half-widths of a mode on both sides of a window
    #: physics: 0.8 of the power of a resonance lies within three.
    half_widths: float = 5.0
    #: [1] relative distance of two peaks
    apart: float = 0.05
    #: [bins] half width of the average of the input's spectrum
    near: int = 4
    #: [1] power of the input over that of its noise below which it drives no mode that can be told
    #: statistics: The mean of nine bins of noise exceeds three times its expectation once in 30 000.
    least_power: float = 3.0
    #: [1] gain of log likelihood by a step that ends a search
    #: statistics: About one sd; the rounds with the noise spectra follow.
    negligible: float = 0.5
    #: [1] gain of a test or a local fit, over what the criterion asks for, below which a mode is not tried
    #: measurement: A local fit takes part of a wide response for background; the gain after a fit is up to five times
    #: that which the score test predicts.
    promising: float = 0.25
    #: [1] factor by which the damping ratio of a new mode may grow in the iteration
    #: physics: Twice that between the damping ratios that are tried; beyond, the pole follows other modes.
    most_growth: float = 6.0
    #: [1] shift of its frequency, in half-widths
    most_shift: float = 3.0
    #: [1] largest response to the noise of the input, over the noise of the outputs (variances), that is neglected
    #: statistics: The bias of a pole is then a thirtieth of its standard deviation at most.
    negligible_noise: float = 1e-3
    #: [1] rounds of noise spectrum, noise in the input and steps of the poles
    #: measurement: benchmarks/known_input.py; the fourth round changes zeta by less than a tenth of its sd.
    rounds: int = 4
    #: [1] the same while modes are still being added
    search_rounds: int = 2


TUNING = Tuning()


def candidates(found: ResponseFit, lowest_hz: float, least_gain: float) -> list[complex]:
    """Poles that explain peaks of the residual, each with a gain of log likelihood above `least_gain`.

    One slightly and one strongly damped pole about each peak. Peaks below `lowest_hz`, or where the input does not
    exceed its noise, do not count.

    Notes
    -----
    Local rational method (McKelvey & Guerin 2012, doi:10.3182/20120711-3-BE-2027.00425): about a peak, the residual is
    ``(a / (s - lambda) + a0 + a1 x) U + b / (s - lambda) + b0 + b1 x`` with U the transform of the likely input. At a
    given lambda all but it are linear.
    """
    samples, size = found.samples, found.weights.shape[0]
    residual = found.residual_bins
    power = uniform_filter1d(np.sum(np.abs(residual) ** 2 * found.weights, axis=1), 3)
    frequency_hz, taken = samples.frequency_hz, np.zeros(size, dtype=bool)
    taken[frequency_hz < max(lowest_hz, 2.0 / samples.span_s)] = True
    taken |= ~is_driven(found)
    weighted = residual * np.sqrt(found.weights)
    tried: list[tuple[float, complex]] = []
    ratios = np.geomspace(TUNING.least_damping, TUNING.most_damping, TUNING.ratios)
    for _ in range(TUNING.peaks):
        if taken.all():
            break
        at = int(np.argmax(np.where(taken, -1.0, power)))
        hz = frequency_hz[at]
        taken |= np.abs(frequency_hz - hz) < max(TUNING.apart * hz, 3.0 / samples.span_s)
        tried.extend(
            max((_tried(found, weighted, at, ratio) for ratio in own), key=itemgetter(0))
            for own in (ratios[ratios <= TUNING.slight], ratios[ratios > TUNING.slight])
        )
    return [pole for gain, pole in tried if gain > least_gain]


def is_driven(found: ResponseFit) -> BoolArray:
    """Bins near which the input exceeds its noise: a response to noise alone has no instrument; shape (b,)."""
    power = uniform_filter1d(np.abs(found.samples.content_bins) ** 2, 2 * TUNING.near + 1)
    return np.asarray(power > TUNING.least_power * 2.0 * found.noise.input)


def drives(found: ResponseFit) -> BoolArray:
    """Whether the input exceeds its noise somewhere about the resonance of each mode; shape (m,).

    Not at its frequency: the lines of a periodic input may lie on both sides of it.
    """
    driven, frequency_hz = is_driven(found), found.samples.frequency_hz
    hz = np.abs(found.poles) / (2.0 * np.pi)
    # Half the distance that peaks of the residual keep, for a slightly damped mode between two lines.
    near = np.abs(frequency_hz[:, None] - hz) < 0.5 * TUNING.apart * hz
    return np.asarray(np.any(driven[:, None] & near, axis=0))


def _tried(found: ResponseFit, weighted: ComplexArray, at: int, ratio: float) -> tuple[float, complex]:
    """Gain of log likelihood and the best pole of a damping ratio about the bin `at`."""
    samples = found.samples
    frequency_hz = samples.frequency_hz
    step_hz = float(frequency_hz[1] - frequency_hz[0])
    half_hz = ratio * float(frequency_hz[at])
    reach = max(NOISE.half_window, int(np.ceil(TUNING.half_widths * half_hz / step_hz)))
    window = slice(max(0, at - reach), at + reach + 1)
    size = len(weighted[window])
    s, driving = 2j * np.pi * frequency_hz[window], found.likely.input_bins[window]
    root = np.sqrt(np.mean(found.weights[window], axis=1))
    x = np.linspace(-1.0, 1.0, size)
    basis = np.linalg.qr((np.stack([driving, driving * x, np.ones(size), x], axis=1)) * root[:, None])[0]
    rest = weighted[window] - basis @ (np.conj(basis.T) @ weighted[window])
    left = np.maximum(np.sum(np.abs(rest) ** 2, axis=0), 1e-300)
    best = (0.0, 0.0j)
    for offset in np.linspace(-TUNING.reach, TUNING.reach, TUNING.frequencies) * max(half_hz, step_hz):
        omega = 2.0 * np.pi * (float(frequency_hz[at]) + offset)
        pole = complex(-ratio * omega, omega * np.sqrt(1.0 - ratio**2))
        columns = np.stack([np.ones(size), driving], axis=1) * (root / (s - pole))[:, None]
        own = np.linalg.qr(columns - basis @ (np.conj(basis.T) @ columns))[0]
        gained = np.sum(np.abs(np.conj(own.T) @ rest) ** 2, axis=0) / left
        gain = -size * float(np.sum(np.log1p(-np.minimum(gained, 1.0 - 1e-12))))
        if omega * samples.span_s > 4.0 * np.pi and gain > best[0]:
            best = (gain, pole)
    return best


PROMISING = TUNING.promising


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
        places = candidates(found, lowest_hz, PROMISING * penalty)
        places.sort(key=before.gain, reverse=True)
        if found.poles.size:
            places = places[:PLACES]
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


def most_iterated_s(samples: Samples) -> float:
    """The farthest that the iteration moves a lag: half a sample in each round."""
    return 0.5 * TUNING.rounds * samples.step_s


def criterion(samples: Samples) -> float:
    """Gain of log likelihood from which a mode is accepted: the Bayesian information criterion."""
    return float(0.5 * (2 + PER_MODE * samples.values.shape[1]) * np.log(2 * samples.frequency_hz.size))


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
        # One factorization where all outputs have the same weights.
        alike = bool(np.all(self._root == self._root[:, :1]))
        factors = [np.linalg.qr(columns * own[:, None]) for own in self._root.T[: 1 if alike else None]]
        self._factors = factors * self._root.shape[1] if alike else factors
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

        def trial(shorter: ComplexArray) -> Weighted | None:
            if not is_mode(self.poles + shorter).all():
                return None
            moved = Weighted(self.samples, self.poles + shorter, self._weights)
            return moved if moved.score < self.score else None

        return shortened(change, trial)

    def converged(self) -> Weighted:
        """After as many steps as help."""
        found = self
        for _ in range(MAX_ITERATIONS):
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
        if is_mode(found.poles + step).all():
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
    return replace(samples, input=samples.drive.at_samples() - samples.to_time(error))


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


def is_mode(poles: ComplexArray) -> BoolArray:
    """Whether each motion decays, and oscillates."""
    return np.asarray((poles.real < 0.0) & (poles.imag > 0.0) & (-poles.real < MAX_DAMPING * np.abs(poles)))

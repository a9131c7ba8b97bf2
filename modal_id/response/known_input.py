"""Modes that a measured input drives: their number, poles, participation, and the noise of outputs and input."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import uniform_filter1d

from modal_id.response.columns import FIXED, OF_MODE, Samples, amplitudes, spline_gain, transfer
from tracker import BoolArray, ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Search for modes, iteration of their poles, noise."""

    #: [1] largest number of steps of the poles in a search
    search_steps: int = 12
    #: [1] largest number of halvings of such a step
    halvings: int = 8
    #: [1] gain of log likelihood by a step that ends a search
    #: statistics: About one sd; the rounds with the noise spectra follow.
    negligible: float = 0.5
    #: [1] peaks of the residual spectrum that are tried for the next mode
    peaks: int = 3
    #: [1] damping ratio that is tried at each peak, beside smaller and larger ones by `apart`
    #: convention: From a steel beam to a strongly damped one.
    damping_ratio: float = 0.01
    #: [1] factor between the damping ratios that are tried
    #: physics: The iteration covers a factor of three.
    apart: float = 5.0
    #: [1] damping ratio above which a fitted motion is no mode
    #: physics: The response of a mode damped more has no resonance to tell its poles from a polynomial.
    most_damping: float = 0.5
    #: [bins] half width of the average of the noise spectrum
    #: statistics: Standard deviation of the noise level 7 % (about 200 squares in a window).
    half_window: int = 48
    #: [bins] half width of the average of the input's spectrum
    near: int = 4
    #: [1] power of the input over that of its noise below which it drives no mode that can be told
    #: statistics: The mean of nine bins of noise exceeds three times its expectation once in 30 000.
    least_power: float = 3.0
    #: [1] the same as `rounds`, while modes are still being added
    search_rounds: int = 2
    #: [1] rounds of noise spectrum, noise in the input and steps of the poles
    #: measurement: benchmarks/known_input.py; the fourth round changes zeta by less than a tenth of its sd.
    rounds: int = 4
    #: [1] share of a window that must be free of the input's noise to tell the outputs' noise from it
    least_free: float = 0.1
    #: [1] smallest noise variance over the mean square of the output
    #: physics: Data without noise, of rounding errors only.
    least_noise: float = 1e-16


TUNING = Tuning()


@dataclass(frozen=True)
class Noise:
    """Variances of real and imaginary parts of the transform.

    Attributes
    ----------
    output : array, shape (b, k)
        Of each output.
    input : float
        Of the input, which is white.
    """

    output: FloatArray
    input: float

    def weights(self, response: ComplexArray) -> FloatArray:
        """Inverse variance of the outputs less the response to the measured input; shape (b, k)."""
        return np.asarray(1.0 / (self.output + self.input * np.abs(response) ** 2))


@dataclass(frozen=True)
class ResponseFit:
    """Poles and coefficients that fit the outputs to the measured input.

    Attributes
    ----------
    samples : Samples
    poles : complex array, shape (m,)
    coefficients : array, shape (FIXED + OF_MODE m, k)
    residual : array, shape (2 b, k)
        As `Samples.rows`.
    weights : array, shape (b, k)
        Inverse variance of the residual.
    leverage : array, shape (b, k)
        Share of the noise of each bin that the parameters absorb.
    noise : Noise
    covariance : array, shape (2 m, 2 m)
        Of (Re, Im) of each pole in turn.
    coefficient_covariance : array, shape (k, p, p)
        Of the coefficients of each output, uncertainty of the poles included.
    coefficient_slopes : array, shape (k, p, 2 m)
        Change of the best coefficients with (Re, Im) of the poles.
    """

    samples: Samples
    poles: ComplexArray
    coefficients: FloatArray
    residual: FloatArray
    weights: FloatArray
    leverage: FloatArray
    noise: Noise
    covariance: FloatArray
    coefficient_covariance: FloatArray
    coefficient_slopes: FloatArray

    @property
    def driven(self) -> ComplexArray:
        """Factors of the responses to a band-limited input, larger than that to its spline; shape (m, k)."""
        loss = spline_gain(np.abs(self.poles) / (2.0 * np.pi), self.samples.step_s)
        return np.asarray(amplitudes(self.coefficients)[0] * loss[:, None])

    def transfer(self, frequency_hz: FloatArray) -> ComplexArray:
        """Frequency response of each output; shape (frequencies, k)."""
        return transfer(frequency_hz, self.poles, self.coefficients[:2], self.driven)


def fit_response(samples: Samples, max_modes: int, lowest_hz: float, input_sd: float) -> ResponseFit | None:
    """Modes of the response to the samples' input; None where no mode exceeds the noise.

    Modes are added one by one at peaks of the residual spectrum, with the noise of outputs and input iterated in
    between, while the likelihood improves by more than the Bayesian information criterion asks for and the input
    exceeds its noise there. `input_sd` is the standard deviation of the noise of the input, NaN where unknown: it
    is then taken from the data, as an upper bound (`_input_noise`).

    Notes
    -----
    Errors in variables. With noise in input and outputs the residual ``e = y - G u`` has the covariance ``S =
    diag(n_y^2) + n_u^2 G G^H``, and the regressors correlate with it: least squares on the measured input is biased
    in damping. The regressors are therefore made from ``u - E[noise of u | e] = u + n_u^2 G^H S^-1 e``, whose error
    is independent of e, as an instrument (the maximum-likelihood score of Pintelon & Schoukens, *System
    Identification*, 2nd ed., 2012, section 9.12, doi:10.1002/9781118287422). Weights are ``1 / S_kk``; the
    covariance of the result contains the correlation of the outputs that the common input causes.
    """
    bins, outputs = samples.frequency_hz.size, samples.values.shape[1]
    penalty = 0.5 * (2 + OF_MODE * outputs) * np.log(2 * bins)
    found = _first(samples, input_sd)
    while found.poles.size < max_modes:
        trial = _with_another(found, lowest_hz)
        if (
            trial is None
            or _Weighted(found.samples, found.poles, found.weights).score - trial.score < penalty
        ):
            break
        better = _refined(samples, trial.poles, input_sd, found.noise)
        at = np.interp(
            np.abs(better.poles) / (2.0 * np.pi), samples.frequency_hz, _is_driven(samples, better.noise)
        )
        if not (_significant(better, penalty) & (at > 0.5)).all():
            break
        found = better
    if not found.poles.size:
        return None
    return _refined(
        samples, found.poles[np.argsort(np.abs(found.poles))], input_sd, found.noise, TUNING.rounds
    )


def _first(samples: Samples, input_sd: float) -> ResponseFit:
    """The fit without modes."""
    level = np.maximum(np.mean(samples.outputs**2, axis=0), 1e-300)
    noise = Noise(np.tile(level, (samples.frequency_hz.size, 1)), 0.0)
    return _refined(samples, np.empty(0, dtype=complex), input_sd, noise)


class _Weighted:
    """Least squares with given weights, shape (b, k), up to the noise level of each output."""

    def __init__(self, samples: Samples, poles: ComplexArray, weights: FloatArray) -> None:
        self.samples, self.poles, self._weights = samples, poles, weights
        root = np.sqrt(np.concatenate([weights, weights]))
        self._root = root / np.sqrt(np.mean(root**2, axis=0))
        columns, self._scale = _scaled(samples.columns(poles))
        self._factors = [np.linalg.qr(columns * own[:, None]) for own in self._root.T]
        values = samples.outputs * self._root
        self._explained = [q.T @ values[:, out] for out, (q, _) in enumerate(self._factors)]
        self.residual = np.column_stack(
            [values[:, out] - q @ self._explained[out] for out, (q, _) in enumerate(self._factors)]
        )
        floor = TUNING.least_noise * np.sum(values**2, axis=0) + 1e-300
        self.rss = np.maximum(np.sum(self.residual**2, axis=0), floor)
        #: Negative log likelihood.
        self.score = float(0.5 * values.shape[0] * np.sum(np.log(self.rss)))

    def stepped(self) -> _Weighted | None:
        """After one step of the poles that lowers the score; None where there is none."""
        solved = [
            np.linalg.lstsq(r, own, rcond=1e-12)[0]
            for (_, r), own in zip(self._factors, self._explained, strict=True)
        ]
        slopes = _pole_slopes(self.samples.slopes(self.poles), np.column_stack(solved) / self._scale[:, None])
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
                trial = _Weighted(self.samples, self.poles + change, self._weights)
                if trial.score < self.score:
                    return trial
            change = 0.4 * change
        return None

    def converged(self) -> _Weighted:
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


def _with_another(found: ResponseFit, lowest_hz: float) -> _Weighted | None:
    """The best fit with one more mode, at one of the peaks of the residual spectrum."""
    samples, poles, weights = found.samples, found.poles, found.weights
    size = weights.shape[0]
    square = found.residual[:size] ** 2 + found.residual[size:] ** 2
    power = uniform_filter1d(np.sum(square * weights, axis=1), 3)
    frequency_hz, taken = samples.frequency_hz, np.zeros(size, dtype=bool)
    taken[frequency_hz < max(lowest_hz, 2.0 / samples.span_s)] = True
    taken |= ~_is_driven(samples, found.noise)
    best: _Weighted | None = None
    for _ in range(TUNING.peaks):
        if taken.all():
            break
        at = frequency_hz[int(np.argmax(np.where(taken, -1.0, power)))]
        taken |= np.abs(frequency_hz - at) < max(0.05 * at, 3.0 / samples.span_s)
        omega = 2.0 * np.pi * at
        for ratio in TUNING.damping_ratio * TUNING.apart ** np.array([-1.0, 0.0, 1.0]):
            start = -ratio * omega + 1j * omega * np.sqrt(1.0 - ratio**2)
            trial = _Weighted(samples, np.append(poles, start), weights)
            if best is None or trial.score < best.score:
                best = trial
    return None if best is None else best.converged()


def _is_driven(samples: Samples, noise: Noise) -> BoolArray:
    """Bins near which the input exceeds its noise: a response to noise alone has no instrument; shape (b,)."""
    power = uniform_filter1d(np.abs(samples.input_bins) ** 2, 2 * TUNING.near + 1)
    return np.asarray(power > TUNING.least_power * 2.0 * noise.input)


def _refined(
    samples: Samples, poles: ComplexArray, input_sd: float, noise: Noise, rounds: int = TUNING.search_rounds
) -> ResponseFit:
    """Poles with the noise spectra of outputs and input, all iterated together from a first noise."""
    found = _solved(samples, samples, poles, noise, 1.0 / noise.output)
    for _ in range(rounds):
        samples = _with_missing_filled(found)
        noise = _noise(found, input_sd)
        response = found.transfer(samples.frequency_hz)
        better = _with_likely_input(samples, found, noise, response)
        found = _solved(samples, better, found.poles, noise, noise.weights(response))
        step = _limited(found.step, found.poles, samples)
        if _is_mode(found.poles + step).all():
            found = _solved(samples, better, found.poles + step, noise, noise.weights(response))
    return found


@dataclass(frozen=True)
class _Solved(ResponseFit):
    """A fit, and the step of (Re, Im) of its poles that the score asks for."""

    step: FloatArray


def _solved(
    samples: Samples, better: Samples, poles: ComplexArray, noise: Noise, weights: FloatArray
) -> _Solved:
    """Coefficients at given poles by instrumental variables: the columns of `better`, whose input is the likely one."""
    columns, scale = _scaled(samples.columns(poles))
    instruments = columns if better is samples else better.columns(poles) / scale
    root = np.sqrt(np.concatenate([weights, weights]))
    k, p, m = weights.shape[1], columns.shape[1], poles.size
    raw, inverse = np.empty((p, k)), np.empty((k, p, p))
    for out in range(k):
        left, right = instruments * root[:, [out]], columns * root[:, [out]]
        inverse[out] = np.linalg.pinv(left.T @ right, rcond=1e-13)
        raw[:, out] = inverse[out] @ (left.T @ (samples.outputs[:, out] * root[:, out]))
    residual = samples.outputs - columns @ raw
    slopes = _pole_slopes(better.slopes(poles), raw / scale[:, None])
    information, middle = np.zeros((2 * m, 2 * m)), np.zeros((2 * m, 2 * m))
    gradient, common = np.zeros(2 * m), np.zeros((weights.shape[0], 2 * m), dtype=complex)
    response = transfer(
        samples.frequency_hz, poles, raw[:2] / scale[:2, None], amplitudes(raw / scale[:, None])[0]
    )
    leverage, carried, own_slopes = np.empty(weights.shape), [], []
    for out in range(k):
        # Without the part that the coefficients explain: orthogonal to the measured columns.
        weighted = slopes[:, :, out] * root[:, [out]] ** 2
        back = inverse[out].T @ (columns.T @ weighted)
        rest = slopes[:, :, out] - instruments @ back
        carried.append(inverse[out] @ (instruments.T @ weighted))
        own_slopes.append(rest)
        scaled = rest * root[:, [out]]
        share = samples.share_given[out]
        information += share * scaled.T @ (slopes[:, :, out] * root[:, [out]])
        gradient += scaled.T @ (residual[:, out] * root[:, out]) * share
        both = np.concatenate([noise.output[:, out], noise.output[:, out]])
        middle += share * (rest * root[:, [out]] ** 4 * both[:, None]).T @ rest
        half = weights.shape[0]
        as_complex = rest[:half] + 1j * rest[half:]
        common += share * weights[:, [out]] * np.conj(response[:, [out]]) * as_complex
        hat = np.sum((columns * root[:, [out]]) @ inverse[out] * (instruments * root[:, [out]]), axis=1)
        leverage[:, out] = 0.5 * (hat[:half] + hat[half:])
    middle += noise.input * np.real(np.conj(common).T @ common)
    inverted = np.linalg.pinv(information)
    covariance = inverted @ middle @ inverted.T
    covariance = 0.5 * (covariance + covariance.T)
    for out in range(k):
        scaled = own_slopes[out] * root[:, [out]]
        hat = np.sum(scaled @ covariance * scaled, axis=1)
        leverage[:, out] += 0.5 * (hat[: hat.size // 2] + hat[hat.size // 2 :])
    of_coefficients = _coefficient_covariance(
        instruments, weights, noise, response, inverse, carried, covariance, samples.share_given
    )
    of_coefficients /= scale[:, None] * scale
    return _Solved(
        samples,
        poles,
        raw / scale[:, None],
        residual,
        weights,
        np.clip(leverage, 0.0, 0.95),
        noise,
        covariance,
        of_coefficients,
        -np.array(carried) / scale[:, None],
        inverted @ gradient,
    )


def _coefficient_covariance(
    instruments: FloatArray,
    weights: FloatArray,
    noise: Noise,
    response: ComplexArray,
    inverse: FloatArray,
    carried: list[FloatArray],
    covariance: FloatArray,
    share: FloatArray,
) -> FloatArray:
    """Covariance of the scaled coefficients of each output, uncertainty of the poles included; shape (k, p, p)."""
    found = np.empty_like(inverse)
    for out in range(weights.shape[1]):
        variance = noise.output[:, out] + noise.input * np.abs(response[:, out]) ** 2
        factor = np.concatenate([weights[:, out] ** 2 * variance] * 2)
        middle = (instruments * factor[:, None]).T @ instruments / share[out]
        own = inverse[out] @ middle @ inverse[out].T
        found[out] = own + carried[out] @ covariance @ carried[out].T
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
    if noise.input == 0.0:
        return samples
    half = found.residual.shape[0] // 2
    residual = found.residual[:half] + 1j * found.residual[half:]
    scaled = np.conj(response) / noise.output
    error = -np.sum(scaled * residual, axis=1) / (
        1.0 / noise.input + np.sum(np.abs(response) ** 2 / noise.output, axis=1)
    )
    return samples.with_input(samples.drive.at_samples() - samples.to_time(error))


def _noise(found: ResponseFit, input_sd: float) -> Noise:
    """Noise spectra of the outputs, averaged over neighbouring bins, and the noise of the input."""
    samples, residual = found.samples, found.residual
    half = residual.shape[0] // 2
    square = residual[:half] ** 2 + residual[half:] ** 2
    free = 2.0 * (1.0 - found.leverage) * samples.share_given
    floor = TUNING.least_noise * np.mean(samples.outputs**2, axis=0) + 1e-300
    plain = np.maximum(_average(square) / _average(free), floor)
    gain = np.abs(found.transfer(samples.frequency_hz)) ** 2
    variance = input_sd**2 if np.isfinite(input_sd) else _input_noise(samples, square, gain * free)
    if variance == 0.0:
        return Noise(plain, 0.0)
    output = plain
    for _ in range(2):
        clear = (variance * gain < output).astype(float)
        share = _average(clear)
        known = share > TUNING.least_free
        own = _average(square * clear) / np.maximum(_average(free * clear), 1e-300)
        own -= variance * _average(gain * free * clear) / np.maximum(_average(free * clear), 1e-300)
        # At least a tenth: the difference of two estimates scatters.
        own = np.maximum(own, 0.1 * plain * known + floor)
        output = np.column_stack([_across(own[:, out], known[:, out]) for out in range(own.shape[1])])
        output = np.maximum(output, floor)
    return Noise(output, variance)


def _input_noise(samples: Samples, square: FloatArray, gain: FloatArray) -> float:
    """Variance of the input's noise, from the data: the smaller of two upper bounds.

    The lowest part of the input's spectrum, and the residual over the squared response where that is least.
    """
    own = np.abs(samples.input_bins) ** 2
    floor = 0.5 * float(np.min(_average(own[:, None])))
    from_residual = float(np.min(_average(square) / np.maximum(_average(gain), 1e-300)))
    return min(floor, from_residual)


def _average(values: FloatArray) -> FloatArray:
    width = min(2 * TUNING.half_window + 1, values.shape[0])
    return np.asarray(uniform_filter1d(values, width, axis=0, mode="reflect"))


def _across(values: FloatArray, known: BoolArray) -> FloatArray:
    """The values, interpolated where they are not known; as they are where none is."""
    if not known.any():
        return values
    index = np.arange(values.size)
    return np.asarray(np.interp(index, index[known], values[known]))


def _significant(found: ResponseFit, penalty: float) -> BoolArray:
    """Modes without which chi-square would be larger by more than the criterion asks for; shape (m,)."""
    kept = np.ones(found.poles.size, dtype=bool)
    for index in range(kept.size):
        own = slice(FIXED + OF_MODE * index, FIXED + OF_MODE * (index + 1))
        total = 0.0
        for out in range(found.coefficients.shape[1]):
            values = found.coefficients[own, out]
            total += float(values @ np.linalg.pinv(found.coefficient_covariance[out, own, own]) @ values)
        kept[index] = 0.5 * total > penalty
    return kept


def _scaled(columns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Columns of unit norm, and their norms."""
    scale = np.sqrt(np.sum(columns**2, axis=0)) + 1e-300
    return columns / scale, scale


def _pole_slopes(slopes: FloatArray, coefficients: FloatArray) -> FloatArray:
    """Derivatives of the fitted motion with respect to (Re, Im) of each pole; shape (2 b, 2 m, k)."""
    driven, free = amplitudes(coefficients)
    m, k = driven.shape
    found = np.empty((slopes.shape[0], 2 * m, k))
    for index in range(m):
        real, imag, free_real, free_imag = slopes[:, OF_MODE * index : OF_MODE * (index + 1)].T
        for place, turn in enumerate((1.0, 1j)):
            c, d = turn * driven[index], turn * free[index]
            found[:, 2 * index + place] = (
                np.outer(real, c.real)
                - np.outer(imag, c.imag)
                + np.outer(free_real, d.real)
                - np.outer(free_imag, d.imag)
            )
    return found


def _limited(step: FloatArray, poles: ComplexArray, samples: Samples) -> ComplexArray:
    """A step of the poles within the reach of the linearisation: a phase of a radian over the record."""
    change = step[0::2] + 1j * step[1::2]
    limit = 1.0 / samples.span_s + 0.3 * np.abs(poles.real)
    return np.asarray(
        change * np.min(np.minimum(1.0, limit / np.maximum(np.abs(change), 1e-300)), initial=1.0)
    )


def _is_mode(poles: ComplexArray) -> BoolArray:
    """Whether each motion decays, and oscillates."""
    return np.asarray(
        (poles.real < 0.0) & (poles.imag > 0.0) & (-poles.real < TUNING.most_damping * np.abs(poles))
    )

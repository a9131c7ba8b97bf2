"""Modes that a measured input drives: their number, poles and participation, and the noise."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from modal_id.fit import MAX_DAMPING, PLACES
from modal_id.response.candidates import candidates, drives
from modal_id.response.columns import PER_MODE, Samples
from modal_id.response.noise import TUNING as NOISE
from modal_id.response.noise import InputNoise, Noise, noise_after
from modal_id.response.solution import ResponseFit, pole_slopes, scaled, significant, solve_at
from modal_id.solve import MAX_ITERATIONS, shortened
from tracker import BoolArray, ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Search for modes, iteration of their poles."""

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
    #: [1] the same as `rounds`, while modes are still being added
    search_rounds: int = 2
    #: [1] rounds of noise spectrum, noise in the input and steps of the poles
    #: measurement: benchmarks/known_input.py; the fourth round changes zeta by less than a tenth of its sd.
    rounds: int = 4


TUNING = Tuning()
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


def is_mode(poles: ComplexArray) -> BoolArray:
    """Whether each motion decays, and oscillates."""
    return np.asarray((poles.real < 0.0) & (poles.imag > 0.0) & (-poles.real < MAX_DAMPING * np.abs(poles)))

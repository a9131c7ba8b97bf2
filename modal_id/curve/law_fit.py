"""Most probable parameters of a law of decay, given the complex amplitudes of blocks, and the law's evidence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modal_id.curve.laws import Law
from modal_id.curve.quadrature import LawDecay, decay_of_law
from tracker import ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Convergence of a law."""

    #: [1] largest number of iterations
    max_iterations: int = 40
    #: [1] largest number of halvings of a step
    max_halvings: int = 10
    #: [1] twice the gain in log posterior density of a further step below which the fit has converged
    #: statistics: A step of a thirtieth of a standard deviation.
    converged: float = 1e-3
    #: [1] the same where no step succeeds because of rounding or the quadrature
    #: statistics: A step of a fifth of a standard deviation.
    converged_to_rounding: float = 0.05
    #: [1] condition number above which the fit has failed
    #: physics: Rounding of 1e-16 leaves two digits.
    max_condition: float = 1e14


TUNING = Tuning()


@dataclass(frozen=True)
class LawFit:
    """A law fitted to the complex amplitudes of blocks.

    Attributes
    ----------
    law : Law
    parameters : array, shape (q,)
    covariance : array, shape (q, q)
        Including the prior.
    wave : complex array, shape (b,)
        Fitted amplitude of each block.
    residual : complex array, shape (b,)
        Measured less fitted.
    leverage : array, shape (b,)
        Share of each block's variance that the fit absorbs, 0 to 1.
    log_evidence : float
        By Laplace's approximation; comparable between laws fitted to the same blocks with the same variance.
    initial : complex
        Fitted factor on the decay that is 1 at the start.
    """

    law: Law
    parameters: FloatArray
    covariance: FloatArray
    wave: ComplexArray
    residual: ComplexArray
    leverage: FloatArray
    log_evidence: float
    initial: complex


def fit_law(
    law: Law, time_s: FloatArray, measured: ComplexArray, variance: FloatArray, start: FloatArray
) -> LawFit | None:
    """Gauss-Newton; None where it does not converge or the blocks do not determine the parameters.

    `measured`, shape (b,), are complex amplitudes, `variance` that of their real and of their imaginary part.
    """
    fitting = _Fitting(law, time_s, measured, variance)
    now = fitting.at(start)
    for _ in range(TUNING.max_iterations):
        if now is None:
            return None
        normal, pull = fitting.normal(now)
        scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
        scaled = normal * np.outer(scale, scale)
        if not np.all(np.isfinite(scaled)):
            return None
        values, vectors = np.linalg.eigh(scaled)
        if values[0] <= values[-1] / TUNING.max_condition:
            return None
        vectors *= scale[:, None]
        covariance = np.asarray((vectors / values) @ vectors.T)
        step = covariance @ pull
        better = None if float(pull @ step) < TUNING.converged else fitting.move(now, step)
        if better is None:
            if float(pull @ step) > TUNING.converged_to_rounding:
                return None
            return fitting.result(now, covariance, normal)
        now = better
    return None


@dataclass(frozen=True)
class _At:
    """Parameters with the amplitude and phase of the start (ln modulus, argument) last."""

    values: FloatArray
    wave: ComplexArray
    slopes: ComplexArray
    objective: float


@dataclass(frozen=True)
class _Fitting:
    law: Law
    time_s: FloatArray
    measured: ComplexArray
    variance: FloatArray

    def at(self, parameters: FloatArray) -> _At | None:
        """Parameters with the best complex factor on their decay."""
        decay = decay_of_law(self.time_s, self.law, parameters)
        if decay is None:
            return None
        weighted = np.conj(decay.wave) / self.variance
        factor = np.log(np.sum(weighted * self.measured) / np.sum(weighted * decay.wave) + 1e-300)
        return self._scaled(np.append(parameters, [factor.real, factor.imag]), decay)

    def solve(self, values: FloatArray) -> _At | None:
        decay = decay_of_law(self.time_s, self.law, values[:-2])
        return None if decay is None else self._scaled(values, decay)

    def _scaled(self, values: FloatArray, decay: LawDecay) -> _At:
        factor = np.exp(complex(values[-2], values[-1]))
        wave = factor * decay.wave
        slopes = np.concatenate([factor * decay.slopes, wave[:, None], 1j * wave[:, None]], axis=1)
        prior = (values[:-2] - self.law.prior_mean) / self.law.prior_sd
        misfit = np.sum(np.abs(self.measured - wave) ** 2 / self.variance)
        return _At(values, wave, slopes, 0.5 * float(misfit + prior @ prior))

    def normal(self, now: _At) -> tuple[FloatArray, FloatArray]:
        weighted = np.conj(now.slopes) / self.variance[:, None]
        normal = np.real(weighted.T @ now.slopes)
        pull = np.real(weighted.T @ (self.measured - now.wave))
        precision = self.law.prior_sd**-2.0
        place = np.arange(precision.size)
        normal[place, place] += precision
        pull[place] -= precision * (now.values[:-2] - self.law.prior_mean)
        return normal, pull

    def move(self, now: _At, step: FloatArray) -> _At | None:
        for _ in range(TUNING.max_halvings):
            trial = self.solve(now.values + step)
            if trial is not None and trial.objective < now.objective:
                return trial
            step = 0.4 * step
        return None

    def result(self, now: _At, covariance: FloatArray, normal: FloatArray) -> LawFit:
        own = np.einsum("bi,ij,bj->b", now.slopes, covariance, np.conj(now.slopes))
        finite = self.law.prior_sd[np.isfinite(self.law.prior_sd)]
        # Parameters with a flat prior are common to all laws: their factor cancels.
        log_evidence = (
            -now.objective - 0.5 * float(np.linalg.slogdet(normal)[1]) - float(np.sum(np.log(finite)))
        )
        return LawFit(
            self.law,
            now.values[:-2],
            covariance[:-2, :-2],
            now.wave,
            self.measured - now.wave,
            0.5 * np.real(own) / self.variance,
            log_evidence,
            complex(np.exp(complex(now.values[-2], now.values[-1]))),
        )

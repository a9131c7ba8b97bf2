"""Decay that follows a law, by quadrature over the logarithm of the amplitude; its parameters and evidence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from modal_id.curve.laws import Law, Rates
from modal_id.data import row_blocks
from modal_id.solve import maximum, shortened
from tracker import ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Integration of the amplitude."""

    #: [1] depth, in log amplitude below the largest, beyond which rates are those at zero amplitude
    #: physics: exp(-14) = 8e-7 of the largest.
    deepest: float = 14.0
    #: [1] log amplitude below the largest that stands for zero amplitude
    far: float = 1e4
    #: [1] factor on the depth where it does not suffice
    deeper: float = 1.5


TUNING = Tuning()


# Points of the quadrature; the trapezoidal rule then errs by about 1e-5 in ln a and in the phase in radians.
_POINTS = 800


@dataclass(frozen=True)
class LawDecay:
    """``a(t) exp(i phase(t))`` that follows a law: ``wave``, shape (n,), its derivatives ``slopes``, shape (n, p)."""

    wave: ComplexArray
    slopes: ComplexArray


def decay_of_law(time_s: FloatArray, law: Law, parameters: FloatArray) -> LawDecay | None:
    """Decay for times from 0 on, shape (n,), with its derivatives with respect to the parameters of the law.

    None where the decay rate is not positive at an amplitude that the record reaches.

    Notes
    -----
    With u = ln a, ``t(u) = int_u^0 dv / decay(v)`` and ``phase = int_u^0 angular(v) / decay(v) dv``. At constant time
    the derivative with respect to a parameter p is ``du/dp = -decay(u) I`` with
    ``I = int_u^0 (d decay / dp) / decay^2 dv``, and that of the phase is the integral of
    ``(d angular / dp) / decay + (angular(u) - angular(v)) (d decay / dp) / decay^2``.
    """
    path = _path(float(np.max(time_s)), law, parameters)
    if path is None:
        return None
    rates = path.rates
    # Rows beyond the last wanted time are not needed.
    places = np.searchsorted(path.time_s, time_s)
    rows = min(max(int(np.max(places)), 1) + 1, path.time_s.size)
    slopes = _slopes(
        path.u,
        path.time_s,
        rates.decay,
        path.excess_rad_s,
        np.ascontiguousarray(rates.decay_slopes),
        np.ascontiguousarray(rates.angular_slopes),
        np.ascontiguousarray(time_s),
        places,
        rows,
    )
    wave = path.wave(time_s)
    return LawDecay(wave, slopes * wave[:, None])


def wave_of_law(time_s: FloatArray, law: Law, parameters: FloatArray) -> ComplexArray | None:
    """The decay alone, as `decay_of_law`."""
    path = _path(float(np.max(time_s)), law, parameters)
    return None if path is None else path.wave(time_s)


@dataclass(frozen=True)
class _Path:
    """Times at which the logarithm of the amplitude is u, the rates there, and the frequency less the last one."""

    u: FloatArray
    rates: Rates
    time_s: FloatArray
    excess_rad_s: FloatArray

    def wave(self, time_s: FloatArray) -> ComplexArray:
        excess = _integral(self.u, self.excess_rad_s / self.rates.decay)
        found = np.empty(time_s.size, dtype=complex)
        for rows in row_blocks(time_s.size):
            t = time_s[rows]
            phase = np.interp(t, self.time_s, excess) + float(self.rates.angular[-1]) * t
            found[rows] = np.exp(np.interp(t, self.time_s, self.u) + 1j * phase)
        return found


def _path(end_s: float, law: Law, parameters: FloatArray) -> _Path | None:
    # Depths in steps: small changes of the parameters leave the points of the quadrature unchanged.
    steps = np.log(max(1.2 * float(parameters[0]) * end_s, 1.0)) / np.log(TUNING.deeper)
    depth = min(float(TUNING.deeper ** np.ceil(steps)), TUNING.deepest)
    while True:
        u = np.linspace(0.0, -depth, _POINTS)
        if depth == TUNING.deepest:
            # One interval of constant rates to the end of any record.
            u = np.append(u, -TUNING.far)
        rates = law.rates(np.exp(u), parameters)
        # Rates at amplitudes that the record does not reach are not restricted.
        reached = int(np.argmin(np.append(rates.decay > 0.0, False)))
        if reached < 2 or not np.all(np.isfinite(rates.angular)):
            return None
        u, rates = u[:reached], rates.first(reached)
        time = _integral(u, 1.0 / rates.decay)
        if time[-1] >= end_s:
            return _Path(u, rates, time, rates.angular - float(rates.angular[-1]))
        if reached < _POINTS or depth == TUNING.deepest:
            return None
        depth = min(TUNING.deeper * depth, TUNING.deepest)


def _integral(u: FloatArray, values: FloatArray) -> FloatArray:
    """Integral from u to 0 at each u."""
    parts = np.cumsum(-0.5 * (values[1:] + values[:-1]) * np.diff(u))
    return np.concatenate([[0.0], parts])


@njit(cache=True, nogil=True, error_model="numpy")
def _slopes(
    u: FloatArray,
    time_s: FloatArray,
    decay: FloatArray,
    excess: FloatArray,
    decay_slopes: FloatArray,
    angular_slopes: FloatArray,
    wanted_s: FloatArray,
    places: NDArray[np.intp],
    n: int,
) -> ComplexArray:
    """Derivatives of u + i phase with respect to the parameters at the wanted times, interpolated linearly.

    `places` are the first rows that are not before the wanted times; rows from `n` on are not needed.
    """
    q = decay_slopes.shape[1]
    # The integrals of `decay_of_law`; each grows by the mean of two neighbouring integrands times the step.
    lag, own, shared = np.zeros((n, q)), np.zeros((n, q)), np.zeros((n, q))
    for row in range(1, n):
        half = 0.5 * (u[row - 1] - u[row])
        before, after = half / decay[row - 1], half / decay[row]
        for p in range(q):
            first, second = decay_slopes[row - 1, p] * before, decay_slopes[row, p] * after
            first, second = first / decay[row - 1], second / decay[row]
            lag[row, p] = lag[row - 1, p] + first + second
            shared[row, p] = shared[row - 1, p] + excess[row - 1] * first + excess[row] * second
            own[row, p] = (
                own[row - 1, p] + angular_slopes[row - 1, p] * before + angular_slopes[row, p] * after
            )
    result = np.empty((wanted_s.size, q), dtype=np.complex128)
    for place in range(wanted_s.size):
        row = min(max(places[place], 1), n - 1)
        share = (wanted_s[place] - time_s[row - 1]) / (time_s[row] - time_s[row - 1])
        for p in range(q):
            value = 0.0j
            for at, weight in ((row - 1, 1.0 - share), (row, share)):
                phase = own[at, p] - shared[at, p] + excess[at] * lag[at, p]
                value += weight * complex(-decay[at] * lag[at, p], phase)
            result[place, p] = value
    return result


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
    """None where it does not converge or the blocks do not determine the parameters.

    `measured`, shape (b,), are complex amplitudes, `variance` that of their real and of their imaginary part.
    """
    fitting = _Fitting(law, time_s, measured, variance)
    best = maximum(fitting.at(start), fitting.normal, fitting.move)
    return None if best is None else fitting.result(*best)


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
        def trial(shorter: FloatArray) -> _At | None:
            one = self.solve(now.values + shorter)
            return one if one is not None and one.objective < now.objective else None

        return shortened(step, trial)

    def result(self, now: _At, covariance: FloatArray) -> LawFit:
        own = np.einsum("bi,ij,bj->b", now.slopes, covariance, np.conj(now.slopes))
        finite = self.law.prior_sd[np.isfinite(self.law.prior_sd)]
        # Parameters with a flat prior are common to all laws: their factor cancels.
        log_evidence = (
            -now.objective + 0.5 * float(np.linalg.slogdet(covariance)[1]) - float(np.sum(np.log(finite)))
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

"""Decay that follows a law: amplitude and phase by quadrature over the logarithm of the amplitude."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modal_id.curve.laws import Law, Rates
from modal_id.fit.amplitude_dependence import NonlinearDecay
from tracker.arrays import ComplexArray, FloatArray

# Points of the quadrature; the trapezoidal rule then errs by about 1e-5 in ln a and in the phase in radians.
_POINTS = 800
# Below this amplitude, exp(-14), the rates are those at zero amplitude.
_DEEPEST = 14.0
_FAR = 1e4
_DEEPER = 1.5
_ATTEMPTS = 8


def decay_of_law(time_s: FloatArray, law: Law, parameters: FloatArray) -> NonlinearDecay | None:
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
    u, rates, time, excess = path.u, path.rates, path.time_s, path.excess_rad_s
    lag = _integral(u, rates.decay_slopes / rates.decay[:, None] ** 2)
    u_slopes = -rates.decay[:, None] * lag
    phase_slopes = _integral(u, rates.angular_slopes / rates.decay[:, None])
    phase_slopes -= _integral(u, (excess / rates.decay**2)[:, None] * rates.decay_slopes)
    phase_slopes += excess[:, None] * lag
    wave = path.wave(time_s)
    at = np.interp(time_s, time, np.arange(u.size))
    slopes = (_between(u_slopes, at) + 1j * _between(phase_slopes, at)) * wave[:, None]
    return NonlinearDecay(wave, slopes)


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
        phase = np.interp(time_s, self.time_s, _integral(self.u, self.excess_rad_s / self.rates.decay))
        phase += float(self.rates.angular[-1]) * time_s
        return np.asarray(np.exp(np.interp(time_s, self.time_s, self.u) + 1j * phase))


def _path(end_s: float, law: Law, parameters: FloatArray) -> _Path | None:
    # Depths in steps: small changes of the parameters leave the points of the quadrature unchanged.
    steps = np.log(max(1.2 * float(parameters[0]) * end_s, 1.0)) / np.log(_DEEPER)
    depth = min(float(_DEEPER ** np.ceil(steps)), _DEEPEST)
    for _ in range(_ATTEMPTS):
        u = np.linspace(0.0, -depth, _POINTS)
        if depth == _DEEPEST:
            # One interval of constant rates to the end of any record.
            u = np.append(u, -_FAR)
        rates = law.rates(np.exp(u), parameters)
        # Rates at amplitudes that the record does not reach are not restricted.
        reached = int(np.argmin(np.append(rates.decay > 0.0, False)))
        if reached < 2 or not np.all(np.isfinite(rates.angular)):
            return None
        u, rates = u[:reached], rates.first(reached)
        time = _integral(u, 1.0 / rates.decay)
        if time[-1] >= end_s:
            return _Path(u, rates, time, rates.angular - float(rates.angular[-1]))
        if reached < _POINTS or depth == _DEEPEST:
            return None
        depth = min(_DEEPER * depth, _DEEPEST)
    return None


def _integral(u: FloatArray, values: FloatArray) -> FloatArray:
    """Integral from u to 0 of each column at each u."""
    step = -np.diff(u).reshape(-1, *(1,) * (values.ndim - 1))
    parts = np.cumsum(0.5 * (values[1:] + values[:-1]) * step, axis=0)
    return np.concatenate([np.zeros_like(values[:1]), parts])


def _between(columns: FloatArray, at: FloatArray) -> FloatArray:
    """Linear interpolation of each column at fractional rows."""
    row = np.minimum(at.astype(np.intp), columns.shape[0] - 2)
    share = (at - row)[:, None]
    return np.asarray(columns[row] * (1.0 - share) + columns[row + 1] * share)

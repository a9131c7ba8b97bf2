"""Damping and frequency that depend on the amplitude, and pairs of modes closer than the order selection resolves."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import cos, expm1, sin, sqrt

import numpy as np
from numba import njit
from numpy.typing import NDArray

from modal_id.data import FitData
from modal_id.fit.modal_fit import OWN_BAND, ModalFit, own_decay
from modal_id.fit.spectrum import CAUTION, ResidualSpectrum, power_spectrum, residual_spectrum
from modal_id.solve import (
    MOST_GROWTH,
    MOST_RATE_PER_SAMPLE,
    Beside,
    LinearSolution,
    ModeColumns,
    PoleFit,
    Problem,
    fit_poles,
    frequency_hz,
    gauss_newton,
    maximum,
    no_columns,
    normal_equations,
    objective,
    own_problem,
    real_columns,
    shortened,
    slope_weights,
    solve_linear,
    thinning,
)
from tracker import ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Pairs of close modes."""

    #: [decay times] length of the part of a record in which a mode is seen
    #: physics: It contains 99.8 % of the energy of the mode.
    decay_times: float = 3.0
    #: [1] amplitude over that of the other mode from which both of a pair count
    comparable: float = 0.25
    #: [1] score of what the amplitude-dependent mode leaves, below which no pair is needed
    #: statistics: The largest of 20 bins of noise. Without it, a mode of a public recording at 27.57 Hz has a damping
    #: ratio of 0.3 +- 58 %, by a pair that explains nothing more.
    least_misfit: float = 0.25


TUNING = Tuning()
DECAY_TIMES = TUNING.decay_times

# Samples of a block at whose beginning the integrals are kept.
_BLOCK = 4096


@dataclass(frozen=True)
class AmplitudeFit:
    """Fit of one mode with d ln a / dt = -(p0 + p2 a^power) and d phase / dt = p1 + p3 a^2.

    Attributes
    ----------
    problem : Problem
        To which it was fitted.
    parameters : array, shape (4,)
        p0, p1, p2, p3: p0 and p2 in 1/s, p1 and p3 in rad/s; a is 1 at the start of the fit.
    covariance : array, shape (4, 4)
        For white noise.
    linear : LinearSolution
        Of all modes, this one first with its amplitude dependence.
    slopes : DecayColumns, shape (n, 8)
        Real and imaginary part of the derivatives of the decay.
    weights : array, shape (k, 8, 4)
        From `slope_weights`: their effect on each channel.
    power : int
        1 (drag of the air) or 2 (the even dependence of a symmetric structure).
    """

    problem: Problem
    parameters: FloatArray
    covariance: FloatArray
    linear: LinearSolution
    slopes: DecayColumns
    weights: FloatArray
    power: int = 1


@dataclass(frozen=True)
class DecayColumns:
    """Real and imaginary parts of a decay's wave, shape (n, 2), or of its slopes, shape (n, 8), made row by row.

    ``states`` are the integrals at the beginning of each block of samples, shape (blocks, 7).
    """

    time_s: FloatArray
    parameters: FloatArray
    power: int
    states: FloatArray
    slopes: bool

    @property
    def shape(self) -> tuple[int, int]:
        """Of all columns."""
        return self.time_s.size, 8 if self.slopes else 2

    def __getitem__(self, rows: slice | NDArray[np.intp]) -> FloatArray:
        """Some rows of the columns."""
        if not isinstance(rows, slice):
            return self._some(rows)
        first, last, _ = rows.indices(self.time_s.size)
        block = first // _BLOCK
        begin = block * _BLOCK
        wave, slopes = _decay(self.time_s[begin:last], self.parameters, self.power, self.states[block].copy())
        return real_columns(slopes if self.slopes else wave[:, None])[first - begin :]

    def _some(self, rows: NDArray[np.intp]) -> FloatArray:
        """Rows anywhere, in any order."""
        found = np.empty((rows.size, self.shape[1]))
        blocks = rows // _BLOCK
        for block in np.unique(blocks).tolist():
            own = blocks == block
            found[own] = self[block * _BLOCK : (block + 1) * _BLOCK][rows[own] - block * _BLOCK]
        return found


def nonlinear_decay(
    time_s: FloatArray, parameters: FloatArray, power: int = 1
) -> tuple[DecayColumns, DecayColumns] | None:
    """``a(t) exp(i phase(t))`` of a mode for times from 0, and its derivatives with respect to p0 to p3.

    Parameters and power as in `AmplitudeFit`; None where the amplitude grows without bound, or is lost within a sample.

    Notes
    -----
    ``a^q = E / (1 + p2 (1 - E) / p0)``, ``E = exp(-q p0 t)``, solves ``da/dt = -(p0 + p2 a^q) a`` with a(0) = 1.
    """
    if np.any(-float(parameters[0]) * time_s[[0, -1]] > MOST_GROWTH):
        return None
    if float(parameters[0]) * (time_s[-1] - time_s[0]) > MOST_RATE_PER_SAMPLE * (time_s.size - 1):
        return None
    time_s, parameters = np.ascontiguousarray(time_s), np.asarray(parameters, dtype=float)
    state = np.zeros(7)
    state[6] = time_s[0]
    states = []
    for first in range(0, time_s.size, _BLOCK):
        states.append(state.copy())
        if not _decay(time_s[first : first + _BLOCK], parameters, power, state)[0].size:
            return None
    wave, slopes = (DecayColumns(time_s, parameters, power, np.array(states), one) for one in (False, True))
    return wave, slopes


@njit(cache=True, nogil=True, error_model="numpy")
def _decay(
    time_s: FloatArray, parameters: FloatArray, power: int, state: FloatArray
) -> tuple[ComplexArray, ComplexArray]:
    """Wave and slopes of `nonlinear_decay` from some sample on, integrals by the trapezoidal rule.

    Empty where the amplitude diverges. `state` holds the integrals of a^2, of a da/dp0 and of a da/dp2, then their
    integrands and the time, at the sample before; at the end those of the last sample.
    """
    p0, p1, p2, p3 = parameters
    n = time_s.size
    wave, slopes = np.empty(n, dtype=np.complex128), np.empty((n, 4), dtype=np.complex128)
    area, area_0, area_2, last, last_0, last_2, last_s = state
    for row in range(n):
        t = time_s[row]
        turns = power * t
        lost = -expm1(-p0 * turns)
        decay = 1.0 - lost
        exponential = abs(p0) * t > 1e-6
        grown = lost / p0 if exponential else turns
        grown_slope = (turns * decay - grown) / p0 if exponential else -0.5 * turns * turns
        denominator = 1.0 + p2 * grown
        if denominator <= 1e-6:
            return wave[:0], slopes[:0]
        a = decay / denominator if power == 1 else sqrt(decay / denominator)
        a_0 = -a * (t + p2 * grown_slope / (power * denominator))
        a_2 = -a * grown / (power * denominator)
        half = 0.5 * (t - last_s)
        area += half * (last + a * a)
        area_0 += half * (last_0 + a * a_0)
        area_2 += half * (last_2 + a * a_2)
        last, last_0, last_2, last_s = a * a, a * a_0, a * a_2, t
        phase = p1 * t + p3 * area
        rotation = complex(cos(phase), sin(phase))
        turned = 1j * a * rotation
        wave[row] = a * rotation
        slopes[row, 0] = (a_0 + 2j * p3 * a * area_0) * rotation
        slopes[row, 1] = t * turned
        slopes[row, 2] = (a_2 + 2j * p3 * a * area_2) * rotation
        slopes[row, 3] = area * turned
    # one by one: see `sim.beam.elastic`
    state[0], state[1], state[2] = area, area_0, area_2
    state[3], state[4], state[5], state[6] = last, last_0, last_2, last_s
    return wave, slopes


def fit_amplitude_dependence(
    problem: Problem, fit: PoleFit, mode: int, power: int = 1
) -> AmplitudeFit | None:
    """Least squares with one mode depending on its amplitude, the other poles held.

    None when the record does not determine the four parameters (too little decay, for example).
    """
    pole = fit.poles[mode]
    others = ModeColumns(problem.data.time_s, np.delete(fit.poles, mode))
    start = np.array([-pole.real, pole.imag, 0.0, 0.0])
    factor = thinning(problem.data.time_s, fit.poles[mode : mode + 1])
    if factor > 1:
        # Averages of neighbouring samples, other modes subtracted, give an inexpensive starting value.
        thin = own_problem(problem, fit, mode).thinned(factor)
        near = _gauss_newton(thin, no_columns(thin.data.time_s), start, power)
        start = start if near is None else near.parameters
    return _gauss_newton(problem, others, start, power)


def with_constant_pole(model: ModalFit, mode: int) -> ModalFit:
    """The fit of the record in which the mode with this index has the motion of its pole, the other modes fitted anew.

    What a constant pole leaves of a motion that depends on its amplitude lies beside weaker modes and moves them: one
    at 2.8 times the frequency by 10 standard deviations (seed 3269 of `benchmarks.records`). The better of both powers;
    the fit as it is where neither has one, or where a pole leaves the mode it stood for.
    """
    own, time_s = own_decay(model, mode), model.data.time_s
    fits = [fit_amplitude_dependence(own.problem, own.fit, 0, power) for power in (1, 2)]
    found = min((f for f in fits if f is not None), key=lambda f: float(np.sum(f.linear.rss)), default=None)
    decay = None if found is None else nonlinear_decay(time_s, found.parameters, found.power)
    if decay is None:
        return model
    others = ModeColumns(time_s, np.delete(model.fit.poles, mode))
    left = solve_linear(model.problem, Beside((decay[0], others))).residual
    data = replace(model.data, values=model.data.values - model.fit.linear.residual + left)
    problem = Problem(data, model.problem.sparse)
    fit = fit_poles(problem, model.fit.poles)
    same = np.abs(fit.poles - model.fit.poles) < OWN_BAND * np.abs(model.fit.poles)
    return replace(model, problem=problem, fit=fit) if fit.converged and np.all(same) else model


def _gauss_newton(
    problem: Problem, others: ModeColumns, start: FloatArray, power: int
) -> AmplitudeFit | None:
    def solved(parameters: FloatArray) -> _Solved | None:
        decay = nonlinear_decay(problem.data.time_s, parameters, power)
        if decay is None:
            return None
        return _Solved(parameters, solve_linear(problem, Beside((decay[0], others))), decay[1])

    def moved(now: _Solved, step: FloatArray) -> _Solved | None:
        before = objective(problem.data, now.linear)

        def trial(shorter: FloatArray) -> _Solved | None:
            one = solved(now.parameters + shorter)
            return one if one is not None and objective(problem.data, one.linear) < before else None

        return shortened(step, trial)

    best = maximum(solved(start), lambda now: normal_equations(problem, now.linear, *now.tangent()), moved)
    if best is None:
        return None
    found, covariance = best
    return AmplitudeFit(problem, found.parameters, covariance, found.linear, *found.tangent(), power)


@dataclass(frozen=True)
class _Solved:
    parameters: FloatArray
    linear: LinearSolution
    slopes: DecayColumns

    def tangent(self) -> tuple[DecayColumns, FloatArray]:
        first = np.broadcast_to(self.linear.amplitudes[0], (4, self.linear.amplitudes.shape[1]))
        return self.slopes, slope_weights(first, np.arange(4), np.ones(4, dtype=complex))


_GUESSES = (0.5, 1.0, 2.0, 4.0)


@dataclass(frozen=True)
class Split:
    """A pair of poles that fits better than one pole, with or without amplitude dependence.

    ``resolved`` when they beat within the record and their half-power bands do not overlap; otherwise the data cannot
    distinguish the pair from one mode with an unusual decay. ``strong`` are the poles as in `strong_poles`.
    """

    poles: ComplexArray
    resolved: bool
    strong: ComplexArray


def split_mode(problem: Problem, fit: PoleFit, mode: int, spectrum: ResidualSpectrum) -> Split | None:
    """The pair of close modes behind the fitted mode with this index, or None where one mode explains the data.

    `spectrum` is that of the residual of all modes.
    """
    frequency = float(frequency_hz(fit.poles)[mode])
    # The selection of the order covers the rest.
    half = max(OWN_BAND * frequency, 2.5 / problem.data.span_s)
    rate = abs(float(fit.poles[mode].real))
    if rate * problem.data.span_s > 4.0 * DECAY_TIMES:
        spectrum = _of_decay(problem.data, fit.linear, rate)
    if spectrum.misfit_score(frequency, half) < 1.0:
        return None
    pole = fit.poles[mode : mode + 1]
    alone = own_problem(problem, fit, mode)
    factor = thinning(alone.data.time_s, pole)
    alone = alone if factor < 2 else alone.thinned(factor)
    single = gauss_newton(alone, pole)
    pair = _best_pair(alone, pole[0], half)
    if pair is None:
        return None
    amplitude_fit = fit_amplitude_dependence(alone, single, 0)
    one = single.linear if amplitude_fit is None else amplitude_fit.linear
    if _of_decay(alone.data, one, rate).misfit_score(frequency, half) < TUNING.least_misfit:
        return None
    if not _better(alone, pair.linear, single.linear, frequency, 2) or not _better(
        alone, pair.linear, one, frequency, 2 if amplitude_fit is None else 0
    ):
        return None
    resolved = are_resolved(pair.poles, alone.data.span_s)
    return Split(pair.poles, resolved, strong_poles(pair.poles, pair.linear.amplitudes))


def _of_decay(data: FitData, linear: LinearSolution, rate_per_s: float) -> ResidualSpectrum:
    """Spectrum of the residual during the decay: noise long after the decay would hide its misfit."""
    part = data.rows(data.time_s < 2.0 * DECAY_TIMES / max(rate_per_s, 1e-300))
    return residual_spectrum(part, linear.residual[: part.time_s.size], linear.noise_variance)


def strong_poles(poles: ComplexArray, amplitudes: ComplexArray) -> ComplexArray:
    """Poles of the modes with at least a quarter of the largest amplitude; `amplitudes` has shape (m, k)."""
    size = np.max(np.abs(amplitudes), axis=1)
    return np.asarray(poles[size >= TUNING.comparable * np.max(size)])


def are_resolved(poles: ComplexArray, span_s: float) -> bool:
    """Whether two poles beat within the record and their half-power bands do not overlap.

    A mode with amplitude-dependent stiffness has, at its own frequency, a component that decays three times as fast:
    such a pair is one mode.
    """
    distance = abs(float(poles[0].imag - poles[1].imag))
    return bool(distance * span_s > 2.0 * np.pi and distance > np.sum(np.abs(poles.real)))


def _best_pair(alone: Problem, pole: complex, half_hz: float) -> PoleFit | None:
    centre = float(frequency_hz(pole))
    # In a record much longer than the decay, only the decay distinguishes frequencies.
    span = min(alone.data.span_s, DECAY_TIMES / max(abs(pole.real), 1e-300))
    strongest = _strongest_hz(alone, centre, half_hz)
    found: list[PoleFit] = []
    for middle in (centre, strongest):
        for guess in _GUESSES:
            offset_rad_s = 2.0 * np.pi * guess / span
            start = -1.0 / span + 2j * np.pi * middle + 1j * offset_rad_s * np.array([-1.0, 1.0])
            fit = gauss_newton(alone, start)
            if _is_plausible(fit, centre, half_hz):
                found.append(fit)
    return min(found, key=lambda fit: float(np.sum(fit.linear.rss)), default=None)


def _strongest_hz(alone: Problem, centre_hz: float, half_hz: float) -> float:
    data = alone.data
    frequency, power = power_spectrum(data.time_s, data.values, data.weights, np.ones(data.values.shape[1]))
    near = np.abs(frequency - centre_hz) < half_hz
    return float(frequency[near][np.argmax(power[near])]) if np.any(near) else centre_hz


def _is_plausible(fit: PoleFit, centre_hz: float, half_hz: float) -> bool:
    if not np.all(np.isfinite(fit.poles)) or fit.poles.size != 2:
        return False
    near = np.all(np.abs(frequency_hz(fit.poles) - centre_hz) < half_hz)
    return bool(near and np.all(fit.poles.real < 0.0))


def _better(
    alone: Problem, pair: LinearSolution, one: LinearSolution, frequency_hz: float, poles: int
) -> bool:
    """Whether the pair reduces chi-square, in units of the noise near the mode, by more than the criterion asks for."""
    data, k = alone.data, alone.data.values.shape[1]
    level = residual_spectrum(data, pair.residual, pair.noise_variance).level(frequency_hz) / k
    drop = float(np.sum((one.rss - pair.rss) / pair.noise_variance)) / max(level, 1e-300)
    return bool(drop > CAUTION * (2.0 * k + poles) * np.log(np.sum(data.counts)))

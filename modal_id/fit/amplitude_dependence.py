"""Damping and frequency that depend on the amplitude, and pairs of modes closer than the order selection resolves."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import cos, expm1, sin, sqrt

import numpy as np
from numba import njit
from numpy.typing import NDArray

from modal_id.data import FEW_VALUES, FitData
from modal_id.fit.modal_fit import OWN_BAND, ModalFit, own_decay
from modal_id.fit.spectrum import CAUTION, ResidualSpectrum, residual_spectrum
from modal_id.fit.subspace import close_poles
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
    #: [beats] least part of a beat of two modes that alone explain the record
    #: physics: From in phase to opposed. The sum of waves that turn less is that of a mode with dry friction.
    least_beat: float = 0.5
    #: [1] ratio of a frequency to that of a pair up to which other modes are fitted anew beside it
    #: physics: Twelve averages a cycle of the pair are more than two a cycle of these.
    beside: float = 5.0
    #: [1] score of what the amplitude-dependent mode leaves, below which no pair is needed
    #: statistics: The largest of 20 bins of noise. Without it, a mode of a public recording at 27.57 Hz has a damping
    #: ratio of 0.3 +- 58 %, by a pair that explains nothing more.
    least_misfit: float = 0.25
    #: [1] score of what a pair leaves, from which it is not known to be two modes
    #: measurement: True pairs of ten to a hundred cycles leave .05 to .33; invented ones of pendulums with friction .7.
    explained: float = 0.4


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
    """Real and imaginary parts of a decay's wave, shape (n, 2), or of its slopes, shape (n, 8).

    Held for all samples where they are few; otherwise made for some rows when these are needed.

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
        if self.shape[1] * self.time_s.size <= FEW_VALUES:
            return self._all[rows]
        return self._made(rows) if isinstance(rows, slice) else self._some(rows)

    @cached_property
    def _all(self) -> FloatArray:
        """All rows, where they are few enough to be held."""
        return self._made(slice(None))

    def _made(self, rows: slice) -> FloatArray:
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
        thin = own_problem(problem, fit, np.array([mode])).thinned(factor)
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
    hz, pole = frequency_hz(fit.poles), complex(fit.poles[mode])
    near = float(hz[mode]), _reach_hz(float(hz[mode]), problem.data.span_s)
    if -pole.real * problem.data.span_s > 4.0 * DECAY_TIMES:
        spectrum = _of_decay(problem.data, fit.linear, pole)
    if spectrum.misfit_score(*near) < 1.0:
        return None
    # What one mode leaves of a pair moves those beside it, which must be fitted anew with the pair.
    beside = np.flatnonzero((hz < TUNING.beside * hz[mode]) & (np.arange(hz.size) != mode))
    modes = np.append(mode, beside)
    several = own_problem(problem, fit, modes)
    factor = thinning(several.data.time_s, fit.poles[[mode]])
    several = several if factor < 2 else several.thinned(factor)
    data, single = several.data, gauss_newton(several, fit.poles[modes])
    pair = _best_pair(several, single)
    if pair is None or not _better(several, pair.linear, single.linear, near[0], 2):
        return None
    one = single.linear
    for power in (1, 2):
        law = fit_amplitude_dependence(several, single, 0, power)
        if law is None:
            continue
        if _of_decay(data, law.linear, pole).misfit_score(*near) < TUNING.least_misfit:
            return None
        if not _better(several, pair.linear, law.linear, near[0], 0):
            return None
        one = min(one, law.linear, key=lambda linear: objective(data, linear))
    two = pair.poles[:2]
    # A pair that leaves misfit, as one does of a motion with dry friction, is not known to be two modes.
    explains = _of_decay(data, pair.linear, pole).misfit_score(*near) < TUNING.explained
    resolved = explains and (are_resolved(two, data.span_s) or only_two_explain(data, pair, one, pole))
    return Split(two, resolved, strong_poles(two, pair.linear.amplitudes[:2]))


def _reach_hz(frequency: float, span_s: float) -> float:
    """Distance from a mode within which another may have been taken for it; the search for lines finds the rest."""
    return max(OWN_BAND * frequency, 2.5 / span_s)


def _of_decay(data: FitData, linear: LinearSolution, pole: complex) -> ResidualSpectrum:
    """Spectrum of the residual during the decay: noise long after the decay would hide its misfit."""
    part = data.rows(data.time_s < 2.0 * DECAY_TIMES / max(abs(pole.real), 1e-300))
    return residual_spectrum(part, linear.residual[: part.time_s.size], linear.noise_variance)


def only_two_explain(data: FitData, two: PoleFit, one: LinearSolution, pole: complex) -> bool:
    """Whether two modes of half a beat, which come first, leave nothing but noise near a pole, and one leaves more."""
    hz = float(frequency_hz(pole))
    near = hz, _reach_hz(hz, data.span_s)
    left = [_of_decay(data, linear, pole).misfit_score(*near) for linear in (two.linear, one)]
    # What one mode leaves is mostly the other.
    chi_square = [float(np.sum(fit.rss / two.linear.noise_variance)) for fit in (one, two.linear)]
    explain = left[0] < TUNING.explained and left[1] >= 1.0 and chi_square[0] > 2.0 * chi_square[1]
    return explain and are_resolved(two.poles[:2], data.span_s, TUNING.least_beat)


def strong_poles(poles: ComplexArray, amplitudes: ComplexArray) -> ComplexArray:
    """Poles of the modes with at least a quarter of the largest amplitude; `amplitudes` has shape (m, k)."""
    size = np.max(np.abs(amplitudes), axis=1)
    return np.asarray(poles[size >= TUNING.comparable * np.max(size)])


def are_resolved(poles: ComplexArray, span_s: float, beats: float = 1.0) -> bool:
    """Whether two poles beat within the record and their half-power bands do not overlap.

    A mode with amplitude-dependent stiffness has, at its own frequency, a component that decays three times as fast:
    such a pair is one mode.
    """
    distance = abs(float(poles[0].imag - poles[1].imag))
    return bool(distance * span_s > 2.0 * np.pi * beats and distance > np.sum(np.abs(poles.real)))


def _best_pair(several: Problem, single: PoleFit) -> PoleFit | None:
    """The best fit with two modes, which come first, in place of the first; None where none is plausible.

    Started at poles from the subspace of the values of which two, and one for each other mode, lie nearest to it.
    """
    hz, data, count = frequency_hz(single.poles), several.data, single.poles.size
    values = data.values - single.linear.baseline
    # One mode of a pair may lie on either side of what was taken for it.
    reach_hz = np.array([2.0 * _reach_hz(one, data.span_s) for one in hz.tolist()])
    found = []
    for waves in close_poles(replace(data, values=values), hz, 2 * count + 2)[count:]:
        # A start that grows by more overflows.
        poles = waves[waves.real * data.span_s < MOST_GROWTH]
        distance = np.abs(frequency_hz(poles)[:, None] - hz)
        nearest = np.argmin(distance, axis=1)
        nearest[np.min(distance, axis=1) > reach_hz[nearest]] = -1
        if np.count_nonzero(nearest == 0) != 2:
            continue
        others = [_nearest(poles[nearest == mode], single.poles[mode]) for mode in range(1, count)]
        fit = gauss_newton(several, np.append(poles[nearest == 0], others))
        two = fit.poles[:2]
        # None may grow by more than its errors.
        decays = np.all(two.real < 2.0 * fit.pole_sd[:2, 0])
        if decays and np.all(np.abs(frequency_hz(two) - hz[0]) < reach_hz[0]):
            found.append(fit)
    return min(found, key=lambda fit: objective(data, fit.linear), default=None)


def _nearest(poles: ComplexArray, fitted: complex) -> complex:
    """That of the poles which lies nearest to the fitted one, which it is where there are none."""
    return complex(poles[np.argmin(np.abs(poles - fitted))]) if poles.size else fitted


def _better(
    alone: Problem, pair: LinearSolution, one: LinearSolution, frequency_hz: float, poles: int
) -> bool:
    """Whether the pair reduces chi-square, in units of the noise near the mode, by more than the criterion asks for."""
    data, k = alone.data, alone.data.values.shape[1]
    level = residual_spectrum(data, pair.residual, pair.noise_variance).level(frequency_hz) / k
    drop = float(np.sum((one.rss - pair.rss) / pair.noise_variance)) / max(level, 1e-300)
    return bool(drop > CAUTION * (2.0 * k + poles) * np.log(np.sum(data.counts)))

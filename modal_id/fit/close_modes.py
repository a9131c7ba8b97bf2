"""Two modes nearer to each other than the order selection looks, told from one whose damping depends on amplitude."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modal_id.fit.amplitude import fit_amplitude_dependence
from modal_id.fit.decay import frequency_hz
from modal_id.fit.linear import FitData, LinearSolution, Problem
from modal_id.fit.spectrum import line_score, local_level, power_spectrum
from modal_id.fit.varpro import PoleFit, gauss_newton, mode_functions, thinning
from tracker.arrays import ComplexArray

# How far from the one mode, relative to its frequency, a pair is looked for; beyond, the order selection finds it.
_REACH = 0.04
_ITERATIONS = 30
# Half distances of the first guesses, in bins.
_GUESSES = (0.5, 1.0, 2.0, 4.0)
_LEAST_AMPLITUDE = 0.01
# The criterion asks p log(n); a quarter more, because several starts were tried.
_CAUTION = 1.25


@dataclass(frozen=True)
class Split:
    """A pair of poles that fits better than one, bent or not.

    ``resolved`` when they beat within the record and their half-power bands do not overlap; otherwise the data cannot
    tell such a pair from one mode with an unusual decay.
    """

    poles: ComplexArray
    resolved: bool


def split_mode(problem: Problem, fit: PoleFit, mode: int) -> Split | None:
    """The pair of close modes behind one fitted mode, or None where one explains the data.

    Parameters
    ----------
    problem : Problem
    fit : PoleFit
    mode : int
        Index into ``fit.poles``.
    """
    frequency = float(frequency_hz(fit.poles)[mode])
    half = max(_REACH * frequency, 2.5 / problem.data.span_s)
    linear = fit.linear
    if line_score(problem.data, linear.residual, linear.noise_variance, frequency, half) < 1.0:
        return None
    alone = _alone(problem, fit, mode)
    pole = fit.poles[mode : mode + 1]
    single = gauss_newton(alone, pole, _ITERATIONS)
    pair = _best_pair(alone, pole[0], half)
    if pair is None:
        return None
    bent = fit_amplitude_dependence(alone, single, 0)
    one = single.linear if bent is None else bent.linear
    if not _better(alone, pair.linear, single.linear, frequency, 2) or not _better(
        alone, pair.linear, one, frequency, 2 if bent is None else 0
    ):
        return None
    return Split(pair.poles, are_resolved(pair.poles, alone.data.span_s))


def are_resolved(poles: ComplexArray, span_s: float) -> bool:
    """Whether two poles beat within the record and their half-power bands do not overlap.

    A motion whose stiffness depends on the amplitude holds, at its own frequency, a part that decays three times as
    fast: such a pair is one mode.
    """
    distance = abs(float(poles[0].imag - poles[1].imag))
    return bool(distance * span_s > 2.0 * np.pi and distance > np.sum(np.abs(poles.real)))


def _alone(problem: Problem, fit: PoleFit, mode: int) -> Problem:
    """The mode's own motion with what no mode explains, neighbouring samples averaged."""
    data, pole = problem.data, fit.poles[mode : mode + 1]
    own = np.real(mode_functions(data.time_s, pole) @ fit.linear.amplitudes[mode : mode + 1])
    values = np.where(data.weights > 0.0, fit.linear.residual + own, 0.0)
    alone = Problem(FitData(data.time_s, values, data.weights), problem.baseline)
    factor = thinning(data.time_s, pole)
    return alone if factor < 2 else alone.thinned(factor)


def _best_pair(alone: Problem, pole: complex, half_hz: float) -> PoleFit | None:
    span, centre = alone.data.span_s, float(frequency_hz(pole))
    strongest = _strongest_hz(alone, centre, half_hz)
    found: list[PoleFit] = []
    for middle in (centre, strongest):
        for guess in _GUESSES:
            away = 2.0 * np.pi * guess / span
            start = -1.0 / span + 2j * np.pi * middle + 1j * away * np.array([-1.0, 1.0])
            fit = gauss_newton(alone, start, _ITERATIONS)
            if _sane(fit, centre, half_hz):
                found.append(fit)
    return min(found, key=lambda fit: float(np.sum(fit.linear.rss)), default=None)


def _strongest_hz(alone: Problem, centre_hz: float, half_hz: float) -> float:
    data = alone.data
    frequency, power = power_spectrum(data.time_s, data.values, data.weights, np.ones(data.values.shape[1]))
    near = np.abs(frequency - centre_hz) < half_hz
    return float(frequency[near][np.argmax(power[near])]) if np.any(near) else centre_hz


def _sane(fit: PoleFit, centre_hz: float, half_hz: float) -> bool:
    if not np.all(np.isfinite(fit.poles)) or fit.poles.size != 2:
        return False
    size = np.max(np.abs(fit.linear.amplitudes), axis=1)
    near = np.all(np.abs(frequency_hz(fit.poles) - centre_hz) < half_hz)
    return bool(near and np.all(fit.poles.real < 0.0) and np.min(size) > _LEAST_AMPLITUDE * np.max(size))


def _better(
    alone: Problem, pair: LinearSolution, one: LinearSolution, frequency_hz: float, poles: int
) -> bool:
    """Whether the pair lowers chi-square, in units of the noise near the mode, by more than its parameters cost."""
    data, k = alone.data, alone.data.values.shape[1]
    bins, power = power_spectrum(data.time_s, pair.residual, data.weights, pair.noise_variance)
    level = local_level(power, k)[np.argmin(np.abs(bins - frequency_hz))] / k
    drop = float(np.sum((one.rss - pair.rss) / pair.noise_variance)) / max(float(level), 1e-300)
    return bool(drop > _CAUTION * (2.0 * k + poles) * np.log(np.sum(data.counts)))

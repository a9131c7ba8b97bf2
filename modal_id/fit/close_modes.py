"""Pairs of modes closer than the order selection resolves, distinguished from amplitude-dependent damping."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modal_id.data import FitData
from modal_id.fit.amplitude_dependence import fit_amplitude_dependence
from modal_id.fit.spectrum import ResidualSpectrum, power_spectrum, residual_spectrum
from modal_id.solve import LinearSolution, PoleFit, Problem, frequency_hz, gauss_newton, own_problem, thinning
from tracker import ComplexArray


@dataclass(frozen=True)
class Tuning:
    """Pairs of close modes."""

    #: [1] distance from the fitted mode, over its frequency, within which a pair is tried
    #: convention: The selection of the order covers the rest.
    reach: float = 0.04
    #: [1] largest number of iterations of the fit of a pair
    iterations: int = 30
    #: [decay times] time that sets half the distance of the starting values where the record is longer
    decay_times: float = 3.0
    #: [1] amplitude of a second mode over the first below which there is no pair
    least_amplitude: float = 0.01
    #: [1] amplitude over that of the other mode from which both of a pair count
    comparable: float = 0.25
    #: [1] score of what the amplitude-dependent mode leaves, below which no pair is needed
    #: statistics: The largest of 20 bins of noise.
    least_misfit: float = 0.25
    #: [1] factor on p log(n) of the information criterion for a pair
    #: convention: 25 % more, because several starting values are tried.
    caution: float = 1.25


TUNING = Tuning()

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
    half = max(TUNING.reach * frequency, 2.5 / problem.data.span_s)
    rate = abs(float(fit.poles[mode].real))
    if rate * problem.data.span_s > 4.0 * TUNING.decay_times:
        spectrum = _of_decay(problem.data, fit.linear, rate)
    if spectrum.misfit_score(frequency, half) < 1.0:
        return None
    pole = fit.poles[mode : mode + 1]
    alone = own_problem(problem, fit, mode)
    factor = thinning(alone.data.time_s, pole)
    alone = alone if factor < 2 else alone.thinned(factor)
    single = gauss_newton(alone, pole, TUNING.iterations)
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
    part = data.rows(data.time_s < 2.0 * TUNING.decay_times / max(rate_per_s, 1e-300))
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
    span = min(alone.data.span_s, TUNING.decay_times / max(abs(pole.real), 1e-300))
    strongest = _strongest_hz(alone, centre, half_hz)
    found: list[PoleFit] = []
    for middle in (centre, strongest):
        for guess in _GUESSES:
            offset_rad_s = 2.0 * np.pi * guess / span
            start = -1.0 / span + 2j * np.pi * middle + 1j * offset_rad_s * np.array([-1.0, 1.0])
            fit = gauss_newton(alone, start, TUNING.iterations)
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
    size = np.max(np.abs(fit.linear.amplitudes), axis=1)
    near = np.all(np.abs(frequency_hz(fit.poles) - centre_hz) < half_hz)
    return bool(
        near and np.all(fit.poles.real < 0.0) and np.min(size) > TUNING.least_amplitude * np.max(size)
    )


def _better(
    alone: Problem, pair: LinearSolution, one: LinearSolution, frequency_hz: float, poles: int
) -> bool:
    """Whether the pair reduces chi-square, in units of the noise near the mode, by more than the criterion asks for."""
    data, k = alone.data, alone.data.values.shape[1]
    level = residual_spectrum(data, pair.residual, pair.noise_variance).level(frequency_hz) / k
    drop = float(np.sum((one.rss - pair.rss) / pair.noise_variance)) / max(level, 1e-300)
    return bool(drop > TUNING.caution * (2.0 * k + poles) * np.log(np.sum(data.counts)))

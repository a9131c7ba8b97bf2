"""The instant at which steady shaking stops suddenly, to a fraction of a sample.

In modal coordinates relative to the base, ``eta'' + 2 zeta omega eta' + omega^2 eta = -Gamma b''``. While the base
moves as ``b = Re(B exp(i W (t - T)))`` each mode follows in the steady state, ``eta = Re(H B exp(i W (t - T)))`` with
``H = Gamma W^2 / (omega^2 - W^2 + 2 i zeta omega W)``. When the base stops dead at T it holds the place b(T), and its
velocity b'(T) goes as an impulse ``Gamma b'(T)`` into every mode: eta is continuous, eta' jumps, all modes ring. Then
each decays freely. A channel sees ``b + sum_r phi_r eta_r``, all real shapes: phases, the place of rest and the modes
rung by the stop all tell the same T. A force on the structure that ends is the same without base and impulse.

Where a recording does not bear that out (the base coasts, shapes are complex, a hum is among the lines), a looser model
stands in: a sinusoid before, free decays after, of any amplitude and phase, each channel's displacement continuous.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.stats import chi2

from modal_id.fit.linear import FitData
from modal_id.onset.piecewise import Kink, Solution, descend, solve
from modal_id.onset.stop_mechanics import FALSE_ALARM, MISFIT, mechanical_models
from modal_id.onset.stop_search import searched
from modal_id.onset.stop_shapes import joined_shape, unpacked_poles
from modal_id.onset.stop_spread import (
    RIVAL_CHI_SQUARE,
    Instant,
    envelope_sd,
    mean_square,
    memory,
    mixed,
    spread,
)
from tracker.arrays import BoolArray, ComplexArray, FloatArray

How = Literal["base", "force", "joined"]

_OUTLIER = 5.0
_MIN_CYCLES = 3.0
# Rows on either side that a fit is asked to hold: more bring little and cost much.
_MAX_ROWS = 5000
_MAX_SHORTENINGS = 5
# Theory and measurement within this factor (its logarithm) are one mode; what a mode too weak to be seen is damped by
# matters little.
_SAME_MODE = 0.15
_WEAK_DAMPING = 0.003
# No base stops in no time: a stop of a tenth of a cycle is counted with its middle uncertain by a tenth of that.
_STOP_CYCLES = 0.01


@dataclass(frozen=True)
class Stop:
    """Instant of the stop with its standard deviation, in the data's time.

    Attributes
    ----------
    time_s, sd_s : float
        The instant, the middle of a stop that takes its time, and its standard deviation: of the posterior, with a
        hundredth of a cycle for what a stop differs from a sudden one.
    misfit : float
        Mean square of the residual over that of the noise, the larger of the two sides; 1 where the model holds.
    how : str
        "base": a base that stopped dead and rang every mode, as mechanics asks. "force": a force on the structure that
        ended, the base at rest. "joined": neither fits; sinusoid and decays that join without a jump.
    rung_hz : tuple of float
        Undamped frequencies of the modes that ring after the stop.
    """

    time_s: float
    sd_s: float
    misfit: float
    how: How
    rung_hz: tuple[float, ...]


def locate_stop(
    data: FitData,
    variance: FloatArray,
    time_s: float,
    sd_s: float,
    drive_hz: float,
    poles: ComplexArray,
    base: BoolArray,
    expected_hz: tuple[float, ...] = (),
) -> Stop | None:
    """Refine the instant at which the shaking stops.

    Parameters
    ----------
    data : FitData
        With driven motion and decay.
    variance : array, shape (k,)
        Noise variance of a sample of weight 1, from a fit to the decay alone.
    time_s, sd_s : float
        Instant and standard deviation as known so far.
    drive_hz : float
        Frequency of the shaking.
    poles : complex array, shape (m,)
        Of the decay, the shaken mode among them.
    base : bool array, shape (k,)
        Channels that follow the base itself, to which the others are relative. All false where there is none: then
        every channel is taken as seen from outside.
    expected_hz : tuple of float
        Frequencies of modes that theory knows: those that are too weak to be found still move with the base.

    Returns
    -------
    Stop or None
        None when no window around the instant holds three cycles of the drive on either side.

    Notes
    -----
    The standard deviation is multiplied by the square root of the sum of the residual's autocorrelation, so that
    noise with memory is not taken for many independent samples.
    """
    before_s, after_s = time_s - float(data.time_s[0]), float(data.time_s[-1]) - time_s
    least = _MIN_CYCLES / drive_hz
    found: Stop | None = None
    for _ in range(_MAX_SHORTENINGS):
        if min(before_s, after_s) < least:
            break
        window = _rows(data, time_s - before_s, time_s + after_s, time_s)
        start = _packed(time_s, 2.0 * np.pi * drive_hz, _shaken_first(poles, drive_hz))
        outcome = _located(window, variance, start, sd_s, base, _weak(poles, expected_hz))
        if outcome is None:
            break
        candidate, sides = outcome
        if found is None or candidate.misfit < found.misfit:
            found = candidate
        if max(sides) < MISFIT:
            break
        # The side that fits worse is the one that is not what the model says all along.
        if sides[0] > sides[1]:
            before_s *= 0.5
        else:
            after_s *= 0.5
    return found


def _rows(data: FitData, begin_s: float, end_s: float, stop_s: float) -> FitData:
    rows = np.flatnonzero((data.time_s >= begin_s) & (data.time_s <= end_s))
    middle = int(np.searchsorted(data.time_s[rows], stop_s))
    rows = rows[max(middle - _MAX_ROWS, 0) : middle + _MAX_ROWS]
    return FitData(data.time_s[rows], data.values[rows], data.weights[rows].copy())


def _shaken_first(poles: ComplexArray, drive_hz: float) -> ComplexArray:
    shaken = int(np.argmin(np.abs(np.abs(poles) / (2.0 * np.pi) - drive_hz)))
    return np.concatenate([poles[[shaken]], np.delete(poles, shaken)])


def _weak(poles: ComplexArray, expected_hz: tuple[float, ...]) -> ComplexArray:
    """Poles of expected modes that are not among those found."""
    found = np.abs(poles) / (2.0 * np.pi)
    missing = [f for f in expected_hz if np.min(np.abs(np.log(found / f))) > _SAME_MODE]
    return np.asarray(2.0 * np.pi * np.array(missing, dtype=float) * complex(-_WEAK_DAMPING, 1.0))


def _packed(time_s: float, drive_rad_s: float, poles: ComplexArray) -> FloatArray:
    return np.concatenate([[time_s, drive_rad_s], np.column_stack([poles.real, poles.imag]).ravel()])


def _located(
    data: FitData, variance: FloatArray, start: FloatArray, sd_s: float, base: BoolArray, weak: ComplexArray
) -> tuple[Stop, tuple[float, float]] | None:
    step = float(np.median(np.diff(data.time_s)))
    scale = np.full(start.size, 1.0 / max(data.span_s, 1e-300))
    scale[0] = step
    trend = True
    loose = Kink(data, variance, joined_shape(data.time_s, trend=trend), np.zeros(base.size), scale)
    loose = replace(loose, stride=max(3.0, 0.2 / (float(start[1]) * step)))
    # A cycle either way: neighbouring cycles look alike.
    reach = 4.0 * max(sd_s, envelope_sd(loose, start)) + max(5.0 * step, 2.0 * np.pi / float(start[1]))
    best = searched(loose, start, reach)
    if best is None:
        return None
    loose = replace(loose, data=_without_outliers(data, best))
    best = descend(loose, best)
    # A trend takes half of what the place of rest tells: it is kept only where there is one.
    steady = replace(loose, shape=joined_shape(data.time_s, trend=False))
    without = solve(steady, best.nonlinear)
    if without is not None:
        without = descend(steady, without)
        gain = (without.chi_square - best.chi_square) / max(best.chi_square / data.weights.size, 1.0)
        trend = gain > float(chi2.isf(FALSE_ALARM, base.size))
        if not trend:
            loose, best = steady, without
    strict = mechanical_models(loose, best, base, reach, weak, trend=trend)
    kink, solution = (strict[0].kink, strict[0].solution) if strict else (loose, best)
    after = data.time_s >= solution.nonlinear[0]
    sides = mean_square(kink, solution, ~after), mean_square(kink, solution, after)
    inflation = max(*sides, 1.0) * memory(kink, solution)
    instants = [spread(kink, solution, inflation, reach, sudden=bool(strict))]
    for other in strict[1:]:
        behind = other.solution.chi_square - solution.chi_square
        if behind < RIVAL_CHI_SQUARE * inflation:
            own = spread(other.kink, other.solution, inflation, reach, sudden=True)
            away = float(other.solution.nonlinear[0] - solution.nonlinear[0])
            instants.append(Instant(away, own.sd_s, own.weight * float(np.exp(-0.5 * behind / inflation))))
    when, sd = mixed(instants, data.span_s)
    sd = float(np.hypot(sd, _STOP_CYCLES * 2.0 * np.pi / float(solution.nonlinear[1])))
    rung = np.sort(np.abs(unpacked_poles(best.nonlinear[2:]))) / (2.0 * np.pi)
    how: How = "joined" if not strict else "base" if strict[0].kick else "force"
    stop = Stop(float(solution.nonlinear[0]) + when, sd, max(sides), how, tuple(float(f) for f in rung))
    return stop, sides


def _without_outliers(data: FitData, solution: Solution) -> FitData:
    scaled = np.abs(solution.residual) * np.sqrt(data.weights)
    used = data.weights > 0.0
    typical = [
        1.4826 * float(np.median(column[good])) if np.any(good) else 1.0
        for column, good in zip(scaled.T, used.T, strict=True)
    ]
    kept = np.where(scaled > _OUTLIER * np.maximum(typical, 1e-300), 0.0, data.weights)
    return FitData(data.time_s, data.values, kept)

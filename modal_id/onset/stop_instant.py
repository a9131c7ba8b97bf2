"""Instant at which steady shaking stops suddenly, to a fraction of a sample.

In modal coordinates relative to the base, ``eta'' + 2 zeta omega eta' + omega^2 eta = -Gamma b''``. While the base
moves as ``b = Re(B exp(i W (t - T)))`` each mode follows in the steady state, ``eta = Re(H B exp(i W (t - T)))`` with
``H = Gamma W^2 / (omega^2 - W^2 + 2 i zeta omega W)``. When the base stops abruptly at T it stays at b(T), and every
mode receives an impulse ``Gamma b'(T)``: eta is continuous, eta' jumps, all modes are excited and then decay freely. A
channel measures ``b + sum_r phi_r eta_r`` with real shapes phi: phases, rest position and the amplitudes of the excited
modes all depend on the same T. A force on the structure that ends is the same without base motion and impulse.

Where a recording does not agree with this (the base coasts, shapes are complex, one of the lines is a hum), a looser
model is used: a sinusoid before, free decays after, of any amplitude and phase, displacement continuous.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.stats import chi2

from modal_id.data.outliers import beyond_limit
from modal_id.data.samples import FitData
from modal_id.onset.piecewise_fit import PiecewiseProblem, descend, search_instant, solve
from modal_id.onset.stop_models import FALSE_ALARM, MISFIT, joined_model, mechanical_models, unpacked_poles
from modal_id.onset.stop_uncertainty import (
    RIVAL_CHI_SQUARE,
    Instant,
    correlation_inflation,
    envelope_sd,
    mean_square,
    mixed,
    spread,
)
from tracker.arrays import BoolArray, ComplexArray, FloatArray

How = Literal["base", "force", "joined"]

_MIN_CYCLES = 3.0
# Rows used on either side: more add little and cost much.
_MAX_ROWS = 5000
_MAX_SHORTENINGS = 5
# A theoretical and an identified frequency within this logarithmic ratio belong to one mode. The damping assumed for
# undetected modes matters little.
_SAME_MODE = 0.15
_WEAK_DAMPING = 0.003
# A real stop takes some time: for a tenth of a cycle, its middle is uncertain by a tenth of that.
_STOP_CYCLES = 0.01


@dataclass(frozen=True)
class Stop:
    """Instant of the stop with its standard deviation, in the data's time.

    Attributes
    ----------
    time_s, sd_s : float
        The instant (middle of a stop of finite duration) and its posterior standard deviation, which includes a
        hundredth of a cycle for the duration of the stop.
    misfit : float
        Mean square residual relative to the noise variance, the larger of the two sides; 1 where the model holds.
    how : str
        "base": the base stopped abruptly and excited every mode. "force": a force on the structure ended while the base
        was at rest. "joined": neither fits; sinusoid and free decays joined without a jump.
    excited_hz : tuple of float
        Undamped frequencies of the modes present after the stop.
    """

    time_s: float
    sd_s: float
    misfit: float
    how: How
    excited_hz: tuple[float, ...]


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
        Noise variance of a sample with weight 1, from a fit to the decay only.
    time_s, sd_s : float
        Approximate instant and its standard deviation.
    drive_hz : float
        Frequency of the shaking.
    poles : complex array, shape (m,)
        Of the decay, including the excited mode.
    base : bool array, shape (k,)
        Channels of the base itself, to which the others are relative. All False where there is none: then every
        channel is taken in the frame of the camera.
    expected_hz : tuple of float
        Theoretical frequencies: modes too weak to be identified still respond to the base.

    Returns
    -------
    Stop or None
        None when no window around the instant contains three cycles of the drive on either side.

    Notes
    -----
    The standard deviation is multiplied by the square root of the sum of the residual's autocorrelation, so that
    correlated noise is not counted as independent samples.
    """
    before_s, after_s = time_s - float(data.time_s[0]), float(data.time_s[-1]) - time_s
    least = _MIN_CYCLES / drive_hz
    found: Stop | None = None
    for _ in range(_MAX_SHORTENINGS):
        if min(before_s, after_s) < least:
            break
        window = _rows(data, time_s - before_s, time_s + after_s, time_s)
        start = _packed(time_s, 2.0 * np.pi * drive_hz, _excited_first(poles, drive_hz))
        outcome = _located(window, variance, start, sd_s, base, _weak(poles, expected_hz))
        if outcome is None:
            break
        candidate, sides = outcome
        if found is None or candidate.misfit < found.misfit:
            found = candidate
        if max(sides) < MISFIT:
            break
        # Shorten the side that fits worse.
        if sides[0] > sides[1]:
            before_s *= 0.5
        else:
            after_s *= 0.5
    return found


def _rows(data: FitData, begin_s: float, end_s: float, stop_s: float) -> FitData:
    rows = np.flatnonzero((data.time_s >= begin_s) & (data.time_s <= end_s))
    middle = int(np.searchsorted(data.time_s[rows], stop_s))
    rows = rows[max(middle - _MAX_ROWS, 0) : middle + _MAX_ROWS]
    return data.rows(rows)


def _excited_first(poles: ComplexArray, drive_hz: float) -> ComplexArray:
    excited = int(np.argmin(np.abs(np.abs(poles) / (2.0 * np.pi) - drive_hz)))
    return np.concatenate([poles[[excited]], np.delete(poles, excited)])


def _weak(poles: ComplexArray, expected_hz: tuple[float, ...]) -> ComplexArray:
    """Poles of theoretical modes that were not identified."""
    found = np.abs(poles) / (2.0 * np.pi)
    missing = [f for f in expected_hz if np.min(np.abs(np.log(found / f))) > _SAME_MODE]
    return np.asarray(2.0 * np.pi * np.array(missing, dtype=float) * complex(-_WEAK_DAMPING, 1.0))


def _packed(time_s: float, drive_rad_s: float, poles: ComplexArray) -> FloatArray:
    return np.concatenate([[time_s, drive_rad_s], np.column_stack([poles.real, poles.imag]).ravel()])


def _located(
    data: FitData, variance: FloatArray, start: FloatArray, sd_s: float, base: BoolArray, weak: ComplexArray
) -> tuple[Stop, tuple[float, float]] | None:
    step = data.step_s
    scale = np.full(start.size, 1.0 / max(data.span_s, 1e-300))
    scale[0] = step
    trend = True
    loose = PiecewiseProblem(
        data, variance, joined_model(data.time_s, trend=trend), np.zeros(base.size), scale
    )
    loose = replace(loose, stride=max(3.0, 0.2 / (float(start[1]) * step)))
    # At least a cycle either way, because neighbouring cycles look alike.
    reach = 4.0 * max(sd_s, envelope_sd(loose, start)) + max(5.0 * step, 2.0 * np.pi / float(start[1]))
    best = search_instant(loose, start, reach)
    if best is None:
        return None
    loose = replace(loose, data=_without_outliers(data, best.residual))
    best = descend(loose, best)
    # A trend absorbs half of the information in the rest position: it is kept only where it is significant.
    steady = replace(loose, model=joined_model(data.time_s, trend=False))
    without = solve(steady, best.nonlinear)
    if without is not None:
        without = descend(steady, without)
        gain = (without.chi_square - best.chi_square) / max(best.chi_square / data.weights.size, 1.0)
        trend = gain > float(chi2.isf(FALSE_ALARM, base.size))
        if not trend:
            loose, best = steady, without
    strict = mechanical_models(loose, best, base, reach, weak, trend=trend)
    problem, solution = (strict[0].problem, strict[0].solution) if strict else (loose, best)
    after = data.time_s >= solution.nonlinear[0]
    sides = mean_square(problem, solution, ~after), mean_square(problem, solution, after)
    inflation = max(*sides, 1.0) * correlation_inflation(problem, solution)
    instants = [spread(problem, solution, inflation, reach, sudden=bool(strict))]
    for other in strict[1:]:
        behind = other.solution.chi_square - solution.chi_square
        if behind < RIVAL_CHI_SQUARE * inflation:
            own = spread(other.problem, other.solution, inflation, reach, sudden=True)
            away = float(other.solution.nonlinear[0] - solution.nonlinear[0])
            instants.append(Instant(away, own.sd_s, own.weight * float(np.exp(-0.5 * behind / inflation))))
    when, sd = mixed(instants, data.span_s)
    sd = float(np.hypot(sd, _STOP_CYCLES * 2.0 * np.pi / float(solution.nonlinear[1])))
    excited = np.sort(np.abs(unpacked_poles(best.nonlinear[2:]))) / (2.0 * np.pi)
    how: How = "joined" if not strict else "base" if strict[0].base_stops else "force"
    stop = Stop(float(solution.nonlinear[0]) + when, sd, max(sides), how, tuple(float(f) for f in excited))
    return stop, sides


def _without_outliers(data: FitData, residual: FloatArray) -> FitData:
    return FitData(
        data.time_s, data.values, np.where(beyond_limit(data.weights, residual), 0.0, data.weights)
    )

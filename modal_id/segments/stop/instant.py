"""Instant at which steady shaking stops: a sinusoid before, free decays after, displacement continuous.

Amplitudes and phases before and after are free, so that the model holds for a base that stops abruptly or coasts, and
for a force that ends. Nonlinear parameters: instant, drive frequency in rad/s, (Re, Im) of each pole.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from modal_id.data import FitData, beyond_limit
from modal_id.segments.stop.change_point import DrivenThenFree
from modal_id.segments.stop.piecewise_fit import PiecewiseProblem, descend, search_instant, solve
from modal_id.segments.stop.uncertainty import correlation_inflation, envelope_sd, mean_square, posterior_sd
from modal_id.solve import PoleFit, frequency_hz, real_columns
from tracker import ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """The instant of the stop."""

    #: [1] probability that noise alone shows a stop
    #: statistics: One record in a hundred.
    false_alarm: float = 0.01
    #: [1] mean square residual of a side over the noise above which less of it is used
    #: convention: The shaking is not steady, or the decay not free, throughout.
    misfit: float = 1.2
    #: [cycles] least length of a side
    min_cycles: float = 3.0
    #: [samples] largest number of samples on either side
    #: convention: More add little and cost much.
    max_rows: int = 2000
    #: [1] largest number of times that a side is shortened
    max_shortenings: int = 5
    #: [cycles] sd of the middle of a real stop
    #: physics: A stop that takes a tenth of a cycle is uncertain by a tenth of that.
    stop_cycles: float = 0.01


TUNING = Tuning()


@dataclass(frozen=True)
class Stop:
    """Instant of the stop (the middle of a stop of finite duration) in the data's time, and what it follows from.

    ``sd_s`` includes a hundredth of a cycle for the duration of the stop. ``misfit`` is the mean square residual
    relative to the noise variance before and after the stop; 1 where the model holds. ``excited_hz`` are the undamped
    frequencies of the modes present after the stop.
    """

    time_s: float
    sd_s: float
    misfit: tuple[float, float]
    excited_hz: tuple[float, ...]


def locate_stop(data: FitData, change: DrivenThenFree, decay: PoleFit) -> Stop | None:
    """Refine the instant at which the shaking stops, given the approximate instant and the fit of the decay.

    None when no window around the instant contains three cycles of the drive on either side.

    Notes
    -----
    The standard deviation is multiplied by the square root of the sum of the residual's autocorrelation, so that
    correlated noise is not counted as independent samples.
    """
    time_s, drive_hz, poles = change.time_s, change.drive_hz, decay.poles
    excited = int(np.argmin(np.abs(frequency_hz(poles) - drive_hz)))
    poles = np.concatenate([poles[[excited]], np.delete(poles, excited)])
    start = np.array([time_s, 2.0 * np.pi * drive_hz, *np.column_stack([poles.real, poles.imag]).ravel()])
    before_s, after_s = time_s - float(data.time_s[0]), float(data.time_s[-1]) - time_s
    least = TUNING.min_cycles / drive_hz
    found: Stop | None = None
    for _ in range(TUNING.max_shortenings):
        if min(before_s, after_s) < least:
            break
        window = _rows(data, time_s - before_s, time_s + after_s, time_s)
        candidate = _located(window, decay.linear.noise_variance, start, change.sd_s)
        if candidate is None:
            break
        if found is None or max(candidate.misfit) < max(found.misfit):
            found = candidate
        if max(candidate.misfit) < TUNING.misfit:
            break
        # Shorten the side that fits worse.
        if candidate.misfit[0] > candidate.misfit[1]:
            before_s *= 0.5
        else:
            after_s *= 0.5
    return found


def _rows(data: FitData, begin_s: float, end_s: float, stop_s: float) -> FitData:
    rows = np.flatnonzero((data.time_s >= begin_s) & (data.time_s <= end_s))
    middle = int(np.searchsorted(data.time_s[rows], stop_s))
    rows = rows[max(middle - TUNING.max_rows, 0) : middle + TUNING.max_rows]
    return data.rows(rows)


def _located(data: FitData, variance: FloatArray, start: FloatArray, sd_s: float) -> Stop | None:
    step = data.step_s
    scale = np.full(start.size, 1.0 / max(data.span_s, 1e-300))
    scale[0] = step
    stride = max(3.0, 0.2 / (float(start[1]) * step))
    problem = PiecewiseProblem(data, variance, _joined_model(data.time_s, trend=True), scale, stride)
    # At least a cycle either way, because neighbouring cycles look alike.
    reach = 4.0 * max(sd_s, envelope_sd(problem, start)) + max(5.0 * step, 2.0 * np.pi / float(start[1]))
    best = search_instant(problem, start, reach)
    if best is None:
        return None
    weights = np.where(beyond_limit(data.weights, best.residual), 0.0, data.weights)
    problem = replace(problem, data=replace(data, weights=weights))
    best = descend(problem, best)
    # A trend absorbs half of the information in the rest position: it is kept only where it is significant.
    steady = replace(problem, model=_joined_model(data.time_s, trend=False))
    without = solve(steady, best.nonlinear)
    if without is not None:
        without = descend(steady, without)
        gain = (without.chi_square - best.chi_square) / max(best.chi_square / data.weights.size, 1.0)
        if gain <= float(chdtri(variance.size, TUNING.false_alarm)):
            problem, best = steady, without
    after = data.time_s >= best.nonlinear[0]
    sides = mean_square(problem, best, ~after), mean_square(problem, best, after)
    inflation = max(*sides, 1.0) * correlation_inflation(problem, best)
    sd = posterior_sd(problem, best, inflation, reach)
    sd = float(np.hypot(sd, TUNING.stop_cycles * 2.0 * np.pi / float(best.nonlinear[1])))
    excited = np.sort(frequency_hz(_unpacked_poles(best.nonlinear)))
    return Stop(float(best.nonlinear[0]), sd, sides, tuple(excited.tolist()))


def _unpacked_poles(nonlinear: FloatArray) -> ComplexArray:
    return np.asarray(nonlinear[2::2] + 1j * nonlinear[3::2])


def _joined_model(time_s: FloatArray, *, trend: bool) -> Callable[[FloatArray], FloatArray]:
    """Sinusoid, then free decays: amplitudes and phases free, displacement continuous."""

    def model(nonlinear: FloatArray) -> FloatArray:
        stop, drive, poles = float(nonlinear[0]), float(nonlinear[1]), _unpacked_poles(nonlinear)
        since = time_s - stop
        after = since >= 0.0
        free = np.where(after[:, None], _decays(np.maximum(since, 0.0), poles), 0.0)
        columns = real_columns(free)
        # Continuity determines the in-phase part of the excited mode.
        tied = columns[:, 0].copy()
        columns[:, 2::2] -= tied[:, None]
        age = np.minimum(time_s, stop) - time_s[0]
        on = real_columns(_decays(age, poles[:1]))
        on[after] *= tied[after][:, None]
        driven = np.where(after, tied, np.cos(drive * since))
        quadrature = np.where(after, 0.0, np.sin(drive * since))
        offset = np.where(after, 1.0 - tied, 0.0)
        slow = [np.ones(since.size), since / max(float(np.ptp(since)), 1e-300)][: 1 + trend]
        return np.column_stack([*slow, driven, quadrature, on, columns[:, 1:], offset])

    return model


def _decays(time_s: FloatArray, poles: ComplexArray) -> ComplexArray:
    """``exp(lambda t)``, with growth bounded so that a diverging pole gives a large misfit instead of an overflow."""
    growth = np.minimum(time_s[:, None] * poles.real, 50.0)
    return np.asarray(np.exp(growth + 1j * time_s[:, None] * poles.imag))

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

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from modal_id.kink import Kink, Shape, Solution, bounds, descend, instant_sd, scan, solve
from modal_id.linear import FitData, real_columns

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
BoolArray = NDArray[np.bool_]
How = Literal["base", "force", "joined"]

_OUTLIER = 5.0
_MIN_CYCLES = 3.0
# Rows on either side that a fit is asked to hold: more bring little and cost much.
_MAX_ROWS = 5000
# A side whose residual exceeds the noise by more than this is not steady (or not one decay) all along: less of it is
# used.
_MISFIT = 1.2
_MAX_SHORTENINGS = 5
_COARSE_POINTS = 300
_POINTS_A_CYCLE = 24.0
_MINIMA = 3
_RIVALS = 5
_RIVAL_CHI_SQUARE = 12.0
# What a descent from a minimum of the scan may still gain.
_HOPELESS = 300.0
_FIRST_STEPS = 3
_FALSE_ALARM = 0.01
# Theory and measurement within this factor (its logarithm) are one mode; what a mode too weak to be seen is damped by
# matters little.
_SAME_MODE = 0.15
_WEAK_DAMPING = 0.003
# No base stops in no time: a stop of a tenth of a cycle is counted with its middle uncertain by a tenth of that.
_STOP_CYCLES = 0.01
_FREQUENCY_DOUBT = 0.03
# Share of the base's velocity in the shaken mode at the marker that moves most, for first guesses: 1.57, 0.87, 0.51,
# 0.36, 0.28 for a cantilever's modes at the tip.
_GUESSES = (1.2, 0.4)


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
        if max(sides) < _MISFIT:
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


def _poles(nonlinear: FloatArray) -> ComplexArray:
    return np.asarray(nonlinear[0::2] + 1j * nonlinear[1::2])


def _located(
    data: FitData, variance: FloatArray, start: FloatArray, sd_s: float, base: BoolArray, weak: ComplexArray
) -> tuple[Stop, tuple[float, float]] | None:
    step = float(np.median(np.diff(data.time_s)))
    scale = np.full(start.size, 1.0 / max(data.span_s, 1e-300))
    scale[0] = step
    trend = True
    loose = Kink(data, variance, _loose(data.time_s, trend=trend), np.zeros(base.size), scale)
    loose = replace(loose, stride=max(3.0, 0.2 / (float(start[1]) * step)))
    # A cycle either way: neighbouring cycles look alike.
    reach = 4.0 * max(sd_s, _envelope_sd(loose, start)) + max(5.0 * step, 2.0 * np.pi / float(start[1]))
    best = _searched(loose, start, reach)
    if best is None:
        return None
    loose = replace(loose, data=_without_outliers(data, best))
    best = descend(loose, best)
    # A trend takes half of what the place of rest tells: it is kept only where there is one.
    steady = replace(loose, shape=_loose(data.time_s, trend=False))
    without = solve(steady, best.nonlinear)
    if without is not None:
        without = descend(steady, without)
        gain = (without.chi_square - best.chi_square) / max(best.chi_square / data.weights.size, 1.0)
        trend = gain > float(chi2.isf(_FALSE_ALARM, base.size))
        if not trend:
            loose, best = steady, without
    strict = _strict(loose, best, base, reach, weak, trend=trend)
    kink, solution = (strict[0].kink, strict[0].solution) if strict else (loose, best)
    after = data.time_s >= solution.nonlinear[0]
    sides = _mean_square(kink, solution, ~after), _mean_square(kink, solution, after)
    inflation = max(*sides, 1.0) * _memory(kink, solution)
    instants = [_spread(kink, solution, inflation, reach, sudden=bool(strict))]
    for other in strict[1:]:
        behind = other.solution.chi_square - solution.chi_square
        if behind < _RIVAL_CHI_SQUARE * inflation:
            own = _spread(other.kink, other.solution, inflation, reach, sudden=True)
            away = float(other.solution.nonlinear[0] - solution.nonlinear[0])
            instants.append(_Instant(away, own.sd_s, own.weight * float(np.exp(-0.5 * behind / inflation))))
    when, sd = _mixed(instants, data.span_s)
    sd = float(np.hypot(sd, _STOP_CYCLES * 2.0 * np.pi / float(solution.nonlinear[1])))
    rung = np.sort(np.abs(_poles(best.nonlinear[2:]))) / (2.0 * np.pi)
    how: How = "joined" if not strict else "base" if strict[0].kick else "force"
    stop = Stop(float(solution.nonlinear[0]) + when, sd, max(sides), how, tuple(float(f) for f in rung))
    return stop, sides


def _envelope_sd(loose: Kink, start: FloatArray) -> float:
    """Standard deviation of the instant at which the decay's envelope meets the steady amplitude, all phases aside."""
    at = solve(loose, start)
    if at is None:
        return 0.0
    rate = max(-float(start[2]), 1e-300)
    data = loose.data
    before = float(np.count_nonzero(data.time_s < start[0]))
    after = min(data.time_s.size - before, 0.5 / (rate * float(loose.scale[0])))
    power = float(np.sum((at.coefficients[2] ** 2 + at.coefficients[3] ** 2) / loose.variance))
    relative = 2.0 / max(power, 1e-300) * (1.0 / max(before, 1.0) + 4.0 / max(after, 1.0))
    return min(float(np.sqrt(relative)) / rate, 0.25 * data.span_s)


@dataclass(frozen=True)
class _Instant:
    """A local best instant after the best one, its standard deviation, and its posterior mass but for a factor."""

    after_s: float
    sd_s: float
    weight: float


def _mixed(instants: list[_Instant], longest_s: float) -> tuple[float, float]:
    weight = np.array([one.weight for one in instants])
    place = np.array([one.after_s for one in instants])
    own = np.array([one.sd_s for one in instants])
    if not np.sum(weight) > 0.0:
        return 0.0, longest_s
    weight = weight / np.sum(weight)
    # The instant stays at one of the candidates: between two of them it is certainly not.
    best = int(np.argmax(weight))
    square = float(np.sum(weight * (own**2 + (place - place[best]) ** 2)))
    return float(place[best]), min(float(np.sqrt(square)), longest_s)


def _spread(kink: Kink, best: Solution, inflation: float, reach_s: float, *, sudden: bool) -> _Instant:
    """Standard deviation of the instant about the best one, other cycles that fit nearly as well counted in."""
    move = _moved if sudden else _at
    starts = [move(best.nonlinear, t) for t in _instants(kink, best.nonlinear, reach_s)]
    near = scan(kink, starts, _RIVALS)
    limit = best.chi_square + _RIVAL_CHI_SQUARE * inflation
    hopeless = best.chi_square + _HOPELESS * inflation
    rivals = [descend(kink, one, _FIRST_STEPS) for one in near if one.chi_square < hopeless]
    instants: list[_Instant] = []
    for one in [best, *rivals]:
        away = float(one.nonlinear[0] - best.nonlinear[0])
        if one.chi_square > limit or any(abs(away - i.after_s) < 0.2 * kink.scale[0] for i in instants):
            continue
        own = instant_sd(kink, one) * float(np.sqrt(inflation))
        weight = own * float(np.exp(-0.5 * (one.chi_square - best.chi_square) / inflation))
        instants.append(_Instant(away, own, weight))
    return _Instant(0.0, _about_best(instants, kink.data.span_s), float(np.sum([i.weight for i in instants])))


def _about_best(instants: list[_Instant], longest_s: float) -> float:
    weight = np.array([one.weight for one in instants])
    if not np.sum(weight) > 0.0:
        return longest_s
    square = np.array([one.sd_s**2 + one.after_s**2 for one in instants])
    return min(float(np.sqrt(np.sum(weight * square) / np.sum(weight))), longest_s)


def _at(nonlinear: FloatArray, instant_s: float) -> FloatArray:
    return np.concatenate([[instant_s], nonlinear[1:]])


def _searched(kink: Kink, start: FloatArray, reach_s: float) -> Solution | None:
    starts = [_at(start, instant) for instant in _instants(kink, start, reach_s)]
    return _lowest([descend(kink, one, _FIRST_STEPS) for one in scan(kink, starts, _MINIMA)])


def _instants(kink: Kink, start: FloatArray, reach_s: float) -> FloatArray:
    low, high = bounds(kink, start[0] - reach_s, start[0] + reach_s)
    finest = 2.0 * (high - low) / float(kink.scale[0])
    per_cycle = _POINTS_A_CYCLE * (high - low) * float(start[1]) / (2.0 * np.pi)
    return np.linspace(low, high, int(min(max(9.0, min(finest, per_cycle)), _COARSE_POINTS)))


def _lowest(solutions: list[Solution]) -> Solution | None:
    return min(solutions, key=lambda s: s.chi_square, default=None)


def _loose(time_s: FloatArray, *, trend: bool) -> Callable[[FloatArray], Shape]:
    """Sinusoid, then decays: amplitudes and phases free, displacement continuous."""

    def shape(nonlinear: FloatArray) -> Shape:
        stop, drive, poles = float(nonlinear[0]), float(nonlinear[1]), _poles(nonlinear[2:])
        since = time_s - stop
        after = since >= 0.0
        free = np.where(after[:, None], _decays(np.maximum(since, 0.0), poles), 0.0)
        columns = real_columns(free)
        # The shaken mode's part in phase is what continuity leaves no choice of.
        tied = columns[:, 0].copy()
        columns[:, 2::2] -= tied[:, None]
        age = np.minimum(time_s, stop) - time_s[0]
        on = real_columns(_decays(age, poles[:1]))
        on[after] *= tied[after][:, None]
        driven = np.where(after, tied, np.cos(drive * since))
        quadrature = np.where(after, 0.0, np.sin(drive * since))
        moved = np.where(after, 1.0 - tied, 0.0)
        slow = _slow(since, trend=trend)
        return Shape(
            np.column_stack([slow, driven, quadrature, on, columns[:, 1:], moved]), np.zeros(since.size)
        )

    return shape


def _decays(time_s: FloatArray, poles: ComplexArray) -> ComplexArray:
    """``exp(lambda t)``; a pole on the way to nowhere grows without overflow, so that its misfit turns it back."""
    growth = np.minimum(time_s[:, None] * poles.real, 50.0)
    return np.asarray(np.exp(growth + 1j * time_s[:, None] * poles.imag))


def _slow(since: FloatArray, *, trend: bool) -> FloatArray:
    columns = [np.ones(since.size), since / max(float(np.ptp(since)), 1e-300)]
    return np.column_stack(columns[: 1 + trend])


def _stopped_dead(
    time_s: FloatArray, weak: ComplexArray, *, kick: bool, trend: bool, unseen: bool
) -> Callable[[FloatArray], Shape]:
    """The mechanics of the module's docstring; nonlinear: instant, drive, Re B, Im B, poles.

    Without `kick` a force on the structure ends instead: the base is at rest all along and no velocity jumps; B stands
    for the force. With `unseen`, each channel has a part that moves with the base before the stop: modes far from the
    drive that are too weak to be seen follow it in phase or against it.
    """

    def shape(nonlinear: FloatArray) -> Shape:
        stop, drive = float(nonlinear[0]), float(nonlinear[1])
        poles = np.concatenate([_poles(nonlinear[4:]), weak])
        amplitude = complex(nonlinear[2], nonlinear[3])
        since = time_s - stop
        after = since >= 0.0
        wave = np.exp(1j * drive * np.minimum(since, 0.0))
        base = np.real(amplitude * wave)
        velocity = (1j * drive * amplitude).real if kick else 0.0
        own = np.abs(poles) ** 2
        steady = amplitude * drive**2 / (own - drive**2 - 2j * poles.real * drive)
        place, speed = steady.real, (1j * drive * steady).real + velocity
        ringing = place - 1j * (speed - poles.real * place) / poles.imag
        late = np.maximum(since, 0.0)
        free = np.real(_decays(late, poles) * ringing)
        # The phase of a mode whose frequency only theory tells is soon unknown: its mean over that doubt fades.
        doubt = _FREQUENCY_DOUBT * np.abs(weak) * late[:, None]
        free[:, poles.size - weak.size :] *= np.exp(-0.5 * np.minimum(doubt, 30.0) ** 2)
        columns = [_slow(since, trend=trend), np.where(after[:, None], free, np.real(wave[:, None] * steady))]
        if unseen:
            columns.append(np.where(after, 0.0, base)[:, None])
        return Shape(np.column_stack(columns), base)

    return shape


@dataclass(frozen=True)
class _Strict:
    """A mechanical model that the data allow."""

    kink: Kink
    solution: Solution
    kick: bool


def _strict(
    loose: Kink, best: Solution, base: BoolArray, reach_s: float, weak: ComplexArray, *, trend: bool
) -> list[_Strict]:
    """Mechanical models that fit as well as their fewer parameters let expect: base stopped, force ended."""
    noise = max(best.chi_square / np.count_nonzero(loose.data.weights), 1.0)
    if noise > _MISFIT:
        # Where even free amplitudes and phases do not fit, a stricter model is no better founded for failing likewise.
        return []
    for unseen in (False, True):
        allowed = []
        for kick, gains in ((True, _gains(base)), (False, [np.zeros(base.size)])):
            shape = _stopped_dead(loose.data.time_s, weak, kick=kick, trend=trend, unseen=unseen)
            found = _mechanical(replace(loose, shape=shape), best, gains, reach_s, trend=trend)
            if found is None:
                continue
            fewer = best.coefficients.size - found[1].coefficients.size - 2
            worse = (found[1].chi_square - best.chi_square) / noise
            if worse < float(chi2.isf(_FALSE_ALARM, max(fewer, 1))):
                allowed.append(_Strict(*found, kick))
        if allowed:
            return sorted(allowed, key=lambda one: one.solution.chi_square)
    return []


def _gains(base: BoolArray) -> list[FloatArray]:
    """How the base's motion enters the channels: a reference that stands still follows no base."""
    if np.any(base):
        return [np.where(base, 1.0, 0.0), np.where(base, 0.0, 1.0)]
    return [np.ones(base.size)]


def _mechanical(
    model: Kink, best: Solution, gains: list[FloatArray], reach_s: float, *, trend: bool
) -> tuple[Kink, Solution] | None:
    found = []
    for gain in gains:
        for amplitude in _amplitudes(model, best, gain, trend=trend):
            size = abs(amplitude)
            scale = np.concatenate([model.scale[:2], [size, size], model.scale[2:]])
            kink = replace(model, gain=gain, scale=scale)
            pair = np.array([amplitude.real, amplitude.imag])
            first = solve(kink, np.concatenate([best.nonlinear[:2], pair, best.nonlinear[2:]]))
            if first is not None:
                found.append((kink, descend(kink, first, _FIRST_STEPS)))
    if not found:
        return None
    kink, solution = min(found, key=lambda pair: pair[1].chi_square)
    # The same drive, stopped sooner or later: where the looser model cannot tell one cycle from the next, this can.
    starts = [_moved(solution.nonlinear, t) for t in _instants(kink, solution.nonlinear, reach_s)]
    near = [one for one in scan(kink, starts, _MINIMA) if one.chi_square < solution.chi_square + _HOPELESS]
    others = [descend(kink, one, _FIRST_STEPS) for one in near]
    lowest = _lowest([solution, *others])
    return None if lowest is None else (kink, descend(kink, lowest))


def _moved(nonlinear: FloatArray, instant_s: float) -> FloatArray:
    amplitude = complex(nonlinear[2], nonlinear[3]) * np.exp(1j * nonlinear[1] * (instant_s - nonlinear[0]))
    return np.concatenate([[instant_s, nonlinear[1], amplitude.real, amplitude.imag], nonlinear[4:]])


def _amplitudes(loose: Kink, best: Solution, gain: FloatArray, *, trend: bool) -> list[complex]:
    """First guesses of the base's complex amplitude at the stop."""
    coefficients = best.coefficients
    driven = coefficients[1 + trend] - 1j * coefficients[2 + trend]
    if np.any(gain == 0.0) and np.any(gain == 1.0):
        return [complex(np.mean(driven[gain == 1.0]))]
    drive, pole = float(best.nonlinear[1]), complex(_poles(best.nonlinear[2:4])[0])
    response = drive**2 / (abs(pole) ** 2 - drive**2 - 2j * pole.real * drive)
    loudest = int(np.argmax(np.abs(driven) ** 2 / loose.variance))
    return [
        complex(driven[loudest] / (1.0 + sign * share * response)) for share in _GUESSES for sign in (1, -1)
    ]


def _without_outliers(data: FitData, solution: Solution) -> FitData:
    scaled = np.abs(solution.residual) * np.sqrt(data.weights)
    used = data.weights > 0.0
    typical = [
        1.4826 * float(np.median(column[good])) if np.any(good) else 1.0
        for column, good in zip(scaled.T, used.T, strict=True)
    ]
    kept = np.where(scaled > _OUTLIER * np.maximum(typical, 1e-300), 0.0, data.weights)
    return FitData(data.time_s, data.values, kept)


def _mean_square(kink: Kink, solution: Solution, rows: BoolArray) -> float:
    weight = kink.data.weights[rows] / kink.variance
    freedom = 0.5 * solution.coefficients.size
    count = max(np.count_nonzero(weight) - freedom, 1.0)
    return float(np.sum(weight * solution.residual[rows] ** 2) / count)


def _memory(kink: Kink, solution: Solution) -> float:
    """Sum of the residual's autocorrelation up to where it dies out, at least 1: what memory does to a mean."""
    scaled = solution.residual * np.sqrt(kink.data.weights / kink.variance)
    power = float(np.sum(scaled**2))
    total = 1.0
    for lag in range(1, min(200, scaled.shape[0] // 4)):
        rho = float(np.sum(scaled[lag:] * scaled[:-lag])) / max(power, 1e-300)
        if rho < 2.0 / np.sqrt(scaled.size):
            break
        total += 2.0 * rho
    return total

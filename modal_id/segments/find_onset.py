"""Start of the free decay within a piece of the record: the end of steady shaking, a release, or its first sample.

The end of shaking with its sd: a sinusoid before, free decays after, displacement continuous. Amplitudes and phases
before and after are free, so that the model holds for a base that stops abruptly or coasts, and for a force that ends.
Nonlinear parameters: instant, drive frequency in rad/s, (Re, Im) of each pole.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from modal_id.data import FitData, beyond_limit, detrended, without_spikes
from modal_id.fit import find_modes
from modal_id.record import Onset
from modal_id.segments.change_point import (
    FIRST_STEPS,
    ChangeSearch,
    DrivenThenFree,
    PiecewiseFit,
    PiecewiseProblem,
    descend,
    driven_then_free,
    instant_sd,
    scan,
    search_instant,
    solve,
)
from modal_id.segments.events import Event
from modal_id.sentences import Note, in_hz
from modal_id.solve import PoleFit, frequency_hz, real_columns
from tracker import BoolArray, ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """The instant of the stop, competing instants, and the begin of the fit."""

    #: [1] increase of chi-square up to which another instant competes
    #: statistics: A probability of 5e-4 for one instant.
    competing: float = 12.0
    #: [1] the same, before the instant is refined
    competing_before_descent: float = 300.0
    #: [1] largest number of competing instants that are followed
    #: convention: Limits the computing time.
    most_competing: int = 5
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
    #: [1] longest delay of the fit after the onset, over the time that remains
    max_settle_fraction: float = 0.1
    #: [decay times] delay of the fit after a release where decay times are shorter than a cycle
    settle_decay_times: float = 0.3
    #: [1] probability from which an onset counts as known
    #: statistics: 95 %.
    likely: float = 0.95
    #: [1] largest number of modes that a release excites
    max_excited: int = 8


TUNING = Tuning()


def envelope_sd(problem: PiecewiseProblem, start: FloatArray) -> float:
    """Standard deviation of the instant where the envelope of the decay meets the steady amplitude, without phases."""
    at = solve(problem, start)
    if at is None:
        return 0.0
    rate = max(-float(start[2]), 1e-300)
    data = problem.data
    before = float(np.count_nonzero(data.time_s < start[0]))
    after = min(data.time_s.size - before, 0.5 / (rate * float(problem.scale[0])))
    power = float(np.sum((at.coefficients[2] ** 2 + at.coefficients[3] ** 2) / problem.variance))
    relative = 2.0 / max(power, 1e-300) * (1.0 / max(before, 1.0) + 4.0 / max(after, 1.0))
    return min(float(np.sqrt(relative)) / rate, 0.25 * data.span_s)


def posterior_sd(problem: PiecewiseProblem, best: PiecewiseFit, inflation: float, reach_s: float) -> float:
    """Standard deviation of the instant about the best one, including other cycles that fit nearly as well.

    `inflation` is the factor on the noise variance for misfit and autocorrelation.
    """
    limit = best.chi_square + TUNING.competing_before_descent * inflation
    near = scan(problem, best.nonlinear, reach_s, TUNING.most_competing)
    rivals = [descend(problem, one, FIRST_STEPS) for one in near if one.chi_square < limit]
    distances: list[float] = []
    mass, square = 0.0, 0.0
    for one in [best, *rivals]:
        offset_s = float(one.nonlinear[0] - best.nonlinear[0])
        excess = one.chi_square - best.chi_square
        if excess > TUNING.competing * inflation or any(
            abs(offset_s - d) < 0.2 * problem.scale[0] for d in distances
        ):
            continue
        distances.append(offset_s)
        # Where both curves touch (a force that ends) the instant has no first-order effect, and the linear value is far
        # too large: other instants of one cycle are competing minima, if they fit.
        radian_s = 1.0 / abs(float(one.nonlinear[1]))
        own = min(instant_sd(problem, one) * float(np.sqrt(inflation)), radian_s)
        weight = own * float(np.exp(-0.5 * excess / inflation))
        mass += weight
        square += weight * (own**2 + offset_s**2)
    longest = problem.data.span_s
    return min(float(np.sqrt(square / mass)), longest) if mass > 0.0 else longest


def mean_square(problem: PiecewiseProblem, solution: PiecewiseFit, rows: BoolArray) -> float:
    """Mean square residual of some rows relative to the noise variance, per degree of freedom."""
    weight = problem.data.weights[rows] / problem.variance
    dof = 0.5 * solution.coefficients.size
    count = max(np.count_nonzero(weight) - dof, 1.0)
    return float(np.sum(weight * solution.residual[rows] ** 2) / count)


def correlation_inflation(problem: PiecewiseProblem, solution: PiecewiseFit) -> float:
    """Sum of the residual's autocorrelation up to where it vanishes, at least 1: factor on the variance of a mean."""
    scaled = solution.residual * np.sqrt(problem.data.weights / problem.variance)
    power = float(np.sum(scaled**2))
    total = 1.0
    for lag in range(1, min(200, scaled.shape[0] // 4)):
        rho = float(np.sum(scaled[lag:] * scaled[:-lag])) / max(power, 1e-300)
        if rho < 2.0 / np.sqrt(scaled.size):
            break
        total += 2.0 * rho
    return total


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


def user_onset(time_s: float) -> Onset:
    """Onset given by the user, without uncertainty."""
    return Onset(time_s, 0.0, time_s, "user", 1.0, Note.USER_ONSET())


def record_start(time_s: float) -> Onset:
    """Onset of a record, or a piece, that is a decay from its first sample on."""
    return Onset(time_s, float("nan"), time_s, "record start", 1.0, Note.RECORD_START())


def no_onset(note: str) -> Onset:
    """No free decay; the note says why."""
    return Onset(0.0, float("nan"), 0.0, "none", 0.0, note)


def settling_s(frequency_hz: float, step_s: float, onset_sd_s: float, remaining_s: float) -> float:
    """Time between a stop and the first sample used in the fit.

    A cycle (three samples where that is longer) and three standard deviations of the onset, at most a tenth of the
    remaining record.
    """
    delay_s = max(1.0 / frequency_hz, 3.0 * step_s) + 3.0 * onset_sd_s
    return min(delay_s, TUNING.max_settle_fraction * remaining_s)


def drive_then_decay(
    data: FitData, variance: FloatArray, frequency: float, base: BoolArray, place: ChangeSearch
) -> DrivenThenFree | None:
    """Where steady shaking ends and a free decay follows; None where the data show no such change.

    `data` hold the channels and, where the mask `base` is True, those of the moving base, to which the others are
    relative; `variance` is the noise variance of all of them, `place` that of a change that may be the end.
    Times are relative to `data`.
    """
    change = driven_then_free(data.channels(~base), variance[~base], frequency, place)
    return None if change is None or change.probability <= TUNING.likely else change


def stop_of_shaking(
    data: FitData, change: DrivenThenFree, frequency: float, lowest_hz: float, base: BoolArray
) -> Onset:
    """Onset where steady shaking ends, at about a known time; the other arguments as of `drive_then_decay`."""
    step, last = data.step_s, float(data.time_s[-1])
    begin = change.time_s + settling_s(frequency, step, change.sd_s, last - change.time_s)
    decay = find_modes(data.from_time(begin), TUNING.max_excited, lowest_hz or 0.5 * change.drive_hz)
    stop = None if decay is None else locate_stop(data, change, decay.fit)
    when, sd = (change.time_s, change.sd_s) if stop is None else (stop.time_s, stop.sd_s)
    fit_from = when + settling_s(frequency, step, sd, last - when)
    located = Note.BY_CHANGE()
    if stop is not None:
        located = (Note.BY_FITS_WITH_BASE if np.any(base) else Note.BY_FITS)(hz=in_hz(stop.excited_hz))
    late_s, cycles = fit_from - when, (fit_from - when) * frequency
    note = Note.STOP(hz=change.drive_hz, stop_s=when, sd_s=sd, located=located, late_s=late_s, cycles=cycles)
    return Onset(when, sd, fit_from, "model", change.probability, note)


def release_onset(
    data: FitData, variance: FloatArray, frequency_hz: float, event: Event, end_s: float
) -> Onset:
    """Onset at a pluck or a blow: the largest deflection within the event; times relative to `data`.

    An event without duration is the onset. Within a longer one, modes that die out soon follow the release.
    """
    rows = np.flatnonzero((data.time_s >= event.start_s) & (data.time_s <= event.end_s))
    values = np.abs(detrended(data)[rows]) * (data.weights[rows] > 0.0) / np.sqrt(variance)
    released_s = float(data.time_s[rows[np.argmax(np.max(values, axis=1))]]) if rows.size else event.end_s
    fit_from = max(released_s + _after_event(frequency_hz, event, end_s - released_s), event.end_s)
    note = Note.RELEASE(time_s=released_s, settling_s=fit_from - released_s)
    return Onset(released_s, event.sd_s, fit_from, "peak", 1.0, note)


def continued_onset(event: Event) -> Onset:
    """Onset after a click or a step of the baseline, where a free motion goes on."""
    note = Note.INTERRUPTION(start_s=event.start_s, end_s=event.end_s)
    return Onset(event.start_s, float("nan"), event.end_s, "interruption", 1.0, note)


def from_largest_deflection(data: FitData) -> Onset | None:
    """Onset at the largest deflection from the final position, of a motion that falls from there to less than half.

    For records of so few cycles that no envelope shows the release; times relative to `data`.
    """
    data = without_spikes(data)
    last = data.rows(slice(int(0.75 * data.time_s.size), None))
    if not np.all(last.counts > 0.0):
        return None
    final = np.array([np.median(v[w > 0.0]) for v, w in zip(last.values.T, last.weights.T, strict=True)])
    scale = np.sqrt(np.sum(data.weights * (data.values - final) ** 2, axis=0) / data.counts)
    size = np.max((data.weights > 0.0) * np.abs(data.values - final) / np.maximum(scale, 1e-300), axis=1)
    peak = int(np.argmax(size))
    late = size[(peak + size.size) // 2 :]
    if float(np.max(late)) > 0.5 * float(size[peak]):
        return None
    time_s = float(data.time_s[peak])
    return Onset(time_s, data.step_s, time_s, "peak", 1.0, Note.PEAK(time_s=time_s))


def changed_onset(time_s: float, sd_s: float) -> Onset:
    """Onset where the motion changes."""
    return Onset(time_s, sd_s, time_s, "interruption", 1.0, Note.MOTION_CHANGES(time_s=time_s))


def _after_event(frequency_hz: float, event: Event, remaining_s: float) -> float:
    decay = TUNING.settle_decay_times / max(event.decay_per_s, 1e-300)
    return min(1.0 / frequency_hz, decay, TUNING.max_settle_fraction * remaining_s)

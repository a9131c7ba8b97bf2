"""Events that interrupt a free motion: plucks, stops by hand, clicks, steps of the baseline.

The envelope gives candidates. A candidate is an event only where free decays over the whole piece fail to explain the
motion on both sides of it, while a decay on each side alone does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from modal_id.data import FitData, baseline_splines, detrended, rough_variance
from modal_id.fit import find_modes
from modal_id.segments.boundary import locate_boundary, motion_beside
from modal_id.segments.envelope import short_time
from modal_id.segments.event_candidates import BURST, EventCandidate, event_candidates
from modal_id.solve import ModeColumns, Problem, fit_poles, solve_linear
from tracker import BoolArray, ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Confirmation of events."""

    #: [cycles] length of the decays fitted on either side of a candidate
    side_cycles: float = 10.0
    #: [cycles] their least length
    least_cycles: float = 2.0
    #: [samples] the same
    least_rows: int = 10
    #: [1] largest number of modes of these decays
    modes: int = 4
    #: [1] share of the motion that free decays over the piece may leave where they explain a candidate
    explained_share: float = 0.1
    #: [variances] mean square error of a prediction that noise explains
    #: statistics: Two standard deviations.
    noise_square: float = 4.0
    #: [1] bandwidth of the slow motion beside a candidate, over the dominant frequency
    slow: float = 0.25
    #: [1] relative difference from the dominant line within which a fitted decay is that line
    same_line: float = 0.1
    #: [cycles] length of a candidate up to which the motions beside it are extrapolated across it
    short_cycles: float = 3.0
    #: [1] ratio of a step of the offset to the range of slow motion above which it counts as a step
    wobble: float = 1.5
    #: [cycles] nearest cycles of either side between which a step is measured
    near_cycles: float = 2.0
    #: [1] least jump of the state of a confirmed event, over the larger amplitude
    confirmed_share: float = 0.03
    #: [sd] the same in standard deviations
    #: statistics: Noise exceeds it in 6e-7 of the candidates.
    confirmed_sd: float = 5.0
    #: [1] least jump of phase or offset, over the amplitude, where the amplitude hardly changes
    #: measurement: A codec shifts phases by a quarter of a radian at key frames.
    interrupted_share: float = 0.4
    #: [1] ratio of amplitudes from which the amplitude rises
    rise: float = 1.25
    #: [1] ratio of amplitudes below which it falls
    fall: float = 0.8


TUNING = Tuning()


EventKind = Literal["rise", "fall", "interruption", "burst"]


@dataclass(frozen=True)
class Event:
    """An event between two times relative to the data.

    ``kind`` is "rise" (the amplitude grows: a pluck or a blow), "fall" (it drops: a hand), "interruption" (a step or a
    change of phase at about the same amplitude), or "burst" (a click after which the motion goes on as before: only
    the samples within are disturbed). ``decay_per_s`` is the rate of the motion that follows, 0 where unknown;
    ``sd_s`` the standard deviation of its limits, NaN where unknown.
    """

    kind: EventKind
    start_s: float
    end_s: float
    decay_per_s: float = 0.0
    sd_s: float = float("nan")


def find_events(
    data: FitData, frequency_hz: float, lowest_hz: float, rest_until_s: float | None = None
) -> list[Event]:
    """Events of a record whose dominant motion has this frequency, in order of time.

    `data` should be averaged to about a dozen samples per cycle: the search fits every piece several times. The record
    is known to be at rest until `rest_until_s`, where a motion begins.
    """
    envelope = short_time(data, frequency_hz)
    candidates = [] if envelope is None else event_candidates(envelope)
    events: list[Event] = []
    begin = float(data.time_s[0])
    if rest_until_s is not None:
        events.append(Event("rise", rest_until_s, rest_until_s + data.step_s))
        begin = events[0].end_s
        candidates = [one for one in candidates if one.start_s > begin]
    if not candidates or envelope is None:
        return events
    weights = data.weights.copy()
    for index, one in enumerate(candidates):
        last = index + 1 == len(candidates)
        until = float(data.time_s[-1]) if last else candidates[index + 1].start_s
        current = replace(data, weights=weights)
        event = _confirmed(current, envelope.noise, one, begin, until, frequency_hz, lowest_hz)
        if event is None:
            continue
        events.append(event)
        if event.kind == "burst":
            weights = np.where(_between(data, event.start_s, event.end_s)[:, None], 0.0, weights)
        else:
            begin = event.end_s
    return _located(replace(data, weights=weights), events, frequency_hz, lowest_hz)


def _located(data: FitData, events: list[Event], frequency_hz: float, lowest_hz: float) -> list[Event]:
    """The events with their limits to the sample, from the motions on both sides; clicks keep theirs."""
    changes = [e for e in events if e.kind != "burst"]
    begins = [float(data.time_s[0]), *(e.end_s for e in changes)]
    ends = [*(e.start_s for e in changes[1:]), float(data.time_s[-1])]
    found: dict[Event, Event] = {}
    sd = np.sqrt(rough_variance(data))
    for one, begin, end in zip(changes, begins, ends, strict=False):
        limits = one.start_s, one.end_s
        if one.kind == "rise":
            # The motion that follows is largest where it begins.
            part = data.rows(_between(data, *limits))
            size = np.max(np.abs(detrended(part)) / sd, axis=1)
            limits = one.start_s, min(one.end_s, float(part.time_s[np.argmax(size)]) + 1.0 / frequency_hz)
        place = locate_boundary(data, begin, limits, end, 1.0 / frequency_hz, lowest_hz)
        if place is not None:
            found[one] = replace(one, start_s=place.end_s, end_s=place.start_s, sd_s=place.sd_s)
    return [found.get(e, e) for e in events]


def _between(data: FitData, start_s: float, end_s: float) -> BoolArray:
    return np.asarray((data.time_s >= start_s) & (data.time_s <= end_s))


def _confirmed(
    data: FitData,
    noise: FloatArray,
    one: EventCandidate,
    begin_s: float,
    until_s: float,
    frequency_hz: float,
    lowest_hz: float,
) -> Event | None:
    """The event at a candidate in a piece that begins at `begin_s` and is free of others until `until_s`."""
    reach = TUNING.side_cycles / frequency_hz
    before = _between(data, max(begin_s, one.start_s - reach), one.start_s)
    after = _between(data, one.end_s, min(until_s, one.end_s + reach))
    least = max(TUNING.least_rows, int(TUNING.least_cycles / (frequency_hz * data.step_s)))
    inside = _between(data, one.start_s, one.end_s)
    if np.count_nonzero(before) < least:
        return _at_start(data, noise, one, begin_s, until_s, lowest_hz)
    if np.count_nonzero(after) < least:
        # Too little follows to fit a decay: the piece ends here.
        return Event("fall", one.start_s, max(one.end_s, until_s))
    sides = [_side(data.rows(rows), frequency_hz, one.time_s) for rows in (before, after)]
    if _rises_from_rest(sides, noise):
        return _boundary(sides[0], sides[1], one, noise)
    beside = _beside(data, noise, one, (begin_s, until_s), frequency_hz, lowest_hz)
    if beside == "goes on":
        return None
    if beside == "changes" and (found := _boundary(sides[0], sides[1], one, noise)) is not None:
        return found
    piece = _between(data, begin_s, until_s)
    left_out = np.where(inside[:, None], 0.0, data.weights)
    # Where the candidate is most of the piece, the remaining samples do not determine decays across it.
    trials = (
        [data.weights] if 2 * np.count_nonzero(inside) > np.count_nonzero(piece) else [data.weights, left_out]
    )
    for weights in trials:
        whole = _whole(replace(data, weights=weights), piece, lowest_hz)
        if whole is None:
            continue
        left = [_left(data, whole, rows, frequency_hz) for rows in (before, after)]
        if not _explained(sides, left, noise):
            continue
        if not _goes_on(data, ((begin_s, one.start_s), (one.end_s, until_s)), frequency_hz, lowest_hz):
            break
        square = data.weights * (whole / noise) ** 2
        quiet = max(float(np.mean(square[before | after])), 1.0)
        if not np.any(inside) or np.mean(square[inside]) < BURST * quiet:
            return None
        if weights is left_out:
            return Event("burst", one.start_s, one.end_s)
    return _boundary(sides[0], sides[1], one, noise)


def _beside(
    data: FitData,
    noise: FloatArray,
    one: EventCandidate,
    span_s: tuple[float, float],
    frequency_hz: float,
    lowest_hz: float,
) -> Literal["goes on", "changes", "unknown"]:
    """Whether the motions of a dozen cycles on both sides of a candidate, extrapolated, explain it, or each other.

    Neither where they describe their own side badly, as close modes do, or the candidate is long.
    """
    cycle_s = 1.0 / frequency_hz
    if (one.end_s - one.start_s) * frequency_hz > TUNING.short_cycles:
        return "unknown"
    near_s, reach_s = TUNING.near_cycles * cycle_s, TUNING.side_cycles * cycle_s
    spans = (
        (max(span_s[0], one.start_s - reach_s), one.start_s),
        (one.end_s, min(span_s[1], one.end_s + reach_s)),
    )
    motions = [motion_beside(data, *span, cycle_s, lowest_hz, last=k == 0) for k, span in enumerate(spans)]
    wanted = (one.start_s, one.end_s + near_s), (one.start_s - near_s, one.end_s)
    good = True
    for motion, (start_s, end_s) in zip(motions, wanted, strict=True):
        if motion is None:
            return "unknown"
        rows = _between(data, max(start_s, span_s[0]), min(end_s, span_s[1]))
        values, size = motion.at(data.time_s[rows])
        variance = np.maximum(motion.variance, noise**2)
        weights = data.weights[rows] / variance
        left = float(np.sum(weights * (data.values[rows] - values) ** 2))
        left -= TUNING.noise_square * np.count_nonzero(weights)
        if left < TUNING.explained_share * float(np.sum(weights * 0.5 * size**2)):
            return "goes on"
        good &= bool(np.all(motion.variance < TUNING.noise_square * noise**2))
    return "changes" if good else "unknown"


@dataclass(frozen=True)
class _Side:
    """Decay fitted on one side of a candidate, and its state at the candidate.

    ``largest`` is its largest amplitude on this side, ``offset`` that of the nearest cycles, ``wobble`` the range of
    the slow motion on this side.
    """

    decay_per_s: float
    state: ComplexArray
    offset: FloatArray
    state_sd: FloatArray
    wobble: FloatArray
    largest: FloatArray


def _side(data: FitData, frequency_hz: float, time_s: float) -> _Side:
    """A single decay plus slow motion, extrapolated to a time at most a few cycles away."""
    start_s = float(data.time_s[0])
    part = data.from_time(start_s)
    steady = np.array([2j * np.pi * frequency_hz])
    problem = Problem(part, baseline_splines(part.time_s, TUNING.slow * frequency_hz))
    fit = fit_poles(problem, np.array([-0.3 / max(part.span_s, 1e-9) + 2j * np.pi * frequency_hz]))
    pole, linear = complex(fit.poles[0]), fit.linear
    if abs(pole.imag / steady[0].imag - 1.0) > TUNING.same_line:
        # No line: the amplitude at the frequency is that of noise.
        pole, linear = complex(steady[0]), solve_linear(problem, ModeColumns(part.time_s, steady))
    largest = np.abs(linear.amplitudes[0]) * max(1.0, float(np.exp(min(pole.real * part.span_s, 50.0))))
    pole = min(pole.real, 0.0) + 1j * pole.imag
    distance = np.abs(data.time_s - time_s)
    grown = np.exp(-pole.real * float(np.min(distance)))
    sd = grown * np.sqrt(linear.noise_variance * 4.0 / np.maximum(part.counts, 1.0))
    near = distance < np.min(distance) + TUNING.near_cycles / frequency_hz
    # Slow motion goes on across the event.
    wobble = np.ptp(linear.baseline, axis=0) * (1.0 + 2.0 * np.min(distance) / max(part.span_s, 1e-300))
    state = linear.amplitudes[0] * np.exp(pole * (time_s - start_s))
    return _Side(-pole.real, state, np.mean(linear.baseline[near], axis=0), sd, wobble, largest)


def _rises_from_rest(sides: list[_Side], noise: FloatArray) -> bool:
    """Whether the motion that follows is ten times as large as in the cycles before.

    Free decays beat, but not from rest: decays with alternating signs, fitted to the whole piece, only imitate a pluck.
    """
    return _size(sides[0].largest, noise) < TUNING.explained_share * _size(sides[1].state, noise)


def _left(data: FitData, residual: FloatArray, rows: BoolArray, frequency_hz: float) -> _Side:
    """Dominant motion that remains in the residual on one side of a candidate."""
    part = replace(data, values=residual).rows(rows).from_time(float(data.time_s[rows][0]))
    problem = Problem(part, baseline_splines(part.time_s, TUNING.slow * frequency_hz))
    linear = solve_linear(problem, ModeColumns(part.time_s, np.array([2j * np.pi * frequency_hz])))
    sd = np.sqrt(linear.noise_variance * 4.0 / np.maximum(part.counts, 1.0))
    wobble = np.ptp(linear.baseline, axis=0)
    amplitude = linear.amplitudes[0]
    return _Side(0.0, amplitude, np.mean(linear.baseline, axis=0), sd, wobble, np.abs(amplitude))


def _explained(sides: list[_Side], left: list[_Side], noise: FloatArray) -> bool:
    """Whether little of the dominant motion, and no step, remains in the residual on both sides."""
    level = max(_size(side.state, noise) for side in sides)
    sd = max(_size(side.state_sd, noise) for side in left)
    limit = max(TUNING.confirmed_sd * sd, TUNING.explained_share * level)
    return all(_size(side.state, noise) < limit for side in left) and _step(left, noise) < limit


def _goes_on(
    data: FitData, spans: tuple[tuple[float, float], ...], frequency_hz: float, lowest_hz: float
) -> bool:
    """Whether decays fitted before a candidate predict the motion just after it, or those fitted after it that before.

    Decays fitted to both sides together imitate several plucks by modes at equal distances, which beat at their rate.
    """
    near_s = TUNING.near_cycles / frequency_hz
    for fitted, other in (spans, spans[::-1]):
        rows = _between(data, *fitted)
        earlier = other[0] < fitted[0]
        # Beside a gap, the nearest samples are at its end.
        seen = data.time_s[_between(data, *other) & np.any(data.weights > 0.0, axis=1)]
        if not seen.size:
            continue
        near = (seen[-1] - near_s, seen[-1]) if earlier else (seen[0], seen[0] + near_s)
        wanted = _between(data, max(near[0], other[0]), min(near[1], other[1]))
        if np.count_nonzero(rows) < TUNING.least_rows:
            continue
        origin = float(data.time_s[rows][0])
        model = find_modes(data.rows(rows).from_time(origin), TUNING.modes, lowest_hz)
        if model is None:
            continue
        poles, linear = model.fit.poles, model.fit.linear
        growth = np.clip(np.outer(data.time_s[wanted] - origin, poles.real), -50.0, 5.0)
        wave = np.exp(growth + 1j * np.outer(data.time_s[wanted] - origin, poles.imag))
        predicted = np.real(wave @ linear.amplitudes)
        weights = data.weights[wanted] / linear.noise_variance
        error = data.values[wanted] - predicted
        error = error - np.sum(weights * error, axis=0) / np.maximum(np.sum(weights, axis=0), 1e-300)
        unexplained = float(np.sum(weights * error**2)) - TUNING.noise_square * np.count_nonzero(weights)
        if unexplained < TUNING.explained_share * float(np.sum(weights * predicted**2)):
            return True
    return False


def _size(values: ComplexArray | FloatArray, noise: FloatArray) -> float:
    return float(np.sqrt(np.sum(np.abs(values / noise) ** 2)))


def _step(sides: list[_Side], noise: FloatArray) -> float:
    """Jump of the offset, 0 where the range of slow motion on one side is about as large."""
    jump = np.abs(sides[1].offset - sides[0].offset)
    return _size(
        np.where(jump > TUNING.wobble * np.maximum(sides[0].wobble, sides[1].wobble), jump, 0.0), noise
    )


def _at_start(
    data: FitData, noise: FloatArray, one: EventCandidate, begin_s: float, until_s: float, lowest_hz: float
) -> Event | None:
    """A release in the first cycles: the decay that follows does not explain the samples up to it."""
    piece = _between(data, begin_s, until_s)
    whole = _whole(data, piece, lowest_hz)
    if whole is None:
        return None
    square = data.weights * (whole / noise) ** 2
    early = piece & (data.time_s <= one.end_s)
    late = piece & ~early
    if not np.any(late) or np.mean(square[early]) < BURST * max(float(np.mean(square[late])), 1.0):
        return None
    return Event("rise", one.start_s, one.end_s)


def _whole(data: FitData, piece: BoolArray, lowest_hz: float) -> FloatArray | None:
    """Residual of free decays over the whole piece; 0 outside."""
    part = data.rows(piece).from_time(float(data.time_s[piece][0]))
    if part.time_s.size < TUNING.least_rows:
        return None
    model = find_modes(part, TUNING.modes, lowest_hz)
    if model is None:
        return None
    residual = np.zeros(data.values.shape)
    residual[piece] = model.fit.linear.residual
    return residual


def _boundary(before: _Side, after: _Side, one: EventCandidate, noise: FloatArray) -> Event | None:
    size_sd = _size(np.hypot(before.state_sd, after.state_sd), noise)
    levels = [_size(side.state, noise) for side in (before, after)]
    state, step = _size(after.state - before.state, noise), _step([before, after], noise)
    if max(state, step) < max(TUNING.confirmed_sd * size_sd, TUNING.confirmed_share * max(levels)):
        return None
    if max(levels) < TUNING.confirmed_sd * size_sd:
        # Nothing moves on either side: a click or a step at rest.
        kind: EventKind = "interruption"
    elif levels[1] > TUNING.rise * levels[0]:
        kind = "rise"
    elif levels[1] < TUNING.fall * levels[0]:
        kind = "fall"
    elif max(step, state) > TUNING.interrupted_share * max(levels):
        kind = "interruption"
    else:
        return None
    return Event(kind, one.start_s, one.end_s, after.decay_per_s)

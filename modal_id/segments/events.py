"""Events that interrupt a free motion: plucks, hands, clicks, the end of a drive.

The division of the record gives changes. One is an event only where the motions of a dozen cycles on both sides of it,
extrapolated, do not explain each other.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from modal_id.data import FitData, baseline_matrix, detrended, rough_variance
from modal_id.fit import ModalFit
from modal_id.segments.boundary import TUNING as BOUNDARY
from modal_id.segments.boundary import Boundary, Motion, fitted_motion, locate_boundary, motion_beside
from modal_id.segments.change_point import ChangeSearch
from modal_id.segments.drive_odds import BETWEEN_SD
from modal_id.segments.partition import Change, find_changes
from modal_id.solve import mode_functions, real_columns
from tracker import ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Confirmation of events."""

    #: [1] error of a motion over its amplitude
    #: convention: Damping that depends on the amplitude.
    relative_error: float = 0.01
    #: [1] mean square residual within a change over that beside it, where the motion goes on, from which it is a click
    burst: float = 9.0
    #: [samples] most of them that are outliers and no click
    #: convention: A quarter of a cycle.
    few: int = 3
    #: [1] change of the pole of one motion, over half its length, that counts as none
    #: measurement: Weak modes and damping that depends on the amplitude let it change by 0.16 at most in four public
    #: recordings that were divided; a hand changes it by more than 1 in a few cycles.
    bends: float = 0.3
    #: [1] largest ratio of the decay rates at its ends
    #: convention: Damping that depends on the amplitude; a hand changes it by more.
    steeper: float = 3.0
    #: [1] largest growth of the logarithm of the amplitude of a mode that need not be driven
    #: convention: Noise imitates a smaller one.
    grows: float = 1.0
    #: [1] jump of the motion over its larger amplitude below which it is continuous
    continuous: float = 0.4
    #: [1] largest number of changes at which the motion is continuous
    #: convention: A drive, a decay, a hand, its release. More are those of a motion that is forced at random.
    most_continuous: int = 3
    #: [1] ratio of amplitudes from which the amplitude rises
    rise: float = 1.25
    #: [1] ratio of amplitudes below which it falls
    fall: float = 0.8


TUNING = Tuning()

EventKind = Literal["rise", "fall", "interruption", "burst"]


@dataclass(frozen=True)
class Event:
    """An event between two times relative to the data.

    ``kind`` is "rise" (the amplitude grows: a pluck or a blow), "fall" (it drops: a stop), "interruption" (the motion
    changes at about the same amplitude), or "burst" (a click after which the motion goes on as before: only the
    samples within are disturbed). ``decay_per_s`` is the rate of the motion that follows, 0 where unknown; ``sd_s`` the
    standard deviation of its end, NaN where unknown; ``jump`` that of the motion over its larger amplitude.
    """

    kind: EventKind
    start_s: float
    end_s: float
    decay_per_s: float = 0.0
    sd_s: float = float("nan")
    jump: float = 1.0

    @property
    def jumps(self) -> bool:
        """Whether the motion is not continuous: it is plucked, or a drive starts."""
        return self.jump >= TUNING.continuous

    @property
    def place(self) -> ChangeSearch:
        """Its time, which is known."""
        width_s = (self.end_s - self.start_s) / np.sqrt(12.0)
        sd_s = float(np.hypot(np.nan_to_num(self.sd_s), width_s))
        return ChangeSearch(0.5 * (self.start_s + self.end_s), sd_s)


def find_events(
    data: FitData, tones_hz: tuple[float, ...], lowest_hz: float, rest_until_s: float | None = None
) -> tuple[list[Event], list[Change]]:
    """Events of a record, and changes after which the motion goes on, as where a drive ends; in order of time.

    Parameters
    ----------
    data : FitData
        Averaged to a few samples per cycle of the fastest tone.
    tones_hz : tuple of float
        The strongest lines, the dominant one first.
    lowest_hz : float
        Lower end of the search for modes.
    rest_until_s : float or None
        The record is known to be at rest until then, where a motion begins.
    """
    events: list[Event] = []
    others: list[Change] = []
    begin = float(data.time_s[0])
    if rest_until_s is not None:
        sd_s = data.step_s / np.sqrt(12.0)
        events.append(Event("rise", rest_until_s, rest_until_s + data.step_s, sd_s=sd_s))
        begin = events[0].end_s
    left = deque(find_changes(data, tones_hz, begin))
    while left:
        change = left.popleft()
        until = left[0].low_s if left else float(data.time_s[-1])
        event = _event(data, change, begin, until, 1.0 / tones_hz[0], lowest_hz)
        if change.instead and not _is_short_click(event, begin, until):
            left.extendleft(reversed(change.instead))
            continue
        if event is None or event.kind == "burst":
            others.append(change)
        if event is None:
            continue
        events.append(event)
        if event.kind == "burst":
            inside = data.inside(event.start_s, event.end_s)
            data = replace(data, weights=np.where(inside[:, None], 0.0, data.weights))
        else:
            begin = event.end_s
    continuous = [e for e in events if not e.jumps]
    if len(continuous) > TUNING.most_continuous:
        events = [e for e in events if e.jumps]
    return events, others


def _is_short_click(event: Event | None, begin_s: float, until_s: float) -> bool:
    """Whether an event is a click, shorter than the motion on either side that it interrupts."""
    if event is None or event.kind != "burst":
        return False
    return event.end_s - event.start_s < min(event.start_s - begin_s, until_s - event.end_s)


def _event(
    data: FitData, change: Change, begin_s: float, until_s: float, cycle_s: float, lowest_hz: float
) -> Event | None:
    """The event at a change, in a piece that begins at `begin_s` and is free of others until `until_s`."""
    low, high = max(change.low_s, begin_s), min(change.high_s, until_s)
    if not low < high:
        return None
    reach_s = BOUNDARY.side_cycles * cycle_s
    spans = (max(begin_s, low - reach_s), low), (high, min(until_s, high + reach_s))
    before, after = (
        motion_beside(data, *span, cycle_s, lowest_hz, last=k == 0) for k, span in enumerate(spans)
    )
    if before is not None and after is not None:
        one = _one_motion(data, spans, before, after, cycle_s, lowest_hz)
        if one is not None:
            variance = np.minimum(before.variance, after.variance)
            click = _click(data, replace(one, variance=variance), low, high, cycle_s)
            if click is None or high - low < min(np.ptp(side.span_s) for side in (before, after)):
                return click
            # Sides shorter than what lies between them may not tell how it beats.
            rows = data.inside(spans[0][0], spans[1][1]) & np.any(data.weights > 0.0, axis=1)
            whole = replace(fitted_motion(data.rows(rows), cycle_s, lowest_hz, last=True), variance=variance)
            return click if _click(data, whole, low, high, cycle_s) is not None else None
    elif before is None and after is not None and _rests(data, after, begin_s, high):
        # a motion of too few cycles for a side of its own
        return None
    elif before is None:
        low = begin_s
    elif _click(data, before, low, until_s, cycle_s) is None:
        # Too little follows for a motion of its own, and what follows is that before.
        return None
    place = locate_boundary(data, begin_s, (low, high), until_s, cycle_s, lowest_hz, (before, after))
    if place is None:
        return None
    event = _of_kind(data, place, before, after, cycle_s)
    continuous = event.kind == "interruption" and not event.jumps
    if before is None or after is None or not continuous or not _goes_on(before, after, data):
        return event
    # the strongest motion goes on; only samples that neither side explains are disturbed
    apart = event.end_s - event.start_s > 1.5 * data.step_s
    return replace(event, kind="burst") if apart else None


def _one_motion(
    data: FitData,
    spans: tuple[tuple[float, float], ...],
    before: Motion,
    after: Motion,
    cycle_s: float,
    lowest_hz: float,
) -> Motion | None:
    """The motion that explains both sides of a change better than two do; None without one.

    Any motion, or that of the side with more modes, because a mode that dies out on one side may be too weak to be
    found again; with constant poles, or one that changes evenly, as damping that depends on the amplitude does.
    """
    # without the outliers of either side
    rows = [data.inside(*span) & np.any(data.weights > 0.0, axis=1) for span in spans]
    weights = [
        data.weights[own] if side.model is None else side.model.data.weights
        for own, side in zip(rows, (before, after), strict=True)
    ]
    part = replace(data.rows(rows[0] | rows[1]), weights=np.concatenate(weights))
    most, span_s = max(before.poles.size, after.poles.size), spans[1][1] - spans[0][0]
    shortest_s = min(float(np.ptp(side.span_s)) for side in (before, after))
    for poles in (None, before.poles, after.poles):
        if poles is not None and not poles.size:
            continue
        one = fitted_motion(part, cycle_s, lowest_hz, last=True, poles=poles)
        # More modes than either side shows imitate a change, but for those that a side is too short to separate;
        # modes that grow are not free.
        if _separate(one.poles, shortest_s) > most or np.any(one.poles.real * span_s > TUNING.grows):
            continue
        if _is_rather_one(one, one.rss, 0, before, after):
            return one
        if one.model is not None and _is_rather_one(one, _bent_rss(one.model), 4, before, after):
            return one
    return None


def _rests(data: FitData, after: Motion, begin_s: float, until_s: float) -> bool:
    """Whether nothing is left of the motion between two times where the next one begins."""
    parts = (data.rows(data.inside(*span)) for span in ((begin_s, until_s), after.span_s))
    inside, left = (np.sum(np.sum(detrended(p) ** 2, axis=0) / np.maximum(p.counts, 1.0)) for p in parts)
    return not after.poles.size and bool(inside > TUNING.burst * left)


def _separate(poles: ComplexArray, span_s: float) -> int:
    """Number of lines that beat within a time."""
    return int(poles.size and 1 + np.count_nonzero(np.diff(np.sort(poles.imag)) * span_s > 2.0 * np.pi))


def _goes_on(before: Motion, after: Motion, data: FitData) -> bool:
    """Whether the strongest wave of both sides is one: it decays, and its pole changes as little as one motion's may.

    Weak modes, which die out or beat with others nearby, explain what one motion leaves.
    """
    sd = np.sqrt(rough_variance(data))
    if not before.poles.size or not after.poles.size:
        return False
    poles = [complex(side.poles[_strongest(side, sd)]) for side in (before, after)]
    low, high = sorted(-pole.real for pole in poles)
    half_s = 0.5 * min(float(np.ptp(side.span_s)) for side in (before, after))
    # two sd of the scatter of the damping ratio between free decays of one structure
    scatter = float(np.exp(2.0 * BETWEEN_SD))
    return abs(poles[1] - poles[0]) * half_s < TUNING.bends and high < scatter * low


def _strongest(motion: Motion, sd: FloatArray) -> int:
    return int(np.argmax(np.sum(np.abs(motion.amplitudes / sd) ** 2, axis=1)))


def _bent_rss(model: ModalFit) -> FloatArray:
    """Residual sum of squares of each channel where the pole of the strongest mode may change evenly in time.

    Infinite where it changes by more than damping that depends on the amplitude does.
    """
    data, poles = model.data, model.fit.poles
    since = np.linspace(-1.0, 1.0, data.time_s.size)[:, None]
    waves = mode_functions(data.time_s, poles)
    own = waves[:, [model.strongest]]
    ramps = real_columns(np.concatenate([waves, own * since, own * since**2], axis=1))
    columns = np.concatenate([baseline_matrix(data.time_s, model.bandwidth_hz), ramps], axis=1)
    rss, rates = np.empty(data.values.shape[1]), np.empty((2, data.values.shape[1]))
    for k in range(rss.size):
        root = np.sqrt(data.weights[:, k])
        solution = np.linalg.lstsq(columns * root[:, None], data.values[:, k] * root, rcond=1e-9)[0]
        rss[k] = np.sum((root * (data.values[:, k] - columns @ solution)) ** 2)
        amplitudes = solution[-ramps.shape[1] :].reshape(-1, 2) @ np.array([1.0, -1j])
        at, slope, bend = amplitudes[[model.strongest, -2, -1]]
        rates[:, k] = [((slope + 2.0 * x * bend) / (at + x * slope + bend)).real for x in (-1.0, 1.0)]
    power = np.abs(model.fit.linear.amplitudes[model.strongest]) ** 2 / model.fit.linear.noise_variance
    own_rate = -0.5 * float(poles[model.strongest].real) * data.span_s
    low, high = np.sort(own_rate - rates[:, np.argmax(power)])
    bends = high - low < TUNING.bends or high < TUNING.steeper * low
    return rss if bends else np.full(rss.size, np.inf)


def _is_rather_one(one: Motion, rss: FloatArray, bends: int, before: Motion, after: Motion) -> bool:
    """Whether one motion explains the samples of both sides better than two, by the information criterion.

    `rss` is its residual sum of squares, with `bends` further parameters of each channel.
    """
    power = 0.5 * np.sum(np.abs(before.amplitudes) ** 2, axis=0) * before.count
    power += 0.5 * np.sum(np.abs(after.amplitudes) ** 2, axis=0) * after.count
    error = TUNING.relative_error**2 * power + 1e-300
    two = before.rss + after.rss
    if np.all(rss - two < error):
        return True
    gain = float(np.sum(one.count * np.log((rss + error) / (two + error))))
    # Noise with more power at the mode than white noise gains as much more by chance.
    gain /= max(one.level, before.level, after.level)
    penalty = _penalty(before) + _penalty(after) + 1.0 - _penalty(one) - bends * rss.size
    return gain < penalty * float(np.log(np.sum(one.count)))


def _penalty(motion: Motion) -> float:
    """Number of parameters, with the factor for few samples (Hurvich & Tsai 1989, doi:10.1093/biomet/76.2.297)."""
    n, p = float(np.sum(motion.count)), float(motion.parameters)
    return p * n / max(n - p - 1.0, 1.0)


def _click(data: FitData, motion: Motion, low_s: float, high_s: float, cycle_s: float) -> Event | None:
    """The click within a motion that goes on: samples that it does not explain; None without any."""
    rows = data.inside(low_s, high_s)
    left = data.values[rows] - motion.at(data.time_s[rows])[0]
    square = np.mean(data.weights[rows] * (left - np.median(left, axis=0)) ** 2 / motion.variance, axis=1)
    loud = np.flatnonzero(square > TUNING.burst)
    if not square.size or float(np.mean(square)) < TUNING.burst:
        return None
    if loud.size <= max(TUNING.few, int(np.ptp(loud)) // 2):
        # outliers between samples of the motion are left to the fit
        return None
    first_s, last_s = data.time_s[rows][loud[[0, -1]]] + np.array([-0.25, 0.25]) * cycle_s
    return Event("burst", max(float(first_s), low_s), min(float(last_s), high_s))


def _of_kind(
    data: FitData, place: Boundary, before: Motion | None, after: Motion | None, cycle_s: float
) -> Event:
    sd = np.sqrt(rough_variance(data))
    sizes = [_size(before, place.end_s, sd), _size(after, place.start_s, sd)]
    rate, jump = 0.0, 1.0
    if after is not None and after.poles.size:
        rate = max(-float(after.poles[_strongest(after, sd)].real), 0.0)
    if before is not None and after is not None:
        about_s = 0.5 * (place.end_s + place.start_s) + np.linspace(-0.5, 0.5, 17)[1:] * cycle_s
        apart = (before.at(about_s)[0] - after.at(about_s)[0]) / sd
        jump = float(np.sqrt(2.0 * np.mean(np.sum(apart**2, axis=1)))) / max(*sizes, 1e-300)
    kind: EventKind = "interruption"
    if after is None or sizes[1] < TUNING.fall * sizes[0]:
        kind = "fall"
    elif before is None or sizes[1] > TUNING.rise * sizes[0]:
        kind = "rise"
    return Event(kind, place.end_s, place.start_s, rate, place.sd_s, jump)


def _size(motion: Motion | None, time_s: float, sd: FloatArray) -> float:
    if motion is None:
        return 0.0
    return float(np.sqrt(np.sum((motion.at(np.array([time_s]))[1] / sd) ** 2)))

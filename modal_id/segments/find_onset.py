"""Start of the free decay within a piece of the record: the end of steady shaking, a release, or its first sample."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modal_id.data import FitData, detrended
from modal_id.fit import find_modes
from modal_id.record import Onset
from modal_id.segments.events import Event
from modal_id.segments.stop import ChangeSearch, Stop, driven_then_free, locate_stop
from tracker import BoolArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """The begin of the fit."""

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


def user_onset(time_s: float) -> Onset:
    """Onset given by the user, without uncertainty."""
    return Onset(time_s, 0.0, time_s, "user", 1.0, "The start of the free decay was given by the user.")


def record_start(time_s: float) -> Onset:
    """Onset of a record, or a piece, that is a decay from its first sample on."""
    note = (
        "No change from driven to free motion was found: the motion decays freely from the first sample that is "
        "used."
    )
    return Onset(time_s, float("nan"), time_s, "record start", 1.0, note)


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


def stop_of_shaking(
    data: FitData,
    variance: FloatArray,
    frequency: float,
    lowest_hz: float,
    base: BoolArray,
    place: ChangeSearch,
) -> Onset | None:
    """Onset where steady shaking ends and a free decay follows; None where the data show no such change.

    `data` hold the channels and, where the mask `base` is True, those of the moving base, to which the others are
    relative; `variance` is the noise variance of all of them, `place` that of a change that may be the end.
    Times are relative to `data`.
    """
    change = driven_then_free(data.channels(~base), variance[~base], frequency, place)
    if change is None or change.probability <= TUNING.likely:
        return None
    step, last = data.step_s, float(data.time_s[-1])
    begin = change.time_s + settling_s(frequency, step, change.sd_s, last - change.time_s)
    decay = find_modes(data.from_time(begin), TUNING.max_excited, lowest_hz or 0.5 * change.drive_hz)
    stop = None if decay is None else locate_stop(data, change, decay.fit)
    when, sd = (change.time_s, change.sd_s) if stop is None else (stop.time_s, stop.sd_s)
    fit_from = when + settling_s(frequency, step, sd, last - when)
    note = (
        f"Steady shaking at {change.drive_hz:.4g} Hz ends at {when:.5f} s (sd {sd:.2g} s), {_method(stop, base)} The "
        f"following {fit_from - when:.3g} s ({(fit_from - when) * frequency:.2g} cycles) are not fitted: transients of "
        "higher modes are still present."
    )
    return Onset(when, sd, fit_from, "model", change.probability, note)


def _method(stop: Stop | None, base: BoolArray) -> str:
    if stop is None:
        return "located to about one cycle by the change from driven motion to a free decay."
    excited = ", ".join(f"{f:.4g}" for f in stop.excited_hz)
    tracked = ", including the tracked motion of the base," if np.any(base) else ""
    return (
        f"located where the fits of the steady vibration and of the free decays ({excited} Hz){tracked} join."
    )


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
    note = (
        f"The structure is released at {released_s:.4g} s: the decay starts there. The fit begins "
        f"{fit_from - released_s:.3g} s later, when the shortest transients are over."
    )
    return Onset(released_s, event.sd_s, fit_from, "peak", 1.0, note)


def continued_onset(event: Event) -> Onset:
    """Onset after a click or a step of the baseline, where a free motion goes on."""
    note = f"The motion is interrupted at {event.start_s:.4g} s and goes on: it is fitted from {event.end_s:.4g} s."
    return Onset(event.start_s, float("nan"), event.end_s, "interruption", 1.0, note)


def from_largest_deflection(data: FitData) -> Onset | None:
    """Onset at the largest deflection from the final position, of a motion that falls from there to less than half.

    For records of so few cycles that no envelope shows the release; times relative to `data`.
    """
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
    note = f"The structure is released at {time_s:.4g} s, its largest deflection: the decay starts there."
    return Onset(time_s, data.step_s, time_s, "peak", 1.0, note)


def changed_onset(time_s: float, sd_s: float) -> Onset:
    """Onset where the motion changes."""
    note = f"The motion changes at {time_s:.4g} s: it is fitted from there."
    return Onset(time_s, sd_s, time_s, "interruption", 1.0, note)


def _after_event(frequency_hz: float, event: Event, remaining_s: float) -> float:
    decay = TUNING.settle_decay_times / max(event.decay_per_s, 1e-300)
    return min(1.0 / frequency_hz, decay, TUNING.max_settle_fraction * remaining_s)

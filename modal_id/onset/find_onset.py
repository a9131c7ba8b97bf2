"""Start of the free decay: a release, the end of steady shaking, or the first sample of the record."""

from __future__ import annotations

import numpy as np

from modal_id.data.samples import FitData
from modal_id.fit.damped import fit_damped
from modal_id.fit.linear import Problem
from modal_id.fit.model_order import find_modes
from modal_id.fit.poles import fit_poles
from modal_id.fit.spectrum import candidates
from modal_id.onset.change_point import DrivenThenFree, driven_then_free
from modal_id.onset.stop_instant import Stop, locate_stop
from modal_id.results import Onset
from tracker.arrays import BoolArray, FloatArray

# Release: the amplitude rises from the first to the second of these shares of its maximum within three cycles.
_QUIET = 0.2
_LOUD = 0.7
_RISE_CYCLES = 3.0
_MAX_SETTLE_FRACTION = 0.1
_LIKELY = 0.95
_MAX_EXCITED = 8
# The motion is driven throughout when the logarithm of its amplitude changes by less than this, and by less than this
# many standard deviations.
_STEADY_CHANGE = 0.02
_STEADY_SD = 3.0


def user_onset(time_s: float) -> Onset:
    """Onset given by the user, without uncertainty."""
    return Onset(time_s, 0.0, time_s, "user", 1.0, "The start of the free decay was given by the user.")


def find_onset(
    data: FitData,
    variance: FloatArray,
    lowest_hz: float,
    wanted_hz: float | None,
    base: BoolArray | None = None,
) -> Onset:
    """Find the start of the free decay.

    Parameters
    ----------
    data : FitData
        From the first sample that may be used (after any clipping), times from there.
    variance : array, shape (k,)
        Noise variance of each channel.
    lowest_hz : float
        Lower end of the search; 0 where unknown.
    wanted_hz : float or None
        Frequency of the target mode, where known.
    base : bool array, shape (k,), or None
        Channels of the moving base, to which the others are relative.

    Returns
    -------
    Onset
        Times relative to `data`.
    """
    base = np.zeros(data.values.shape[1], dtype=bool) if base is None else base
    beam = data.channels(~base)
    found = candidates(beam, _detrended(beam), variance[~base], lowest_hz, ())
    if not found:
        damped = fit_damped(beam, _detrended(beam), lowest_hz)
        if damped is None:
            return _none("No vibration was detected, and therefore no start of a decay.")
        return _from_the_start(1.0)
    frequency = found[0].frequency_hz
    if wanted_hz is not None:
        frequency = min((c.frequency_hz for c in found), key=lambda f: abs(np.log(f / wanted_hz)))
    release = _released(beam, variance[~base], frequency)
    if release is not None:
        return release
    change = driven_then_free(beam, variance[~base], frequency)
    if change is not None and change.probability > _LIKELY:
        return _stopped(data, change, frequency, lowest_hz, base)
    if _steady(beam, frequency):
        return _none(
            f"The motion at {frequency:.4g} Hz is steady from the first sample to the last: the whole record is "
            "driven and contains no free decay. Continue recording after the shaking stops."
        )
    confidence = 1.0 if change is None else 1.0 - change.probability
    return _from_the_start(confidence)


def _from_the_start(confidence: float) -> Onset:
    return Onset(
        0.0,
        float("nan"),
        0.0,
        "record start",
        confidence,
        "No change from driven to free motion was found: the whole record is a free decay and is used from its first "
        "sample.",
    )


def _none(note: str) -> Onset:
    return Onset(0.0, float("nan"), 0.0, "none", 0.0, note)


def _steady(data: FitData, frequency: float) -> bool:
    """Whether growth and decay of the motion are negligible, as for a driven motion."""
    start = np.array([-1e-3 / max(data.span_s, 1e-9) + 2j * np.pi * frequency])
    fit = fit_poles(Problem(data, np.ones((data.time_s.size, 1))), start)
    rate, sd = float(fit.poles[0].real), float(fit.pole_sd[0, 0])
    change = abs(rate) * data.span_s
    return fit.converged and change < _STEADY_CHANGE and abs(rate) < _STEADY_SD * sd


def _detrended(data: FitData) -> FloatArray:
    total = np.maximum(np.sum(data.weights, axis=0), 1e-300)
    mean = np.sum(data.weights * data.values, axis=0) / total
    return np.where(data.weights > 0.0, data.values - mean, 0.0)


def settling_s(frequency_hz: float, step_s: float, onset_sd_s: float, remaining_s: float) -> float:
    """Time between a stop and the first sample used in the fit.

    A cycle (three samples where that is longer) and three standard deviations of the onset, at most a tenth of the
    remaining record.
    """
    delay_s = max(1.0 / frequency_hz, 3.0 * step_s) + 3.0 * onset_sd_s
    return min(delay_s, _MAX_SETTLE_FRACTION * remaining_s)


def _stopped(
    data: FitData,
    change: DrivenThenFree,
    frequency: float,
    lowest_hz: float,
    base: BoolArray,
) -> Onset:
    step, last = data.step_s, float(data.time_s[-1])
    begin = change.time_s + settling_s(frequency, step, change.sd_s, last - change.time_s)
    decay = find_modes(data.from_time(begin), _MAX_EXCITED, lowest_hz or 0.5 * change.drive_hz)
    stop = None if decay is None else locate_stop(data, change, decay.fit)
    when, sd = (change.time_s, change.sd_s) if stop is None else (stop.time_s, stop.sd_s)
    fit_from = when + settling_s(frequency, step, sd, last - when)
    note = (
        f"Steady shaking at {change.drive_hz:.4g} Hz ends at {when:.5f} s (sd {sd:.2g} s), {_method(stop, base)} The "
        f"following {fit_from - when:.3g} s, about one cycle, are not fitted: transients of modes too fast to be "
        "fitted are still present."
    )
    return Onset(when, sd, fit_from, "model", change.probability, note)


def _method(stop: Stop | None, base: BoolArray) -> str:
    if stop is None:
        return "located to about one cycle by the change from driven motion to a free decay."
    excited = ", ".join(f"{f:.4g}" for f in stop.excited_hz)
    tracked = ", including the tracked motion of the base," if np.any(base) else ""
    return (
        f"located where the steady vibration and the free decays ({excited} Hz){tracked} join continuously."
    )


def _envelope(data: FitData, variance: FloatArray, frequency_hz: float) -> tuple[FloatArray, FloatArray]:
    """Times and amplitudes of the strongest channel, one per cycle; NaN where a cycle has fewer than three samples."""
    values = _detrended(data)
    strong = np.argmax(np.sum(values**2, axis=0) / variance)
    x, w = values[:, strong], (data.weights[:, strong] > 0.0).astype(float)
    length = max(1.0 / frequency_hz, 4.0 * data.step_s)
    bins = (data.time_s / length).astype(int)
    count = np.bincount(bins, w)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.bincount(bins, w * x) / count
        spread = np.bincount(bins, w * x * x) / count - mean**2
    amplitude = np.where(count >= 3, np.sqrt(2.0 * np.maximum(spread, 0.0)), np.nan)
    return np.asarray((np.arange(count.size) + 0.5) * length), np.asarray(amplitude)


def _released(data: FitData, variance: FloatArray, frequency: float) -> Onset | None:
    times, amplitude = _envelope(data, variance, frequency)
    if np.count_nonzero(np.isfinite(amplitude)) < 4:
        return None
    filled = np.where(np.isfinite(amplitude), amplitude, 0.0)
    top = float(np.max(filled))
    loud = int(np.argmax(filled > _LOUD * top))
    quiet = np.flatnonzero(filled[:loud] < _QUIET * top)
    if loud == 0 or quiet.size == 0:
        return None
    last_quiet = int(quiet[-1])
    rise = (loud - last_quiet) * (times[1] - times[0])
    if rise * frequency > _RISE_CYCLES:
        return None
    begin, end = float(times[last_quiet]), times[loud] + 1.5 / frequency
    rows = np.flatnonzero((data.time_s >= begin) & (data.time_s <= end))
    values = np.abs(_detrended(data)[rows]) * (data.weights[rows] > 0.0) / np.sqrt(variance)
    peak_s = float(data.time_s[rows[np.argmax(np.max(values, axis=1))]])
    fit_from = peak_s + min(1.0 / frequency, _MAX_SETTLE_FRACTION * (float(data.time_s[-1]) - peak_s))
    note = (
        f"The structure is at rest until {begin:.4g} s and is then released; the decay starts at the largest "
        f"deflection. The fit begins {fit_from - peak_s:.3g} s later, when the shortest transients are over."
    )
    return Onset(peak_s, 0.25 / frequency, fit_from, "peak", 1.0, note)

"""Where the free decay begins: a release, the end of a steady shaking, or the record's first sample."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modal_id.change_point import DrivenThenFree, driven_then_free
from modal_id.linear import FitData
from modal_id.results import Onset
from modal_id.spectrum import candidates

FloatArray = NDArray[np.float64]

_QUIET = 0.2
_LOUD = 0.7
_RISE_CYCLES = 3.0
_MAX_SETTLE_FRACTION = 0.1
_LIKELY = 0.95


def user_onset(time_s: float) -> Onset:
    """The user's word is taken as it is."""
    return Onset(time_s, 0.0, time_s, "user", 1.0, "The start of the free decay was given by the user.")


def find_onset(data: FitData, variance: FloatArray, lowest_hz: float, wanted_hz: float | None) -> Onset:
    """Find the start of the free decay.

    Parameters
    ----------
    data : FitData
        From the first sample that may be used (after any clipping), times from there.
    variance : array, shape (k,)
        Noise variance of each channel.
    lowest_hz : float
        Below it no vibration is looked for.
    wanted_hz : float or None
        Frequency that the recording was made for, where known.

    Returns
    -------
    Onset
        Times relative to `data`.
    """
    found = candidates(data, _detrended(data), variance, lowest_hz, ())
    if not found:
        return Onset(
            0.0,
            float("nan"),
            0.0,
            "record start",
            0.0,
            "No vibration was seen, so no start of a decay either.",
        )
    frequency = found[0].frequency_hz
    if wanted_hz is not None:
        frequency = min((c.frequency_hz for c in found), key=lambda f: abs(np.log(f / wanted_hz)))
    release = _release(data, variance, frequency)
    if release is not None:
        return _released(data, release, frequency)
    change = driven_then_free(data, variance, frequency)
    if change is not None and change.probability > _LIKELY:
        return _stopped(data, change, frequency)
    confidence = 1.0 if change is None else 1.0 - change.probability
    return Onset(
        0.0,
        float("nan"),
        0.0,
        "record start",
        confidence,
        "No change from driven to free motion was found: the record is taken as a decay from its first sample.",
    )


@dataclass(frozen=True)
class _Release:
    peak_s: float
    rise_s: float


def _detrended(data: FitData) -> FloatArray:
    total = np.maximum(np.sum(data.weights, axis=0), 1e-300)
    mean = np.sum(data.weights * data.values, axis=0) / total
    return np.where(data.weights > 0.0, data.values - mean, 0.0)


def _settle(data: FitData, from_s: float, wanted_s: float) -> float:
    left = float(data.time_s[-1]) - from_s
    return from_s + min(wanted_s, _MAX_SETTLE_FRACTION * left)


def _released(data: FitData, release: _Release, frequency: float) -> Onset:
    fit_from = _settle(data, release.peak_s, 1.0 / frequency)
    note = (
        f"The structure is quiet until {release.rise_s:.4g} s and then released; the decay counts from the largest "
        f"deflection. The fit begins {fit_from - release.peak_s:.3g} s later, when the shortest transients are over."
    )
    return Onset(release.peak_s, 0.25 / frequency, fit_from, "peak", 1.0, note)


def _stopped(data: FitData, change: DrivenThenFree, frequency: float) -> Onset:
    step = float(np.median(np.diff(data.time_s)))
    settle = max(1.0 / frequency, 3.0 * step) + 3.0 * change.sd_s
    fit_from = _settle(data, change.time_s, settle)
    note = (
        f"Steady shaking ends at {change.time_s:.4f} s (sd {change.sd_s:.2g} s), found where driven motion changes "
        f"to a free decay; the fit begins {fit_from - change.time_s:.3g} s later."
    )
    return Onset(change.time_s, change.sd_s, fit_from, "model", change.probability, note)


def envelope(data: FitData, variance: FloatArray, frequency_hz: float) -> tuple[FloatArray, FloatArray]:
    """Amplitude cycle by cycle of the strongest channels together.

    Returns
    -------
    time_s, amplitude : array, shape (cycles,)
        NaN where a cycle has no samples.
    """
    values = _detrended(data)
    strong = np.argmax(np.sum(values**2, axis=0) / variance)
    x, w = values[:, strong], (data.weights[:, strong] > 0.0).astype(float)
    length = max(1.0 / frequency_hz, 4.0 * float(np.median(np.diff(data.time_s))))
    bins = (data.time_s / length).astype(int)
    count = np.bincount(bins, w)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.bincount(bins, w * x) / count
        spread = np.bincount(bins, w * x * x) / count - mean**2
    amplitude = np.where(count >= 3, np.sqrt(2.0 * np.maximum(spread, 0.0)), np.nan)
    return np.asarray((np.arange(count.size) + 0.5) * length), np.asarray(amplitude)


def _release(data: FitData, variance: FloatArray, frequency: float) -> _Release | None:
    times, amplitude = envelope(data, variance, frequency)
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
    begin = times[last_quiet]
    end = times[loud] + 1.5 / frequency
    rows = np.flatnonzero((data.time_s >= begin) & (data.time_s <= end))
    values = np.abs(_detrended(data)[rows]) * (data.weights[rows] > 0.0) / np.sqrt(variance)
    peak = int(rows[np.argmax(np.max(values, axis=1))])
    return _Release(float(data.time_s[peak]), float(begin))

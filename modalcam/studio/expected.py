"""Intervals that a run would give, predicted from a test track as `modalcam plan` predicts them from a drawing."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from modal_id.posterior.cramer_rao import modal_bound
from modalcam.planning.results import NINETY
from modalcam.planning.template_error import template_factors
from modalcam.studio.decay import amplitude_spectrum
from modalcam.studio.decoding import Problem
from tracker.arrays import FloatArray
from tracker.displacement import displacement_series
from tracker.results import MarkerTracks

# Damping is not known before the run: a steel strip, a bolted joint, a lossy one.
USUAL_DAMPING_RATIOS = (0.001, 0.003, 0.01)
# Longer records are thinned, as in `modalcam plan`.
_MOST_SAMPLES = 20_000
_LEAST_CYCLES = 3.0
# An amplitude below this many of its standard deviations is noise.
_LEAST_SIGNIFICANCE = 5.0
# The phase at the start is unknown: mean over two quadratures.
_PHASES_RAD = (0.0, 0.5 * np.pi)


@dataclass(frozen=True)
class Expected:
    """Half widths of the 90 % intervals of frequency in Hz and damping ratio, if the latter is `damping_ratio`."""

    damping_ratio: float
    frequency_hz: float
    damping: float


@dataclass(frozen=True)
class ExpectedIntervals:
    """Strongest line of a test track, its largest amplitude, and what a decay of `seconds` from there on would give."""

    frequency_hz: float
    amplitude_px: float
    seconds: float
    rows: tuple[Expected, ...]


def expected_intervals(
    tracks: MarkerTracks, frames: int, damping_ratios: tuple[float, ...] = USUAL_DAMPING_RATIOS
) -> ExpectedIntervals | Problem:
    """Predict the intervals of a recording of `frames` frames from the track of its beginning.

    Notes
    -----
    Cramer-Rao bound of a free decay that begins with the amplitudes and the standard deviations of the test track and
    lasts for the whole record (`modal_id.posterior.cramer_rao`), times the factor of the tracker's template
    (`modalcam.planning.template_error`). Errors that are not white, such as those of compression, widen the interval.
    """
    if tracks.time_axis.is_playback_guess:
        return Problem("the recorded rate is not known; type it under Recordings, and track again")
    try:
        series = displacement_series(replace(tracks, scale=None, plane=None), unit="px")
    except ValueError as error:
        return Problem(str(error))
    values, sd = series.values, np.nanmedian(series.sd, axis=0)
    usable = np.isfinite(sd) & (np.isfinite(values).sum(axis=0) > 8)
    if not usable.any():
        return Problem("no marker was followed in enough frames")
    values, sd = values[:, usable], sd[usable]
    strongest = int(np.argmax(np.nanstd(values, axis=0)))
    seen = np.isfinite(values[:, strongest])
    frequency = line_hz(series.time_s[seen], values[seen, strongest])
    if frequency * float(np.ptp(series.time_s)) < _LEAST_CYCLES:
        return Problem("the test track is shorter than three cycles of the motion; follow more frames")
    amplitude = _amplitudes(series.time_s, values, frequency)
    if np.max(amplitude / sd) * np.sqrt(0.5 * seen.sum()) < _LEAST_SIGNIFICANCE:
        return Problem("no oscillation rises above the noise in these frames; the decay may begin later")
    step_s = float(np.median(np.diff(series.time_s)))
    count = max(frames, len(series.time_s))
    rows = tuple(_expected(step_s, count, frequency, zeta, amplitude, sd) for zeta in damping_ratios)
    return ExpectedIntervals(frequency, float(np.max(amplitude)), count * step_s, rows)


def line_hz(time_s: FloatArray, values: FloatArray) -> float:
    """Frequency of the strongest line, between the bins of the spectrum by a parabola through the logarithms."""
    frequency_hz, amplitude = amplitude_spectrum(time_s, values)
    peak = int(np.argmax(amplitude))
    if not 0 < peak < len(amplitude) - 1:
        return float(frequency_hz[peak])
    low, mid, high = np.log(np.maximum(amplitude[peak - 1 : peak + 2], 1e-300))
    shift = 0.5 * (low - high) / (low - 2.0 * mid + high) if low + high < 2.0 * mid else 0.0
    return float(frequency_hz[peak] + shift * (frequency_hz[1] - frequency_hz[0]))


def _amplitudes(time_s: FloatArray, values: FloatArray, frequency_hz: float) -> FloatArray:
    """Amplitude of each channel at a frequency, beside its offset and drift; least squares."""
    phase = 2.0 * np.pi * frequency_hz * time_s
    basis = np.column_stack([np.cos(phase), np.sin(phase), np.ones_like(phase), time_s])
    found = []
    for column in values.T:
        seen = np.isfinite(column)
        cosine, sine, *_ = np.linalg.lstsq(basis[seen], column[seen], rcond=None)[0]
        found.append(np.hypot(cosine, sine))
    return np.array(found)


def _expected(
    step_s: float,
    count: int,
    frequency_hz: float,
    damping_ratio: float,
    amplitude_px: FloatArray,
    sd_px: FloatArray,
) -> Expected:
    every = -(-count // _MOST_SAMPLES)
    time_s = np.asarray(np.arange(0, count, every) * step_s, dtype=np.float64)
    # Each of the remaining samples stands for several.
    sd = sd_px / np.sqrt(every)
    bounds = [
        modal_bound(time_s, frequency_hz, damping_ratio, amplitude_px, phase, sd) for phase in _PHASES_RAD
    ]
    frequency_sd = float(np.mean([bound.frequency_sd_hz for bound in bounds]))
    damping_sd = float(np.mean([bound.damping_sd for bound in bounds]))
    factors = template_factors(time_s, frequency_hz, damping_ratio, amplitude_px, sd)
    return Expected(damping_ratio, NINETY * frequency_sd * factors[0], NINETY * damping_sd * factors[1])

"""Intervals that a run would give, predicted from a test track: its motion is continued and identified as in a run."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from modal_id import Identification, IdentifySettings, identify_free_decay
from modal_id.solve import mode_functions, pole
from modalcam.studio.decay import amplitude_spectrum
from modalcam.studio.decoding import Problem
from tracker import ComplexArray, DisplacementSeries, FloatArray, MarkerTracks, displacement_series

# Damping is not known before the run: a steel strip, a bolted joint, a lossy one.
USUAL_DAMPING_RATIOS = (0.001, 0.003, 0.01)
_LEAST_CYCLES = 3.0
# An amplitude below this many of its standard deviations is noise.
_LEAST_SIGNIFICANCE = 5.0
_LEVEL = 0.9


@dataclass(frozen=True)
class ExpectedTask:
    """Test track of a recording of `frames` frames, and the damping ratios to assume."""

    tracks: MarkerTracks
    frames: int
    damping_ratios: tuple[float, ...] = USUAL_DAMPING_RATIOS


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


def expected_intervals(task: ExpectedTask) -> ExpectedIntervals | Problem:
    """Predict the intervals of a recording from the track of its beginning.

    Notes
    -----
    The motion of the strongest line is continued as a free decay to the end of the record, with white noise of the
    standard deviations of the test track, and identified with the errors of positions that compression and template
    cause in a run (`tracker.position_errors`). Other modes and amplitude-dependent damping widen the interval further.
    """
    if task.tracks.time_axis.is_playback_guess:
        return Problem("the recorded rate is not known; type it under Recordings, and track again")
    try:
        series = displacement_series(replace(task.tracks, scale=None, plane=None), unit="px")
    except ValueError as error:
        return Problem(str(error))
    usable = np.isfinite(series.sd).any(axis=0) & (np.isfinite(series.values).sum(axis=0) > 8)
    if not usable.any():
        return Problem("no marker was followed in enough frames")
    # Channels without samples are left out, as in a run.
    series = replace(series, values=np.where(usable, series.values, np.nan))
    sd = _typical_sd(series)
    spread = [float(np.ptp(v[np.isfinite(v)])) if np.isfinite(v).any() else -1.0 for v in series.values.T]
    strongest = int(np.argmax(spread))
    seen = np.isfinite(series.values[:, strongest])
    frequency = line_hz(series.time_s[seen], series.values[seen, strongest])
    if frequency * float(np.ptp(series.time_s)) < _LEAST_CYCLES:
        return Problem("the test track is shorter than three cycles of the motion; follow more frames")
    steady = np.abs(_amplitudes(series, pole(2.0 * np.pi * frequency, 0.0)))
    if np.nanmax(steady / sd) * np.sqrt(0.5 * seen.sum()) < _LEAST_SIGNIFICANCE:
        return Problem("no oscillation rises above the noise in these frames; the decay may begin later")
    step_s = float(np.median(np.diff(series.time_s)))
    time_s = np.asarray(np.arange(max(task.frames, series.time_s.size)) * step_s, dtype=np.float64)
    found = [_expected(series, time_s, frequency, zeta) for zeta in task.damping_ratios]
    rows = tuple(one for one in found if isinstance(one, Expected))
    if not rows:
        return next(one for one in found if isinstance(one, Problem))
    return ExpectedIntervals(frequency, float(np.nanmax(steady)), time_s.size * step_s, rows)


def line_hz(time_s: FloatArray, values: FloatArray) -> float:
    """Frequency of the strongest line, between the bins of the spectrum by a parabola through the logarithms."""
    frequency_hz, amplitude = amplitude_spectrum(time_s, values)
    peak = int(np.argmax(amplitude))
    if not 0 < peak < len(amplitude) - 1:
        return float(frequency_hz[peak])
    low, mid, high = np.log(np.maximum(amplitude[peak - 1 : peak + 2], 1e-300))
    shift = 0.5 * (low - high) / (low - 2.0 * mid + high) if low + high < 2.0 * mid else 0.0
    return float(frequency_hz[peak] + shift * (frequency_hz[1] - frequency_hz[0]))


def _typical_sd(series: DisplacementSeries) -> FloatArray:
    """Median standard deviation of each channel; NaN where it has no position."""
    return np.array([np.median(c[np.isfinite(c)]) if np.isfinite(c).any() else np.nan for c in series.sd.T])


def _amplitudes(series: DisplacementSeries, rate_per_s: ComplexArray) -> ComplexArray:
    """Complex amplitude of each channel at the first frame for a pole, beside offset and drift; least squares."""
    time_s = series.time_s - series.time_s[0]
    wave = mode_functions(time_s, np.atleast_1d(rate_per_s))[:, 0]
    basis = np.column_stack([wave.real, -wave.imag, np.ones_like(time_s), time_s])
    found = np.full(len(series.channels), complex(np.nan, np.nan))
    for k, column in enumerate(series.values.T):
        seen = np.isfinite(column)
        if seen.any():
            cosine, sine, *_ = np.linalg.lstsq(basis[seen], column[seen], rcond=None)[0]
            found[k] = complex(cosine, sine)
    return found


def _expected(
    series: DisplacementSeries, time_s: FloatArray, frequency_hz: float, damping_ratio: float
) -> Expected | Problem:
    """Intervals of the decay that the test track begins, for one damping ratio."""
    rate_per_s = np.atleast_1d(pole(2.0 * np.pi * frequency_hz, damping_ratio))
    motion = np.real(mode_functions(time_s, rate_per_s) * _amplitudes(series, rate_per_s))
    sd = np.broadcast_to(_typical_sd(series), motion.shape)
    noise = np.random.default_rng(0).normal(size=motion.shape)
    decay = replace(
        series,
        time_s=time_s,
        values=motion + sd * noise,
        sd=sd,
        base=None,
        base_sd=None,
        scale_change=None,
    )
    settings = IdentifySettings(target_frequency_hz=frequency_hz, max_modes=1)
    found = identify_free_decay(decay, settings)
    mode = found.target if isinstance(found, Identification) else None
    if mode is None:
        return Problem("the noise hides the decay; follow a point that moves more or has more contrast")
    slow, fast = mode.frequency_interval_hz(_LEVEL)
    low, high = mode.damping_interval(_LEVEL)
    return Expected(damping_ratio, 0.5 * (fast - slow), 0.5 * (high - low))

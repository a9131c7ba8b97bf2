"""What the figures show of a decay beyond the fit: single modes, envelopes, spectra, and quality of the tracking.

The latter compares the stated standard deviations of positions with the scatter that the series themselves show.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from modal_id import Identification, IdentifiedMode
from modal_id.data import FitData
from modal_id.fit import StabilityDiagram, stability_diagram
from modalcam.pipeline import RecordingResult, RunResult
from sim.comparison import DecayComparison, ModelDecay
from sim.damping import DAMPING_MODELS
from tracker import ComplexArray, FloatArray, IntArray, MarkerTracks, flags, robust_sd
from tracker.template import noise, prediction

_ENVELOPE_POINTS = 160


@dataclass(frozen=True)
class Tuning:
    """What of a decay is worth drawing."""

    #: [1] a window whose scatter allows its line to change by more, in log amplitude, is noise
    #: convention: A factor of 1.6 within one window.
    loudest_change: float = 0.5
    #: [1] tip amplitude, in lengths to the last marker, beyond which variants of a model are drawn
    #: convention: Below it their curves lie on each other.
    large_amplitude: float = 0.01


TUNING = Tuning()


def shown_mode(found: Identification) -> IdentifiedMode | None:
    """The mode that a recording's figures are about: its target, else the one of the largest amplitude."""
    return found.target or max(found.fitted_modes, key=lambda mode: mode.amplitude, default=None)


def main_modes(found: Identification) -> list[IdentifiedMode]:
    """The modes that the recording was made for: its targets, else the one shown."""
    shown = shown_mode(found)
    return [mode for mode in found.modes if mode.target or mode is shown]


def shown_channel(found: Identification) -> int:
    """The channel used in the fit that moves most: in the mode shown, or in the record where there is none."""
    mode = shown_mode(found)
    if mode is not None:
        size = np.abs(mode.shape)
    else:
        values = found.series.values
        size = np.array([np.ptp(c[np.isfinite(c)]) if np.isfinite(c).any() else 0.0 for c in values.T])
    return int(np.argmax(np.where(found.channels_used, np.nan_to_num(size), -1.0)))


def best_modes(result: RunResult) -> dict[int, tuple[str, IdentifiedMode]]:
    """Recording and mode of each number: a recording's target first, then the smallest standard deviation."""
    best: dict[int, tuple[str, IdentifiedMode]] = {}
    for recording in result.recordings:
        for mode in recording.identified.modes if recording.identified else ():
            if mode.number is not None:
                one = (recording.name, mode)
                best[mode.number] = max(
                    best.get(mode.number, one), one, key=lambda own: (own[1].target, -own[1].frequency_sd_hz)
                )
    return best


def widest_and_narrowest(result: RunResult) -> list[RecordingResult]:
    """Decays whose damping ratio has the largest relative standard deviation and the smallest, the first one first.

    A mode whose values may be wrong comes before all others; one decay where there is only one, none without any.
    """
    doubts: list[tuple[bool, float, RecordingResult]] = []
    for recording in result.recordings:
        found = recording.identified
        mode = shown_mode(found) if found is not None and found.has_decay else None
        if mode is not None:
            relative_sd = mode.damping_ratio_sd / max(abs(mode.damping_ratio), np.finfo(float).tiny)
            doubts.append((bool(mode.wrong_flags), relative_sd, recording))
    doubts.sort(key=lambda doubt: doubt[:2], reverse=True)
    return [recording for *_, recording in (doubts[:1] + doubts[1:][-1:])]


def mode_motion(mode: IdentifiedMode, since_s: FloatArray, channel: int) -> FloatArray:
    """Eq. 1 for one channel: ``Re(shape exp(lambda t))``, t counted from the start of the fit; shape as `since_s`."""
    omega = mode.omega_n_rad_s
    pole = complex(-mode.damping_ratio * omega, omega * np.sqrt(max(1.0 - mode.damping_ratio**2, 0.0)))
    return np.real(mode.shape[channel] * np.exp(pole * since_s))


def highest(x: FloatArray, values: FloatArray, columns: int) -> tuple[FloatArray, FloatArray]:
    """The largest value of each of at most `columns` runs of neighbours, and the middle of each run."""
    if x.size <= columns:
        return x, values
    starts = np.linspace(0, x.size, columns + 1).astype(np.intp)[:-1]
    stops = np.append(starts[1:], x.size)
    return 0.5 * (x[starts] + x[stops - 1]), np.maximum.reduceat(values, starts)


def residual(found: Identification) -> FloatArray:
    """Measured minus fitted at the samples used, NaN elsewhere; shape (n, k)."""
    return np.where(found.used, found.series.values - found.fitted, np.nan)


def nrmse_of_fit(found: Identification) -> float:
    """Rms of the fit's residual over that of the measured motion, baseline removed: the floor of any simulation."""
    if not found.used.any():
        return float("nan")
    motion = (found.series.values - found.baseline)[found.used]
    power = float(np.mean(motion**2))
    return float(np.sqrt(np.mean(residual(found)[found.used] ** 2) / power)) if power > 0.0 else float("nan")


def measured_envelope(
    found: Identification, mode: IdentifiedMode, channel: int
) -> tuple[FloatArray, FloatArray]:
    """Amplitude of one mode in the record itself, span by span.

    The baseline and the other modes as fitted are subtracted; a sine and a cosine of the mode's frequency are then
    fitted to spans of a whole number of cycles.

    Returns
    -------
    time_s, amplitude : array
        Middle of each span; spans less than half filled are left out.
    """
    middles, coefficients = _spans(found, mode, channel)
    return middles, np.abs(coefficients)


class Windows(NamedTuple):
    """Amplitude, frequency and damping ratio of the windows of a record, with standard deviations; shape (w,) each."""

    amplitude: FloatArray
    frequency_hz: FloatArray
    frequency_sd_hz: FloatArray
    damping_ratio: FloatArray
    damping_ratio_sd: FloatArray


def instantaneous(found: Identification, mode: IdentifiedMode, channel: int) -> Windows:
    """Frequency and damping ratio of one mode window by window, by straight lines through phase and log amplitude.

    Each of at most 12 windows holds equally many spans of `measured_envelope`, at least five; standard deviations are
    those of the lines' slopes by their own scatter. Windows dominated by noise are left out.
    """
    middles, coefficients = _spans(found, mode, channel)
    omega = mode.omega_n_rad_s
    rows = []
    for part in np.array_split(np.arange(middles.size), max(1, min(12, middles.size // 5))):
        if part.size < 5 or not np.all(coefficients[part]):
            continue
        t, log_amplitude = middles[part], np.log(np.abs(coefficients[part]))
        decay, decay_sd = line_slope(t, log_amplitude)
        phase, phase_sd = line_slope(t, np.unwrap(np.angle(coefficients[part])))
        if decay_sd * np.ptp(t) > TUNING.loudest_change:
            continue
        amplitude = np.exp(np.mean(log_amplitude))
        frequency = mode.frequency_hz - phase / (2.0 * np.pi), phase_sd / (2.0 * np.pi)
        rows.append((amplitude, *frequency, -decay / omega, decay_sd / omega))
    return Windows(*np.array(rows).reshape(-1, 5).T)


def line_slope(x: FloatArray, y: FloatArray) -> tuple[float, float]:
    """Slope of the straight line through at least three points, and its standard deviation by their scatter."""
    x, y = x - np.mean(x), y - np.mean(y)
    square = float(x @ x)
    slope = float(x @ y) / square
    left = y - slope * x
    return slope, float(np.sqrt(left @ left / (x.size - 2) / square))


def _spans(found: Identification, mode: IdentifiedMode, channel: int) -> tuple[FloatArray, ComplexArray]:
    """Middle of each span and the amplitude ``a + i b`` of ``a cos + b sin`` in it."""
    time_s = found.series.time_s
    since = time_s - found.onset.fit_from_s
    rest = found.series.values[:, channel] - found.baseline[:, channel]
    for other in found.fitted_modes:
        if other is not mode:
            rest = rest - mode_motion(other, since, channel)
    good = found.used[:, channel] & np.isfinite(rest)
    if np.count_nonzero(good) < 8:
        return np.empty(0), np.empty(0, dtype=complex)
    end = float(time_s[good][-1])
    step = float(np.median(np.diff(time_s)))
    cycles = max(1, int((end - found.onset.fit_from_s) / _ENVELOPE_POINTS * mode.frequency_hz))
    span_s = max(cycles, np.ceil(6.0 * step * mode.frequency_hz)) / mode.frequency_hz
    edges = np.arange(found.onset.fit_from_s, end + span_s, span_s)
    omega_d = mode.omega_n_rad_s * np.sqrt(max(1.0 - mode.damping_ratio**2, 0.0))
    middles, sizes = [], []
    for start, stop in pairwise(np.searchsorted(time_s, edges)):
        inside = np.arange(start, stop)[good[start:stop]]
        if inside.size < max(5, 0.5 * span_s / step):
            continue
        phase = omega_d * since[inside]
        basis = np.column_stack((np.cos(phase), np.sin(phase)))
        cosine, sine = np.linalg.lstsq(basis, rest[inside], rcond=None)[0]
        middles.append(np.mean(time_s[inside]))
        sizes.append(complex(cosine, sine))
    return np.array(middles), np.array(sizes, dtype=complex)


def stability_of(found: Identification) -> StabilityDiagram | None:
    """Poles of the samples that were fitted; None without modes or with a measured input, and for too few samples."""
    chosen = np.flatnonzero(found.channels_used)
    rows = np.flatnonzero(found.used[:, chosen].any(axis=1))
    if not found.modes or rows.size < 2 or found.response is not None:
        return None
    cells = np.ix_(rows, chosen)
    fitted = found.used & np.isfinite(found.series.values)
    if found.ambient is None:
        fitted &= np.isfinite(found.baseline)
    weights = fitted[cells].astype(float)
    time_s = found.series.time_s[rows] - found.series.time_s[rows[0]]
    data = FitData(time_s, np.where(weights > 0.0, found.series.values[cells], 0.0), weights)
    mean = np.sum(weights * data.values, axis=0) / np.maximum(np.sum(weights, axis=0), 1.0)
    slow = np.broadcast_to(mean, weights.shape) if found.ambient else found.baseline[cells]
    baseline = np.where(weights > 0.0, slow, 0.0)
    return stability_diagram(data, baseline, max(mode.frequency_hz for mode in found.modes))


def spectral_density(time_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Spectral density (value's unit per root hertz) of a channel with missing samples.

    Samples are put on a grid of the median step and missing ones count as zero, so that their lack lowers and smears
    lines rather than making new ones; good for looking, not for estimating. A Hann window is applied.

    Returns
    -------
    frequency_hz, density : array
        Empty when fewer than 16 samples are finite.
    """
    good = np.isfinite(values)
    if np.count_nonzero(good) < 16:
        return np.empty(0), np.empty(0)
    if not np.all(good):
        time_s, values = time_s[good], values[good]
    step = float(np.median(np.diff(time_s)))
    grid, power = _windowed(np.rint((time_s - time_s[0]) / step).astype(np.intp), values)
    density = np.abs(np.fft.rfft(grid))
    density *= np.sqrt(2.0 * step / power)
    return np.asarray(np.fft.rfftfreq(grid.size, step)[1:]), np.asarray(density[1:])


def _windowed(index: NDArray[np.intp], values: FloatArray) -> tuple[FloatArray, float]:
    """Values less their mean at places of a grid, 0 at the others, times a Hann window; power of the window there."""
    # In place: a record of a million samples is shown, too.
    count = np.bincount(index)
    grid = np.asarray(np.bincount(index, weights=values - np.mean(values)), dtype=np.float64)
    grid /= np.maximum(count, 1)
    window = np.hanning(grid.size)
    grid *= window
    window *= count > 0
    return grid, float(window @ window)


def decay_of(comparison: DecayComparison, model: str) -> ModelDecay | None:
    """The decay simulated with one model; None where there is none."""
    return next((decay for decay in comparison.models if decay.model == model), None)


def drawn_decays(comparison: DecayComparison) -> tuple[ModelDecay, ...]:
    """Decays for the figure: a variant only where the amplitude is large enough to show how it differs."""
    large = comparison.tip_amplitude_mm > TUNING.large_amplitude * float(np.max(comparison.positions_mm))
    return tuple(d for d in comparison.models if large or DAMPING_MODELS[d.model].variant_of is None)


# Bins of time in which residuals are pooled.
BINS = 60


@dataclass(frozen=True)
class TrackingQuality:
    """Stated standard deviations and measured scatter.

    Median sd and scatter of x and of y of each marker, shape (2, m), NaN where a series is too short; middle of each
    bin of time, and rms of residual over stated sd of all markers within it, shape (b,).
    """

    stated_px: FloatArray
    scatter_px: FloatArray
    bin_time_s: FloatArray
    ratio: FloatArray


def tracking_quality(tracks: MarkerTracks) -> TrackingQuality | None:
    """Compare stated sd with scatter; None where no series is long enough.

    The scatter is what a linear prediction from neighbours on both sides leaves of each sample: vibration of a few
    frequencies is predictable, errors from frame to frame are not. Errors slower than a few frames are not seen.
    """
    m = len(tracks.markers)
    stated, scatter = np.full((2, m), np.nan), np.full((2, m), np.nan)
    edges = _bins(tracks.time_s.size)
    squares, count = np.zeros(edges.size - 1), np.zeros(edges.size - 1)
    repeated = (tracks.flags & flags.LEFT_OUT) > 0
    axes = ((tracks.x_px, tracks.sd_x_px), (tracks.y_px, tracks.sd_y_px))
    for c, (values, sd) in enumerate(axes):
        for k in range(m):
            residual = prediction_residual(np.where(repeated[:, k], np.nan, values[:, k]))
            good = np.isfinite(residual) & (sd[:, k] > 0.0)
            if np.count_nonzero(good) < noise.TUNING.neighbours:
                continue
            stated[c, k] = np.median(sd[good, k])
            # A median: a few lost frames or jumps are not the scatter of the rest.
            scatter[c, k] = robust_sd(residual[good])
            residual = np.where(good, residual, 0.0)
            residual[good] /= sd[good, k]
            squares += np.add.reduceat(residual**2, edges[:-1])
            count += np.add.reduceat(good.astype(float), edges[:-1])
    if not np.isfinite(scatter).any():
        return None
    middle_s = 0.5 * (tracks.time_s[edges[:-1]] + tracks.time_s[edges[1:] - 1])
    with np.errstate(invalid="ignore"):
        return TrackingQuality(stated, scatter, middle_s, np.sqrt(squares / count))


def prediction_residual(series: FloatArray) -> FloatArray:
    """Part of each sample that its neighbours on both sides do not predict, scaled to the sd of white errors.

    Parameters
    ----------
    series : array, shape (n,)
        NaN where missing.

    Returns
    -------
    array, shape (n,)
        NaN at both ends, where a neighbour is missing, and everywhere in a series that is too short.
    """
    residual, sd = prediction(series, first=1, count=noise.TUNING.neighbours)
    residual /= sd
    return residual


def _bins(samples: int) -> IntArray:
    """First sample of each bin, and the number of samples."""
    return np.linspace(0, samples, min(BINS, max(samples // 20, 1)) + 1).astype(np.int64)

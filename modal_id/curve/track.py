"""Complex amplitude of a mode in short blocks of the record, and the noise level of the residual of a flexible law."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from modal_id.curve.law_fit import LawFit, fit_law, wave_of_law
from modal_id.curve.laws import Law, SplineLaw
from modal_id.data import AT_ONCE, MIN_SAMPLES, FitData
from modal_id.fit import LEAST_SAMPLES, ModalFit
from modal_id.solve import MAX_CONDITION, Problem, frequency_hz, own_problem
from tracker import BoolArray, ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Blocks, and the flexible law, of the amplitude curve."""

    #: [cycles] shortest part of a record in which a mode is told from slow motion
    #: physics: In one cycle, no bin above zero lies below the frequency of the mode.
    least_cycles: float = 2.0
    #: [1] largest number of blocks
    max_blocks: int = 300
    #: [sd] amplitude below which the blocks that follow are no longer used
    least_snr: float = 4.0
    #: [1] sum of squared amplitudes over noise variance, to the end, that determines the rates
    #: statistics: Ten standard deviations.
    least_energy: float = 100.0
    #: [blocks] half-width of the window over which the noise is averaged
    window: int = 7
    #: [1] number of passes, each of which estimates the noise and repeats the fit
    passes: int = 3
    #: [1] knots per unit of the log amplitude
    knots_per_unit: float = 3.0
    #: [1] largest number of knots
    most_knots: int = 16
    #: [blocks] fewest blocks per knot
    blocks_per_knot: int = 4


TUNING = Tuning()
LEAST_CYCLES = TUNING.least_cycles


@dataclass(frozen=True)
class Blocks:
    """The mode's motion relative to a reference decay, block by block.

    Attributes
    ----------
    time_s : array, shape (b,)
        Centre of the samples of each block.
    ratio : complex array, shape (b,)
        Motion divided by the reference, all channels combined by their amplitude and noise.
    variance : array, shape (b,)
        Of the real and of the imaginary part of `ratio`, for white noise.
    """

    time_s: FloatArray
    ratio: ComplexArray
    variance: FloatArray


def split_into_blocks(
    problem: Problem,
    reference: ComplexArray,
    shape: ComplexArray,
    noise_variance: FloatArray,
    frequency_hz: float,
) -> Blocks:
    """Least-squares fit of the reference decay, an offset and a slope to each block.

    `problem` contains the motion of this mode only, with noise and baseline; `reference` is its decay with amplitude 1
    at the start, shape (n,); `shape` and `noise_variance`, shape (k,), are the channels' amplitudes and noise. Slow
    motion and harmonics of the mode average out within a block of whole cycles.
    """
    data = problem.data
    time_s = data.time_s
    cycles = max(LEAST_CYCLES, np.ceil(data.span_s * frequency_hz / TUNING.max_blocks))
    number = ((time_s - time_s[0]) * frequency_hz / cycles).astype(np.intp)
    edges = np.append(np.flatnonzero(np.diff(number, prepend=-1)), number.size)
    at_once = max(1, AT_ONCE * (edges.size - 1) // number.size)
    parts = []
    for first in range(0, edges.size - 1, at_once):
        own = edges[first : first + at_once + 1]
        rows = slice(own[0], own[-1])
        whole_s = 0.8 * cycles / frequency_hz
        parts.append(_fit(data.rows(rows), own - own[0], reference[rows], shape, noise_variance, whole_s))
    total, weight, scale, mean_s = (np.concatenate(part) for part in zip(*parts, strict=True))
    # Where the reference is lost in rounding, a block contains nothing of the mode.
    used = (weight > 0.0) & (scale > np.finfo(float).eps * np.max(scale))
    total, weight, scale = total[used], weight[used], scale[used]
    return Blocks(mean_s[used], np.asarray(total / weight / scale, dtype=complex), 1.0 / (weight * scale**2))


def _fit(
    data: FitData,
    edges: NDArray[np.intp],
    reference: ComplexArray,
    shape: ComplexArray,
    noise_variance: FloatArray,
    whole_s: float,
) -> tuple[ComplexArray, FloatArray, FloatArray, FloatArray]:
    """Weighted sum of the ratios, sum of the weights, largest reference and mean time of each of some blocks.

    The weight of a block is 0 where its samples span less than `whole_s` or do not determine the ratio.
    """
    time_s, starts, count = data.time_s, edges[:-1], np.diff(edges)
    first, last = time_s[starts], time_s[starts + count - 1]
    whole = (count >= LEAST_SAMPLES) & (last - first >= whole_s)
    scale = np.maximum(np.maximum.reduceat(np.abs(reference), starts), 1e-300)
    wave = reference / np.repeat(scale, count)
    since = (time_s - np.repeat(0.5 * (first + last), count)) / np.repeat(
        np.maximum(0.5 * (last - first), 1e-300), count
    )
    columns = np.stack([wave.real, wave.imag, np.ones(time_s.size), since], axis=1)
    size = np.abs(shape) ** 2 / noise_variance
    total, weight = np.zeros(starts.size, dtype=complex), np.zeros(starts.size)
    for channels, weights in data.groups:
        inverse, known = _inverses(columns, weights, starts)
        known &= whole
        weighted = weights[:, None] * data.values[:, channels]
        moment = np.stack([_block_sums(one[:, None] * weighted, starts) for one in columns.T], axis=1)
        found = inverse @ moment
        precision = np.where(known, 2.0 / (inverse[:, 0, 0] + inverse[:, 1, 1]), 0.0)
        # Re(c q wave) = q' . (Re wave, Im wave) with c q = q'_0 - i q'_1.
        share = np.conj(shape[channels]) / noise_variance[channels]
        total += precision * ((found[:, 0] - 1j * found[:, 1]) @ share)
        weight += precision * float(np.sum(size[channels]))
    return total, weight, scale, _block_sums(time_s, starts) / count


def _block_sums(values: FloatArray, starts: NDArray[np.intp]) -> FloatArray:
    return np.asarray(np.add.reduceat(values, starts, axis=0))


def _inverses(
    columns: FloatArray, weights: FloatArray, starts: NDArray[np.intp]
) -> tuple[FloatArray, BoolArray]:
    """Inverse Gram matrix of each block, and whether its samples determine it."""
    p = columns.shape[1]
    normal = np.empty((starts.size, p, p))
    for row in range(p):
        own = columns[:, row] * weights
        normal[:, row, row:] = _block_sums(own[:, None] * columns[:, row:], starts)
        normal[:, row:, row] = normal[:, row, row:]
    enough = np.add.reduceat((weights > 0.0).astype(np.intp), starts) >= LEAST_SAMPLES
    normal[~enough] = np.eye(p)
    known = enough & (np.linalg.cond(normal) <= MAX_CONDITION)
    normal[~known] = np.eye(p)
    return np.asarray(np.linalg.inv(normal), dtype=float), np.asarray(known, dtype=bool)


# Prior standard deviations of the changes of the flexible law, relative to decay rate and frequency.
DECAY_CHANGE, ANGULAR_CHANGE = 1.6, 0.0125


@dataclass(frozen=True)
class Track:
    """Complex amplitude of a mode in blocks of the record.

    Attributes
    ----------
    time_s : array, shape (b,)
    measured : complex array, shape (b,)
        Motion of all channels relative to the mode's shape, rotating at the frequency of the mode.
    variance : array, shape (b,)
        Of the real and of the imaginary part; it varies with time and includes the correlation of the residual.
    between : array, shape (b,)
        The same estimated from differences between neighbouring blocks: the noise beside the mode.
    lowest : float
        Lowest amplitude, relative to the start, that the record determines.
    decay, angular : float
        Rates of the constant pole in 1/s and rad/s.
    """

    time_s: FloatArray
    measured: ComplexArray
    variance: FloatArray
    between: FloatArray
    lowest: float
    decay: float
    angular: float

    def fit(self, law: Law, start: FloatArray) -> LawFit | None:
        """The law fitted to the track."""
        return fit_law(law, self.time_s, self.measured, self.variance, start)

    def residual_power(self, fitted: LawFit) -> float:
        """Mean power of the residual of this fit relative to the noise beside the mode."""
        free = np.maximum(1.0 - fitted.leverage, 0.2)
        return float(np.mean(0.5 * np.abs(fitted.residual) ** 2 / (self.between * free)))

    def with_noise_around(self, fitted: LawFit) -> Track:
        """The same track with the noise of the residual of this fit."""
        return replace(self, variance=_around(fitted) * _correlated(fitted))

    def spline(self, decay_change: float = DECAY_CHANGE, angular_change: float = ANGULAR_CHANGE) -> SplineLaw:
        """Spline over the track's amplitudes; changes relative to the rates of the constant pole."""
        bend = min(2.0 * self.lowest, 1.0)
        most = min(TUNING.most_knots, self.time_s.size // TUNING.blocks_per_knot)
        knots = int(np.clip(2.0 + np.ceil(TUNING.knots_per_unit * np.log1p(1.0 / bend)), 3, most))
        return SplineLaw(knots, decay_change * self.decay, angular_change * self.angular, bend)


def follow(own: ModalFit) -> tuple[Track, LawFit | None] | None:
    """Track of the first mode of a fit from `own_decay` and the flexible spline fitted to it, None where no law fits.

    None for both where the record is too short or too noisy: fewer than 12 blocks of two or more cycles.
    """
    pole = complex(own.fit.poles[0])
    if pole.real >= 0.0:
        return None
    alone, linear = own_problem(own.problem, own.fit, np.array([0])), own.fit.linear
    seen = _Seen(alone, linear.amplitudes[0], linear.noise_variance, pole)
    wave: ComplexArray | None = np.exp(pole * alone.data.time_s)
    track, fitted, variance = None, None, None
    for _ in range(TUNING.passes):
        track = None if wave is None else seen.track(wave, variance)
        if track is None:
            return None
        law = track.spline()
        fitted = track.fit(law, _start(track, law))
        if fitted is None:
            return track, None
        wave, variance = seen.wave(fitted), _around(fitted)
    if track is None or fitted is None:
        return None
    track = track.with_noise_around(fitted)
    return track, track.fit(fitted.law, fitted.parameters)


@dataclass(frozen=True)
class _Seen:
    """Motion of one mode alone, its shape, noise and pole."""

    alone: Problem
    shape: ComplexArray
    noise_variance: FloatArray
    pole: complex

    def wave(self, fitted: LawFit) -> ComplexArray | None:
        """Fitted decay at the samples."""
        found = wave_of_law(self.alone.data.time_s, fitted.law, fitted.parameters)
        return None if found is None else found * fitted.initial

    def track(self, wave: ComplexArray, variance: FloatArray | None) -> Track | None:
        """Track from blocks relative to a decay near the true one; without `variance`, its noise is `between`."""
        time_s, frequency = self.alone.data.time_s, float(frequency_hz(self.pole))
        if not np.all(np.isfinite(wave)):
            return None
        blocks = split_into_blocks(self.alone, wave, self.shape, self.noise_variance, frequency)
        if blocks.time_s.size < MIN_SAMPLES:
            return None
        phase = np.interp(blocks.time_s, time_s, np.unwrap(np.angle(wave)))
        at = np.interp(blocks.time_s, time_s, np.abs(wave)) * np.exp(1j * phase)
        measured = blocks.ratio * at
        between = _between_neighbours(blocks.ratio) * np.abs(at) ** 2
        loud = _moving_mean(np.abs(measured) / np.sqrt(between), 2) > TUNING.least_snr
        last = int(np.argmin(np.append(loud, False)))
        if last < MIN_SAMPLES:
            return None
        known = (
            between[:last] if variance is None else variance[np.minimum(np.arange(last), variance.size - 1)]
        )
        return _track(blocks.time_s[:last], measured[:last], known, between[:last], self.pole)


def _track(
    time_s: FloatArray, measured: ComplexArray, variance: FloatArray, between: FloatArray, pole: complex
) -> Track:
    later = np.cumsum((np.abs(measured) ** 2 / variance)[::-1])[::-1]
    at = int(np.count_nonzero(later > TUNING.least_energy)) - 1
    lowest = float(np.abs(measured[max(at, 0)]) / np.max(np.abs(measured)))
    return Track(time_s, measured, variance, between, min(lowest, 1.0), -pole.real, pole.imag)


def _start(track: Track, law: SplineLaw) -> FloatArray:
    """Starting values: slopes of ln a and of the phase over the blocks with about the amplitude of each knot."""
    log_a = np.log(np.abs(track.measured))
    log_a -= np.max(log_a)
    phase = np.unwrap(np.angle(track.measured * np.exp(-1j * track.angular * track.time_s)))
    weight = np.abs(track.measured) ** 2 / track.variance
    reach = np.log1p(1.0 / law.lowest) / (law.knots - 1)
    decay, angular = [], []
    for knot in np.log(np.maximum(law.knot_amplitudes, np.exp(np.min(log_a)))):
        distance = np.abs(log_a - knot)
        near = np.argsort(distance, kind="stable")[: max(6, int(np.count_nonzero(distance < reach)))]
        own = weight[near] / np.sum(weight[near])
        since = track.time_s[near] - float(own @ track.time_s[near])
        square = float(own @ since**2)
        decay.append(max(-float(own @ (since * log_a[near])) / square, 0.1 * track.decay))
        angular.append(track.angular + float(own @ (since * phase[near])) / square)
    return law.parameters(np.array(decay), np.array(angular))


def _between_neighbours(ratio: ComplexArray) -> FloatArray:
    """Variance of real and imaginary part from second differences, averaged over neighbouring blocks."""
    second = np.abs(ratio[2:] - 2.0 * ratio[1:-1] + ratio[:-2]) ** 2 / 12.0
    return np.maximum(_moving_mean(np.pad(second, 1, mode="edge"), TUNING.window), 1e-20 * np.abs(ratio) ** 2)


def _around(fitted: LawFit) -> FloatArray:
    """Variance of the residual, averaged over neighbouring blocks.

    A variance estimated with n degrees of freedom makes the fit seem more precise than it is: by n / (n - 2) in the
    stated variance, and once more because its weights are not the best ones.
    """
    own = 0.5 * np.abs(fitted.residual) ** 2 / np.maximum(1.0 - fitted.leverage, 0.3)
    window = np.ones(2 * min(TUNING.window, (own.size - 1) // 2) + 1)
    count = np.convolve(np.ones(own.size), window, "same")
    dof = 2.0 * count
    mean = np.convolve(own, window, "same") / count
    return np.maximum(mean * (dof / (dof - 2.0)) ** 2, 1e-20 * np.abs(fitted.wave) ** 2)


def _correlated(fitted: LawFit) -> float:
    """Factor on the variance of slow changes, at least 1: that of a first-order autoregressive residual."""
    white = fitted.residual / np.sqrt(_around(fitted))
    following = float(np.real(np.sum(white[1:] * np.conj(white[:-1]))) / np.sum(np.abs(white) ** 2))
    following = float(np.clip(following, 0.0, 0.9))
    return (1.0 + following) / (1.0 - following)


def _moving_mean(values: FloatArray, half: int) -> FloatArray:
    half = min(half, values.size - 1)
    padded = np.pad(values, half, mode="reflect")
    return np.asarray(np.convolve(padded, np.full(2 * half + 1, 1.0 / (2 * half + 1)), "valid"))

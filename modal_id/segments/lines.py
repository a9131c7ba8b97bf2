"""Strongest lines of a record: their frequencies, the slow swing below them, and their amplitudes in blocks."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from modal_id.data import FitData, baseline_splines, detrended
from modal_id.fit import Candidate, candidates, fit_damped, residual_spectrum
from modal_id.solve import Problem, frequency_hz, no_columns, solve_linear
from tracker import ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """The dominant motion, swings of the whole set-up, and blocks of a record."""

    #: [1] largest frequency of a swing over that of the motion
    slow: float = 0.25
    #: [1] bandwidth of the splines over the frequency of the swing
    #: physics: They follow a sine within 1e-3 of its amplitude.
    followed: float = 6.0
    #: [samples] shortest window
    least_window: int = 32
    #: [1] number of deflections after which a wave is looked for where there is no line
    #: convention: Clicks and steps may be larger than the motion.
    most_peaks: int = 4
    #: [1] logarithm of the ratio of frequencies within which windows show one line
    same_line: float = 0.2
    #: [cycles] shortest window
    least_window_cycles: float = 6.0
    #: [1] largest number of lines in which changes of the motion are looked for
    #: convention: Limits the computing time.
    most_tones: int = 3
    #: [1] least distance of these lines over the dominant frequency
    #: physics: A block of two cycles fitted with both lines separates them.
    resolved: float = 0.75
    #: [cycles] shortest block
    #: physics: Two separate a wave from an offset and its slope.
    cycles: float = 2.0
    #: [samples] shortest block
    least_rows: int = 8
    #: [1] largest number of blocks
    #: convention: The time of a division grows with its cube.
    most_blocks: int = 128
    #: [1] share of a block's samples that must be there
    complete: float = 0.6
    #: [1] least noise of a sample over its channel's largest value
    #: convention: Values without noise would divide at every rounding error.
    least_noise: float = 1e-6


TUNING = Tuning()


# A swing has fewer cycles than this, and less than this share of the frequency of the motion.
FEW_CYCLES = 12.0


def without_swing(data: FitData, variance: FloatArray, frequency_hz: float, detrended: FloatArray) -> FitData:
    """The data less its slow motion, where that has a line of few cycles far below `frequency_hz`.

    `variance`, shape (k,), is the noise variance of each channel, `detrended`, shape (n, k), the data less offset and
    trend. In windows of two cycles of the motion, the curvature of a swing many times as large looks like a change of
    the motion.
    """
    lines = [c.frequency_hz for c in candidates(data, detrended, variance, 0.0, ())]
    slow = [f for f in lines if f < TUNING.slow * frequency_hz and f * data.span_s < FEW_CYCLES]
    if not slow:
        return data
    bandwidth = min(TUNING.followed * max(slow), TUNING.slow * frequency_hz)
    problem = Problem(data, baseline_splines(data.time_s, bandwidth))
    moving = solve_linear(problem, no_columns(data.time_s)).residual
    return replace(data, values=np.where(data.weights > 0.0, moving, 0.0))


# Shares of the record in which the dominant motion is looked for, each at every half of its length.
_WINDOWS = (1.0, 0.25, 0.0625)


@dataclass(frozen=True)
class Tones:
    """Frequencies of the strongest lines, the dominant one first, and of that nearest to the wanted frequency.

    ``soon_over`` is True where there is no line, but a motion of few cycles.
    """

    strongest_hz: tuple[float, ...]
    wanted_hz: float
    soon_over: bool = False

    @property
    def dominant_hz(self) -> float:
        """That of the strongest line."""
        return self.strongest_hz[0]


def find_tones(
    data: FitData, variance: FloatArray, lowest_hz: float, wanted_hz: float | None
) -> Tones | None:
    """The strongest lines of any window; None without any.

    Beside the dominant one, those that blocks of two of its cycles resolve.
    """
    found = sorted(_lines(data, variance, lowest_hz), key=lambda c: -c.score)
    if not found:
        short = tuple(_short_motion(data, variance, lowest_hz))
        return Tones(short, short[0], soon_over=True) if short else None
    # A swing of few cycles is a motion of the support, if there is anything faster.
    many = [c.frequency_hz for c in found if c.frequency_hz * data.span_s > FEW_CYCLES]
    hz = (
        many
        or _short_motion(data, variance, found[0].frequency_hz / TUNING.slow)
        or [c.frequency_hz for c in found]
    )
    wanted = tones = hz[:1]
    if wanted_hz is not None:
        nearest = min((c.frequency_hz for c in found), key=lambda f: abs(np.log(f / wanted_hz)))
        wanted = [f for f in hz if abs(np.log(f / nearest)) < TUNING.same_line] or [nearest]
    for one in hz:
        if all(abs(one - tone) > TUNING.resolved * hz[0] for tone in tones):
            tones = [*tones, one]
    return Tones(tuple(tones[: TUNING.most_tones]), wanted[0])


def _short_motion(data: FitData, variance: FloatArray, lowest_hz: float) -> list[float]:
    """Frequency of the wave that follows the largest deflection from slow motion: one that decays soon is no line.

    Where none follows, as at a click, the next largest ones are tried, up to the larger ones.
    """
    splines = baseline_splines(data.time_s, FEW_CYCLES / data.span_s)
    moving = replace(data, values=solve_linear(Problem(data, splines), no_columns(data.time_s)).residual)
    size = np.sum(data.weights * moving.values**2 / variance, axis=1)
    end = np.full(size.size, size.size)
    for _ in range(TUNING.most_peaks):
        peak = int(np.argmax(size))
        after = moving.rows(slice(peak, int(end[peak])))
        if size[peak] > 0.0 and after.time_s.size >= TUNING.least_window:
            after = after.from_time(float(after.time_s[0]))
            found = fit_damped(after, after.values, lowest_hz)
            if found is not None:
                return [float(frequency_hz(found.fit.poles[0]))]
        near = slice(max(peak - TUNING.least_window, 0), peak + TUNING.least_window)
        size[near] = 0.0
        end[: near.start] = np.minimum(end[: near.start], near.start)
    return []


def _lines(data: FitData, variance: FloatArray, lowest_hz: float) -> list[Candidate]:
    """Lines of the record, and of its quarters and sixteenths."""
    found: list[Candidate] = []
    for share in _WINDOWS:
        length = int(share * data.time_s.size)
        if length < min(TUNING.least_window, data.time_s.size):
            continue
        for first in range(0, data.time_s.size - length + 1, max(length // 2, 1)):
            part = data.rows(slice(first, first + length))
            # In part of the record, the curvature of a swing may appear as a line of a few cycles.
            least_hz = lowest_hz if share == 1.0 else max(lowest_hz, TUNING.least_window_cycles / part.span_s)
            found += candidates(part, detrended(part), variance, least_hz, ())
    return found


@dataclass(frozen=True)
class LineBlocks:
    """Lines in b blocks.

    Attributes
    ----------
    edges_s : array, shape (b + 1,)
    amplitude : complex array, shape (b, tones, k)
        Over the standard deviation of its noise; NaN where samples are missing.
    excess : array, shape (b,)
        Mean square residual beside the lines, over that of the median block.
    """

    edges_s: FloatArray
    amplitude: ComplexArray
    excess: FloatArray

    @property
    def centres_s(self) -> FloatArray:
        """Shape (b,)."""
        return np.asarray(0.5 * (self.edges_s[1:] + self.edges_s[:-1]))

    @property
    def level(self) -> FloatArray:
        """Rms of the amplitudes over the channels, of the strongest tone, shape (b,); about 1 for noise."""
        if not self.amplitude.size:
            return np.zeros(0)
        return np.asarray(np.sqrt(np.max(np.mean(np.abs(self.amplitude) ** 2, axis=2), axis=1)))


def shortest_block_s(data: FitData, tones_hz: tuple[float, ...], least_hz: float = 0.0) -> float:
    """Length of a block of the fewest cycles of the tones from `least_hz` on, or of the fewest samples."""
    rows = max(TUNING.least_rows, 2 * len(tones_hz) + 6)
    return max(TUNING.cycles / min(hz for hz in tones_hz if hz >= least_hz), rows * data.step_s)


def block_count(data: FitData, tones_hz: tuple[float, ...], least_hz: float = 0.0) -> int:
    """Number of blocks of a record."""
    last_s = float(data.time_s[-1]) + data.step_s
    return min(TUNING.most_blocks, int(last_s / shortest_block_s(data, tones_hz, least_hz)))


def line_blocks(data: FitData, tones_hz: tuple[float, ...], least_hz: float = 0.0) -> LineBlocks:
    """Amplitudes by least squares with a Hann window, beside an offset and its slope.

    The noise is the residual of the median block, with the spectral level beside each line. Lines below `least_hz` are
    fitted and left out: in blocks of a part of their cycle they are a slow motion, and their amplitude is unknown.
    """
    last_s, blocks = float(data.time_s[-1]) + data.step_s, block_count(data, tones_hz, least_hz)
    edges, tones, channels = np.linspace(0.0, last_s, blocks + 1), len(tones_hz), data.values.shape[1]
    amplitude = np.full((blocks, tones, channels), np.nan, dtype=complex)
    gain, square = np.full(amplitude.shape, np.nan), np.full((blocks, channels), np.nan)
    rows, usual = np.searchsorted(data.time_s, edges), last_s / max(blocks, 1) / data.step_s
    for b in range(blocks):
        some = slice(rows[b], rows[b + 1])
        place = (data.time_s[some] - edges[b]) / (edges[b + 1] - edges[b]) - 0.5
        turn = 2.0 * np.pi * data.time_s[some, None] * np.array(tones_hz)
        columns = np.concatenate([np.cos(turn), -np.sin(turn), np.ones((place.size, 1)), place[:, None]], 1)
        filters = np.zeros((0, 0))
        for k in range(channels):
            weights = data.weights[some, k]
            if np.count_nonzero(weights) < max(columns.shape[1] + 2, TUNING.complete * usual):
                filters = np.zeros((0, 0))
                continue
            window = weights * np.cos(np.pi * place) ** 2
            if not filters.size or not np.array_equal(weights, data.weights[some, k - 1]):
                filters = _filters(columns, window)
            beta = filters @ data.values[some, k]
            left = data.values[some, k] - columns @ beta
            of_unit = 1.0 / np.maximum(weights, 1e-300)
            freedom = max(1.0 - columns.shape[1] / np.count_nonzero(weights), 0.1)
            amplitude[b, :, k] = beta[:tones] + 1j * beta[tones : 2 * tones]
            power = np.sum(filters**2 * of_unit, axis=1)
            gain[b, :, k] = np.sqrt(power[:tones] + power[tones : 2 * tones])
            square[b, k] = np.sum(window * left**2) / np.sum(window * of_unit) / freedom
    least = TUNING.least_noise * np.max(np.abs(data.values), axis=0)
    variance = np.maximum(_medians(square), least**2 + 1e-300)
    known = np.isfinite(square)
    excess = np.sum(np.where(known, square / variance, 0.0), axis=1) / np.maximum(np.sum(known, axis=1), 1)
    spectrum = residual_spectrum(data, detrended(data), variance)
    level = np.sqrt([max(spectrum.level_aside(hz), 1.0) for hz in tones_hz])
    with np.errstate(invalid="ignore"):
        scaled = amplitude / (gain * np.sqrt(variance) * level[:, None])
    return LineBlocks(edges, scaled[:, np.array(tones_hz) >= least_hz], excess)


def _filters(columns: FloatArray, window: FloatArray) -> FloatArray:
    """What gives the coefficients of the columns from the values; stable where lines are nearly equal."""
    gram = columns.T @ (window[:, None] * columns)
    size = np.sqrt(np.diag(gram)) + 1e-300
    scaled = gram / np.outer(size, size) + 1e-9 * np.eye(size.size)
    return np.asarray(np.linalg.solve(scaled, (window[:, None] * columns / size).T) / size[:, None])


def _medians(values: FloatArray) -> FloatArray:
    """Median of each column's finite values; 1 without any."""
    return np.array([np.median(v[np.isfinite(v)]) if np.any(np.isfinite(v)) else 1.0 for v in values.T])

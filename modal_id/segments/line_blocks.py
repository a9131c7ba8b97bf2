"""Amplitudes of the strongest lines of a record in blocks of a few cycles, relative to their noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modal_id.data import FitData, detrended
from modal_id.fit import residual_spectrum
from tracker import ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Blocks of a record."""

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


def shortest_block_s(data: FitData, tones_hz: tuple[float, ...]) -> float:
    """Length of a block of the fewest cycles or samples."""
    rows = max(TUNING.least_rows, 2 * len(tones_hz) + 6)
    return max(TUNING.cycles / min(tones_hz), rows * data.step_s)


def line_blocks(data: FitData, tones_hz: tuple[float, ...]) -> LineBlocks:
    """Amplitudes by least squares with a Hann window, beside an offset and its slope.

    The noise is the residual of the median block, with the spectral level beside each line.
    """
    last_s = float(data.time_s[-1]) + data.step_s
    blocks = min(TUNING.most_blocks, int(last_s / shortest_block_s(data, tones_hz)))
    edges, tones, channels = np.linspace(0.0, last_s, blocks + 1), len(tones_hz), data.values.shape[1]
    amplitude = np.full((blocks, tones, channels), np.nan, dtype=complex)
    gain, square = np.full(amplitude.shape, np.nan), np.full((blocks, channels), np.nan)
    rows, usual = np.searchsorted(data.time_s, edges), last_s / max(blocks, 1) / data.step_s
    for b in range(blocks):
        some = slice(rows[b], rows[b + 1])
        place = (data.time_s[some] - edges[b]) / (edges[b + 1] - edges[b]) - 0.5
        turn = 2.0 * np.pi * data.time_s[some, None] * np.array(tones_hz)
        columns = np.concatenate([np.cos(turn), -np.sin(turn), np.ones((place.size, 1)), place[:, None]], 1)
        for k in range(channels):
            weights = data.weights[some, k]
            if np.count_nonzero(weights) < max(columns.shape[1] + 2, TUNING.complete * usual):
                continue
            window = weights * np.cos(np.pi * place) ** 2
            beta, filters = _regression(columns, window, data.values[some, k])
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
        return LineBlocks(edges, amplitude / (gain * np.sqrt(variance) * level[:, None]), excess)


def _regression(columns: FloatArray, window: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Coefficients of the columns, and the filters that give them; stable where lines are nearly equal."""
    gram = columns.T @ (window[:, None] * columns)
    size = np.sqrt(np.diag(gram)) + 1e-300
    scaled = gram / np.outer(size, size) + 1e-9 * np.eye(size.size)
    filters = np.linalg.solve(scaled, (window[:, None] * columns / size).T) / size[:, None]
    return filters @ values, filters


def _medians(values: FloatArray) -> FloatArray:
    """Median of each column's finite values; 1 without any."""
    return np.array([np.median(v[np.isfinite(v)]) if np.any(np.isfinite(v)) else 1.0 for v in values.T])

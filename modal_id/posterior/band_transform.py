"""Fourier transform of the samples and of the columns of a fit in a narrow band, with little memory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from modal_id.solve import LongArray, SparseColumns
from tracker import ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Accuracy of the transform."""

    #: [1] blocks per period of the largest distance from the centre
    #: physics: The phase changes by up to 0.2 rad within half a block.
    blocks_per_period: float = 16.0
    #: [1] number of moments of each block
    #: physics: 0.2^6 / 6! = 1e-7.
    moments: int = 6
    #: [1] relative difference up to which frequency steps count as equal
    #: physics: Above rounding.
    even: float = 1e-10


TUNING = Tuning()

_SPLINES = 16
# Values of the rotations of the blocks that are held at a time.
_ROTATIONS = 4_000_000
# Samples at a time.
_SAMPLES = 65_536


class BandTransform:
    """``sum_t x(t) exp(-2 pi i f t)`` of columns x, shape (n, c), for the frequencies f of a narrow band.

    Samples are shifted by the band's centre and summed in blocks; the band is transformed from the blocks. The blocks'
    response, at least 0.994 in amplitude, is divided out. Up to a few percent leak in from far outside the band:
    accurate enough for columns of the fit, but not for a residual with strong noise elsewhere, for which `exact` sums
    six moments of each block (relative remainder 0.2^6 / 6! = 1e-7).
    """

    def __init__(self, time_s: FloatArray, frequencies_hz: FloatArray) -> None:
        middle = 0.5 * (float(frequencies_hz[0]) + float(frequencies_hz[-1]))
        half = max(float(np.max(np.abs(frequencies_hz - middle))), 1e-9)
        block = 1.0 / (TUNING.blocks_per_period * half)
        number = ((time_s - time_s[0]) / block).astype(np.intp)
        starts = np.flatnonzero(np.diff(number, prepend=-1))
        ends = np.append(starts[1:], time_s.size)
        mean = np.add.reduceat(time_s, starts) / (ends - starts)
        spread = np.add.reduceat((time_s - np.repeat(mean, ends - starts)) ** 2, starts) / (ends - starts)
        self._offset_rad_s = 2.0 * np.pi * (frequencies_hz - middle)
        self._mean_s, self._spread = mean, spread
        self._time_s, self._middle_hz = time_s, middle
        self._edges = np.append(starts, time_s.size).astype(np.int32)

    def __call__(self, *columns: LongArray | SparseColumns, weights: FloatArray) -> list[ComplexArray]:
        """Transform of each array of columns, their rows times weights; shape (frequencies, c) each."""
        total = [np.zeros((self.size, one.shape[1]), dtype=complex) for one in columns]
        for blocks in self._parts():
            rows, edges = self._samples(blocks)
            rotation, wave = self._rotation(blocks), self._wave(rows)
            # Two matrices, so that real columns are not copied as complex ones.
            place = np.arange(wave.size, dtype=np.int32), edges
            cos, sin = (csr_array((part * weights[rows], *place)) for part in (wave.real, wave.imag))
            for k, one in enumerate(columns):
                total[k] += _rotated(rotation, cos @ one[rows], sin @ one[rows])
        return total

    def _parts(self) -> Iterator[slice]:
        """The blocks, some at a time: their rotations and the waves of their samples take memory."""
        count = self._mean_s.size
        at_once = max(1, min(_ROTATIONS // self.size, _SAMPLES * count // self._time_s.size))
        yield from (slice(first, min(first + at_once, count)) for first in range(0, count, at_once))

    def _samples(self, blocks: slice) -> tuple[slice, NDArray[np.int32]]:
        """Rows of the samples of some blocks, and the edges of the blocks among them."""
        edges = self._edges[blocks.start : blocks.stop + 1]
        return slice(int(edges[0]), int(edges[-1])), edges - edges[0]

    def _wave(self, rows: slice) -> ComplexArray:
        return np.asarray(np.exp(-2j * np.pi * self._middle_hz * self._time_s[rows]))

    def _rotation(self, blocks: slice) -> NDArray[np.complex64]:
        # Single precision, and row by row, because this is the largest array for a long record.
        rotation = np.empty((self.size, self._mean_s[blocks].size), dtype=np.complex64)
        turns = self._turns(self._mean_s[blocks])
        for row, (offset, turn) in enumerate(zip(self._offset_rad_s, turns, strict=True)):
            rotation[row] = turn / (1.0 - 0.5 * offset**2 * self._spread[blocks])
        return rotation

    @property
    def size(self) -> int:
        """Number of frequencies."""
        return int(self._offset_rad_s.size)

    def exact(
        self, values: FloatArray, weights: FloatArray, share: ComplexArray | FloatArray
    ) -> ComplexArray:
        """Transform of one sum, with factors `share`, of the weighted columns of an array, without leakage."""
        moments = np.empty((TUNING.moments, self._mean_s.size), dtype=complex)
        for blocks in self._parts():
            rows, edges = self._samples(blocks)
            moving = self._wave(rows) * ((weights[rows] * values[rows]) @ share)
            from_mean = self._time_s[rows] - np.repeat(self._mean_s[blocks], np.diff(edges))
            for power in range(TUNING.moments):
                moments[power, blocks] = np.add.reduceat(moving, edges[:-1])
                moving *= from_mean / (power + 1.0)
        factors = (-1j * self._offset_rad_s[:, None]) ** np.arange(TUNING.moments)
        turns = self._turns(self._mean_s)
        return np.array([f @ (moments @ turn) for f, turn in zip(factors, turns, strict=True)])

    def _turns(self, time_s: FloatArray) -> Iterator[ComplexArray]:
        """``exp(-i w t)`` at some times for each frequency, by steps where these are even."""
        turn: ComplexArray = np.ones(time_s.size, dtype=complex)
        step, gap, last = turn, 0.0, 0.0
        for offset in self._offset_rad_s:
            if abs(offset - last - gap) > TUNING.even * abs(gap):
                gap = float(offset) - last
                step = np.exp(-1j * gap * time_s)
            turn, last = turn * step, float(offset)
            yield turn


def _rotated(
    rotation: NDArray[np.complex64], cos: FloatArray | csr_array, sin: FloatArray | csr_array
) -> ComplexArray:
    """Sum of the blocks, their cosine and sine parts with shape (blocks, c), each times its rotation."""
    if isinstance(cos, np.ndarray) or isinstance(sin, np.ndarray):
        return np.asarray(rotation @ (cos + 1j * sin).astype(np.complex64), dtype=complex)
    # A few splines at a time: dense, all of them take more memory than the record.
    cos, sin = cos.tocsc(), sin.tocsc()
    parts = (slice(first, first + _SPLINES) for first in range(0, cos.shape[1], _SPLINES))
    return np.hstack([_rotated(rotation, cos[:, part].toarray(), sin[:, part].toarray()) for part in parts])

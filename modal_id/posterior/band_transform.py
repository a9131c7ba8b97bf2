"""Fourier sums at uneven times for the frequencies of a narrow band."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from tracker.arrays import ComplexArray, FloatArray

# Blocks per period of the largest distance from the centre: the phase changes by up to 0.2 rad within half a block.
_BLOCKS_PER_PERIOD = 16.0


@dataclass(frozen=True)
class BandTransform:
    """``sum_t x(t) exp(-2 pi i f t)`` for the frequencies f of a band.

    Samples are shifted by the band's centre and summed in blocks; the band is transformed from the blocks. The blocks'
    response, at least 0.994 in amplitude, is divided out. Up to a few percent leak in from far outside the band:
    accurate enough for columns of the fit, but not for a residual with strong noise elsewhere (`fourier_sums`).

    Attributes
    ----------
    frequencies_hz : array, shape (bins,)
    """

    frequencies_hz: FloatArray
    _centre: ComplexArray
    _starts: NDArray[np.intp]
    _rotation: ComplexArray

    @classmethod
    def of(cls, time_s: FloatArray, frequencies_hz: FloatArray) -> BandTransform:
        """Prepare the transform for these sampling times (increasing)."""
        middle = 0.5 * (float(frequencies_hz[0]) + float(frequencies_hz[-1]))
        half = max(float(np.max(np.abs(frequencies_hz - middle))), 1e-9)
        block = 1.0 / (_BLOCKS_PER_PERIOD * half)
        number = ((time_s - time_s[0]) / block).astype(np.intp)
        starts = np.flatnonzero(np.diff(number, prepend=-1))
        ends = np.append(starts[1:], time_s.size)
        mean = np.add.reduceat(time_s, starts) / (ends - starts)
        spread = np.add.reduceat((time_s - np.repeat(mean, ends - starts)) ** 2, starts) / (ends - starts)
        away = 2.0 * np.pi * (frequencies_hz - middle)
        response = 1.0 - 0.5 * away[:, None] ** 2 * spread[None, :]
        rotation = np.exp(-1j * away[:, None] * mean[None, :]) / response
        return cls(frequencies_hz, np.exp(-2j * np.pi * middle * time_s), starts, rotation)

    def __call__(self, columns: FloatArray | ComplexArray) -> ComplexArray:
        """Transform each column, shape (n, c): shape (bins, c)."""
        return np.asarray(self._rotation @ _block_sums(columns, self._centre, self._starts))


@numba.njit(cache=True, error_model="numpy")
def _block_sums(
    columns: FloatArray | ComplexArray, wave: ComplexArray, starts: NDArray[np.intp]
) -> ComplexArray:
    count = starts.size
    sums = np.zeros((count, columns.shape[1]), dtype=np.complex128)
    for block in range(count):
        end = starts[block + 1] if block + 1 < count else wave.size
        for row in range(starts[block], end):
            for column in range(columns.shape[1]):
                value = columns[row, column]
                if value != 0.0:
                    sums[block, column] += value * wave[row]
    return sums


@numba.njit(cache=True, error_model="numpy")
def fourier_sums(
    values: ComplexArray, time_s: FloatArray, first_hz: float, step_hz: float, count: int
) -> ComplexArray:
    """``sum_t x(t) exp(-2 pi i f t)`` at `count` equally spaced frequencies from `first_hz` on, exactly."""
    result = np.zeros(count, dtype=np.complex128)
    for row in range(values.size):
        rotated = values[row] * np.exp(-2j * np.pi * first_hz * time_s[row])
        rotation = np.exp(-2j * np.pi * step_hz * time_s[row])
        for index in range(count):
            result[index] += rotated
            rotated *= rotation
    return result

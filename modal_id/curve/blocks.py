"""Complex amplitude of one mode in short blocks of the record: what a law of decay is fitted to."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from modal_id.fit.linear import Problem
from tracker.arrays import ComplexArray, FloatArray

# Cycles in the shortest block, and the largest number of blocks.
_CYCLES = 2.0
_MAX_BLOCKS = 300
_LEAST_SAMPLES = 8
_MAX_CONDITION = 1e8


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
    """Least squares of each block on the reference decay, an offset and a slope.

    `problem` holds the motion of this mode only, with noise and baseline; `reference` is its decay with amplitude 1 at
    the start, shape (n,); `shape` and `noise_variance`, shape (k,), are the channels' amplitudes and noise. Slow motion
    and harmonics of the mode average out within a block of whole cycles.
    """
    data = problem.data
    cycles = max(_CYCLES, np.ceil(data.span_s * frequency_hz / _MAX_BLOCKS))
    number = ((data.time_s - data.time_s[0]) * frequency_hz / cycles).astype(np.intp)
    edges = np.append(np.flatnonzero(np.diff(number, prepend=-1)), number.size)
    times, ratios, variances = [], [], []
    size = np.abs(shape) ** 2 / noise_variance
    for first, last in pairwise(edges):
        rows = slice(int(first), int(last))
        time = data.time_s[rows]
        if time.size < _LEAST_SAMPLES or time[-1] - time[0] < 0.8 * cycles / frequency_hz:
            continue
        middle, half = 0.5 * (time[0] + time[-1]), 0.5 * (time[-1] - time[0])
        scale = max(float(np.max(np.abs(reference[rows]))), 1e-300)
        wave = reference[rows] / scale
        columns = np.stack([wave.real, wave.imag, np.ones(time.size), (time - middle) / half], axis=1)
        total, weight = 0.0 + 0.0j, 0.0
        for channels, weights in data.groups:
            own = columns * weights[rows, None]
            normal = own.T @ columns
            if np.count_nonzero(weights[rows]) < _LEAST_SAMPLES or np.linalg.cond(normal) > _MAX_CONDITION:
                continue
            inverse = np.linalg.inv(normal)
            found = inverse @ (own.T @ data.values[rows][:, channels])
            precision = 2.0 / (inverse[0, 0] + inverse[1, 1])
            # Re(c q wave) = q' . (Re wave, Im wave) with c q = q'_0 - i q'_1.
            share = precision * np.conj(shape[channels]) / noise_variance[channels]
            total += np.sum(share * (found[0] - 1j * found[1]))
            weight += precision * float(np.sum(size[channels]))
        if weight > 0.0:
            times.append(float(np.mean(time)))
            ratios.append(total / weight / scale)
            variances.append(1.0 / (weight * scale**2))
    return Blocks(np.array(times), np.array(ratios, dtype=complex), np.array(variances))

"""Complex amplitude of one mode in short blocks of the record, to which laws of decay are fitted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modal_id.data import FitData
from modal_id.solve import Problem
from tracker import BoolArray, ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Blocks of the amplitude curve."""

    #: [cycles] shortest block
    cycles: float = 2.0
    #: [1] largest number of blocks
    max_blocks: int = 300
    #: [samples] fewest samples of a block
    least_samples: int = 8
    #: [1] condition number above which a block is left out
    #: physics: Rounding of 1e-16 leaves eight digits.
    max_condition: float = 1e8
    #: [1] reference over its largest value below which a block contains nothing of the mode
    #: physics: Above rounding.
    faded: float = 1e-12


TUNING = Tuning()

# Samples whose columns are held at a time.
_SAMPLES = 65_536


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
    cycles = max(TUNING.cycles, np.ceil(data.span_s * frequency_hz / TUNING.max_blocks))
    number = ((time_s - time_s[0]) * frequency_hz / cycles).astype(np.intp)
    edges = np.append(np.flatnonzero(np.diff(number, prepend=-1)), number.size)
    at_once = max(1, _SAMPLES * (edges.size - 1) // number.size)
    parts = []
    for first in range(0, edges.size - 1, at_once):
        own = edges[first : first + at_once + 1]
        rows = slice(own[0], own[-1])
        whole_s = 0.8 * cycles / frequency_hz
        parts.append(_fit(data.rows(rows), own - own[0], reference[rows], shape, noise_variance, whole_s))
    total, weight, scale, mean_s = (np.concatenate(part) for part in zip(*parts, strict=True))
    used = (weight > 0.0) & (scale > TUNING.faded * np.max(scale))
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
    whole = (count >= TUNING.least_samples) & (last - first >= whole_s)
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
    enough = np.add.reduceat((weights > 0.0).astype(np.intp), starts) >= TUNING.least_samples
    normal[~enough] = np.eye(p)
    known = enough & (np.linalg.cond(normal) <= TUNING.max_condition)
    normal[~known] = np.eye(p)
    return np.asarray(np.linalg.inv(normal), dtype=float), np.asarray(known, dtype=bool)

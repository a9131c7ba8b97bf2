"""Amplitude of the dominant motion in short windows: the envelope of a record."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modal_id.data import FitData
from tracker import BoolArray, ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Windows of the envelope."""

    #: [cycles] length of a window
    #: convention: Two separate the motion from an offset.
    cycles: float = 2.0
    #: [samples] fewest samples of a window
    min_samples: int = 10
    #: [1] span of a window over the usual one, above which the window contains a gap
    longest: float = 1.5
    #: [1] share of the windows of the most complete channel below which a channel is left out
    complete: float = 0.5


TUNING = Tuning()

# Windows overlap by three quarters.
HOPS = 4
# Windows at a time: the columns of all would take two hundred bytes for each sample.
_BLOCK = 4096


@dataclass(frozen=True)
class Envelope:
    """Amplitude in windows of two cycles, k channels, by least squares beside its slope, an offset and the offset's.

    Attributes
    ----------
    time_s : array, shape (m,)
        Centres of the windows.
    state : complex array, shape (m, k)
        Amplitude ``c`` of ``Re(c exp(i omega t))``; NaN where a window has too few samples; 0 in a channel that is left
        out, because most of its windows have too few.
    noise : array, shape (k,)
        Standard deviation of a sample: the median residual. Motion that two cycles do not resolve is part of it.
        Infinite in a channel that is left out.
    """

    time_s: FloatArray
    state: ComplexArray
    noise: FloatArray

    @property
    def amplitude(self) -> FloatArray:
        """Amplitude relative to the noise of a sample: root sum of squares over the channels; shape (m,)."""
        return np.asarray(np.sqrt(np.sum(np.abs(self.state / self.noise) ** 2, axis=1)))

    @property
    def used(self) -> BoolArray:
        """Mask of the channels that are not left out; shape (k,)."""
        return np.isfinite(self.noise)


@dataclass(frozen=True)
class Windows:
    """Windows of two cycles of a record, each a quarter of their length later.

    ``first``, shape (m,), are the rows of their first samples, ``samples`` the number of samples in each; ``whole``
    marks windows without a gap, shape (m,).
    """

    time_s: FloatArray
    frequency_hz: float
    first: NDArray[np.intp]
    samples: int
    centre_s: FloatArray
    half_s: float
    whole: BoolArray

    def blocks(self, which: BoolArray | None = None) -> Iterator[NDArray[np.intp]]:
        """Indices of all windows, or of those in the mask, some at a time."""
        chosen = np.arange(self.first.size) if which is None else np.flatnonzero(which)
        yield from (chosen[begin : begin + _BLOCK] for begin in range(0, chosen.size, _BLOCK))

    def rows(self, some: NDArray[np.intp]) -> NDArray[np.intp]:
        """Rows of the samples of some windows; shape (w, l)."""
        return self.first[some, None] + np.arange(self.samples)

    def columns(self, some: NDArray[np.intp]) -> FloatArray:
        """Offset, cosine and sine, and these times the time from the centre, -1 to 1; shape (w, l, 6)."""
        times = self.time_s[self.rows(some)]
        since = (times - self.centre_s[some, None]) / self.half_s
        phase = 2.0 * np.pi * self.frequency_hz * times
        wave = np.stack([np.ones_like(phase), np.cos(phase), -np.sin(phase)], axis=2)
        return np.concatenate([wave, since[:, :, None] * wave], axis=2)


def windows(data: FitData, frequency_hz: float) -> Windows | None:
    """Windows at a frequency; None where the record is too short for three."""
    step = data.step_s
    length = max(round(TUNING.cycles / (frequency_hz * step)), TUNING.min_samples)
    length += -length % HOPS
    if data.time_s.size < 3 * length:
        return None
    first = np.arange(0, data.time_s.size - length + 1, length // HOPS)
    begin, end = data.time_s[first], data.time_s[first + length - 1]
    whole = end - begin < TUNING.longest * length * step
    return Windows(data.time_s, frequency_hz, first, length, 0.5 * (begin + end), 0.5 * length * step, whole)


def short_time(data: FitData, frequency_hz: float) -> Envelope | None:
    """Envelope at a frequency; None where the record is too short for three windows."""
    found = windows(data, frequency_hz)
    if found is None:
        return None
    channels = data.values.shape[1]
    beta, residual = np.empty((found.first.size, 6, channels)), np.empty((found.first.size, channels))
    for some in found.blocks():
        columns, rows = found.columns(some), found.rows(some)
        for k in range(channels):
            beta[some, :, k], residual[some, k] = _solved(columns, data, rows, found.whole[some], k)
    counts = np.count_nonzero(np.isfinite(residual), axis=0)
    used = counts >= TUNING.complete * np.max(counts)
    beta[:, :, ~used], residual[:, ~used] = 0.0, 0.0
    noise = np.sqrt(np.nanmedian(residual, axis=0)) if np.any(counts) else np.ones(channels)
    floor = 1e-6 * np.sqrt(np.mean(data.values**2, axis=0)) + 1e-300
    state = np.asarray(beta[:, 1] + 1j * beta[:, 2], dtype=complex)
    return Envelope(found.centre_s, state, np.where(used, np.maximum(noise, floor), np.inf))


def _solved(
    columns: FloatArray, data: FitData, rows: NDArray[np.intp], whole: BoolArray, channel: int
) -> tuple[FloatArray, FloatArray]:
    """Coefficients (m, 6) and mean square residual (m,) of a channel; NaN where a window has too few samples."""
    y, w = data.values[rows, channel], data.weights[rows, channel]
    weighted = columns * w[:, :, None]
    gram = np.swapaxes(weighted, 1, 2) @ columns
    moment = np.einsum("mlc,ml->mc", weighted, y)
    ridge = 1e-9 * np.trace(gram, axis1=1, axis2=2)[:, None, None] + 1e-300
    beta = np.linalg.solve(gram + ridge * np.eye(6), moment[..., None])[..., 0]
    rss = np.sum(w * (y - np.einsum("mlc,mc->ml", columns, beta)) ** 2, axis=1)
    count = np.count_nonzero(w > 0.0, axis=1)
    good = whole & (count >= max(8, 0.6 * y.shape[1]))
    return np.where(good[:, None], beta, np.nan), np.where(good, rss / np.maximum(count - 6, 1), np.nan)

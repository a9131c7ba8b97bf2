"""Quick check of an envelope: whether two successive decays may explain it better than one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modal_id.segments.envelope import HOPS, Envelope
from tracker import BoolArray, ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """One decay or two."""

    #: [1] largest number of iterations of the fit
    iterations: int = 30
    #: [1] relative change below which the fit has converged
    converged: float = 1e-6
    #: [windows] fewest windows on either side of a change
    side: int = 3
    #: [windows] fewest windows in all
    least: int = 12
    #: [1] share of the required gain from which two decays may be the better explanation
    #: convention: Windows of two cycles blur the change.
    possible: float = 0.8


TUNING = Tuning()


def may_be_two_decays(envelope: Envelope, inside: BoolArray) -> bool:
    """Whether two decays, one after the other, may explain the windows of the mask better than one, shape (m,).

    To first order in the changes of the pole, with separate changes for each channel: an upper bound of the gain as
    long as the changes are small. True where there are too few windows to decide.
    """
    rows = np.flatnonzero(inside)[::HOPS]
    rows = rows[np.all(np.isfinite(envelope.state[rows]), axis=1)]
    if rows.size < TUNING.least:
        return True
    time_s = envelope.time_s[rows] - envelope.time_s[rows[0]]
    state = envelope.state[rows][:, envelope.used] / envelope.noise[envelope.used]
    span_s = float(time_s[-1])
    wave = _fitted(time_s / span_s, state)
    if wave is None:
        return True
    columns = np.stack([wave, wave * time_s / span_s], axis=1)
    joined = np.concatenate([columns, state], axis=1)
    products = np.conj(joined)[:, :, None] * joined[:, None, :]
    before = np.cumsum(products, axis=0)[TUNING.side - 1 : -TUNING.side]
    after = np.cumsum(products[::-1], axis=0)[::-1][TUNING.side : 1 - TUNING.side or None]
    two = float(np.min(_rss(before) + _rss(after)))
    one = float(_rss(np.delete(np.delete(np.sum(products, axis=0), 1, axis=0), 1, axis=1)[None], 1)[0])
    channels = state.shape[1]
    # Real values, what a change adds (a pole and its time, an amplitude of each channel), and what noise gains by two
    # amplitudes and slopes of each channel in place of one amplitude and a pole.
    values, more, noise = 2.0 * state.size, 3.0 + 2.0 * channels, 6.0 * channels - 2.0
    return bool(values * np.log(one / max(two, 1e-300)) > noise + TUNING.possible * more * np.log(values))


def _fitted(time: FloatArray, state: ComplexArray) -> ComplexArray | None:
    """``exp(lambda t)`` of the best pole, for times from 0 to 1; None where Gauss-Newton does not converge."""
    turned = np.sum(np.conj(state[:-1]) * state[1:])
    pole = complex(np.log(turned / np.sum(np.abs(state[:-1]) ** 2))) * (time.size - 1)
    for _ in range(TUNING.iterations):
        if not np.isfinite(pole) or abs(pole.real) > 300.0:
            return None
        wave = np.exp(pole * time)
        amplitude = np.conj(wave) @ state / np.sum(np.abs(wave) ** 2)
        residual = state - wave[:, None] * amplitude
        slope = time * wave
        slope = slope - wave * (np.conj(wave) @ slope) / np.sum(np.abs(wave) ** 2)
        step = np.conj(slope) @ (residual @ np.conj(amplitude))
        step = complex(step / (np.sum(np.abs(slope) ** 2) * np.sum(np.abs(amplitude) ** 2)))
        if abs(step) < TUNING.converged * max(abs(pole), 1.0):
            return np.asarray(wave)
        pole += step * min(1.0, 1.0 / abs(step))
    return None


def _rss(products: ComplexArray, columns: int = 2) -> FloatArray:
    """Residual sum of squares over all channels from products of (columns, values), shape (count, p + k, p + k)."""
    gram, cross = products[:, :columns, :columns], products[:, :columns, columns:]
    square = np.real(np.trace(products[:, columns:, columns:], axis1=1, axis2=2))
    ridge = 1e-12 * np.real(np.trace(gram, axis1=1, axis2=2)) / columns + 1e-300
    solved = np.linalg.solve(gram + ridge[:, None, None] * np.eye(columns), cross)
    return np.asarray(np.maximum(square - np.real(np.sum(np.conj(cross) * solved, axis=(1, 2))), 0.0))

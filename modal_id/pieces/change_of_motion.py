"""Time at which a motion changes, among free decays whose poles are roughly known."""

from __future__ import annotations

import numpy as np

from modal_id.data import FitData
from modal_id.fit import ModalFit
from modal_id.segments.stop import running_rss
from modal_id.solve import frequency_hz, real_columns
from tracker import FloatArray

_SAMPLES_PER_CYCLE = 8.0
_MOST_SAMPLES = 3000
_MOST_CHANNELS = 4
_MOST_MODES = 6
# The strongest modes may decay otherwise than the fit says: their waves times a ramp are fitted, too.
_LOOSE = 2
_GROWTH = 8.0


def change_of_motion(model: ModalFit) -> float | None:
    """Time, relative to the fit's data, that splits them into the two pieces best fitted with the same poles.

    Amplitudes, phases and offset of both pieces are free. None where the data are too few.
    """
    data, waves = _columns(model)
    n, p = waves.shape
    if n < 4 * p:
        return None
    total = np.zeros(n - 2 * p)
    for channel in range(data.values.shape[1]):
        y, w = data.values[:, channel], data.weights[:, channel]
        before = running_rss(waves, y, w, p - 1, total.size)
        after = running_rss(waves[::-1], y[::-1], w[::-1], p, total.size)[::-1]
        total += (before + after) / model.fit.linear.noise_variance[channel]
    # The index is that of the last sample of the first piece.
    last = p - 1 + int(np.argmin(total))
    return 0.5 * float(data.time_s[last] + data.time_s[last + 1])


def _columns(model: ModalFit) -> tuple[FitData, FloatArray]:
    """Samples of the strongest channels, about eight per cycle of the fastest mode; offset, waves and ramped waves."""
    poles, amplitudes = model.fit.poles, model.fit.linear.amplitudes
    power = np.abs(amplitudes) ** 2 / model.fit.linear.noise_variance
    energy = np.sum(power, axis=1) / np.maximum(-poles.real, 1.0 / model.data.span_s)
    strongest = np.argsort(-energy, kind="stable")[:_MOST_MODES]
    channels = np.sort(np.argsort(-np.sum(power, axis=0), kind="stable")[:_MOST_CHANNELS])
    data = model.data.channels(channels)
    fastest = float(np.max(frequency_hz(poles[strongest])))
    factor = max(1, int(1.0 / (_SAMPLES_PER_CYCLE * fastest * data.step_s)))
    factor = max(factor, data.time_s.size // _MOST_SAMPLES)
    data = data.averaged(factor) if factor * fastest * data.step_s < 0.4 else data
    since = (data.time_s - 0.5 * data.span_s) / max(data.span_s, 1e-300)
    middle = 0.5 * data.span_s
    growth = np.clip((data.time_s - middle)[:, None] * poles[strongest].real, -_GROWTH, _GROWTH)
    waves = np.exp(growth + 1j * data.time_s[:, None] * poles[strongest].imag)
    ramped = waves[:, :_LOOSE] * since[:, None]
    both = np.concatenate([waves, ramped], axis=1)
    return data, np.concatenate(
        [np.ones((since.size, 1)), real_columns(np.asarray(both, dtype=complex))], axis=1
    )

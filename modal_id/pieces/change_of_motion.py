"""Time at which a motion changes, among free decays whose poles are roughly known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modal_id.data import FitData
from modal_id.fit import ModalFit
from modal_id.segments.stop import running_rss
from modal_id.solve import frequency_hz, real_columns
from tracker import FloatArray


@dataclass(frozen=True)
class Tuning:
    """Changes of the motion within a decay."""

    #: [samples] samples per cycle of the search
    samples_per_cycle: float = 8.0
    #: [samples] largest number of samples of the search
    #: convention: Limits the computing time.
    most_samples: int = 3000
    #: [1] largest number of channels of the search
    #: convention: Limits the computing time.
    most_channels: int = 4
    #: [1] largest number of modes of the search
    #: convention: Limits the computing time.
    most_modes: int = 6
    #: [1] number of strongest modes whose waves times a ramp are fitted, too
    #: convention: They may decay otherwise than the fit says.
    loose: int = 2
    #: [1] largest exponent of the growth of a wave from the middle of the record
    growth: float = 8.0


TUNING = Tuning()


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
    strongest = np.argsort(-energy, kind="stable")[: TUNING.most_modes]
    channels = np.sort(np.argsort(-np.sum(power, axis=0), kind="stable")[: TUNING.most_channels])
    data = model.data.channels(channels)
    fastest = float(np.max(frequency_hz(poles[strongest])))
    factor = max(1, int(1.0 / (TUNING.samples_per_cycle * fastest * data.step_s)))
    factor = max(factor, data.time_s.size // TUNING.most_samples)
    data = data.averaged(factor) if factor * fastest * data.step_s < 0.4 else data
    since = (data.time_s - 0.5 * data.span_s) / max(data.span_s, 1e-300)
    middle = 0.5 * data.span_s
    growth = np.clip((data.time_s - middle)[:, None] * poles[strongest].real, -TUNING.growth, TUNING.growth)
    waves = np.exp(growth + 1j * data.time_s[:, None] * poles[strongest].imag)
    ramped = waves[:, : TUNING.loose] * since[:, None]
    both = np.concatenate([waves, ramped], axis=1)
    return data, np.concatenate(
        [np.ones((since.size, 1)), real_columns(np.asarray(both, dtype=complex))], axis=1
    )

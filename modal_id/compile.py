"""Compilation of the kernels of the identification: a short decay is identified, so that numba keeps what it needs."""

from __future__ import annotations

import numpy as np

from modal_id.identify import identify_free_decay
from modal_id.segments import stretch_costs
from modal_id.settings import IdentifySettings, SamplerSettings
from tracker import DisplacementSeries

_RATE_HZ = 200.0
_SAMPLES = 1000
# The damping rises with the amplitude, as in air, so that its curve is fitted too.
_FREQUENCY_HZ, _DAMPING_RATIO, _RISE = 11.3, 0.004, 4.0
_SHAPE_MM, _POSITIONS_MM = (0.4, 1.1, 2.0), (100.0, 250.0, 450.0)
_NOISE_MM = 5e-3


def compile_for_decays() -> None:
    """Compile what the identification of a decay needs."""
    rng = np.random.default_rng(1)
    time_s = np.arange(_SAMPLES) / _RATE_HZ
    omega = 2.0 * np.pi * _FREQUENCY_HZ
    # solution of a' = -D omega a (1 + R a) with a(0) = 1
    amplitude = 1.0 / ((1.0 + _RISE) * np.exp(_DAMPING_RATIO * omega * time_s) - _RISE)
    values = (amplitude * np.cos(omega * time_s))[:, None] * np.array(_SHAPE_MM)
    values += _NOISE_MM * rng.standard_normal(values.shape)
    series = DisplacementSeries(
        name="decay",
        time_s=time_s,
        channels=tuple(f"m{k + 1}" for k in range(len(_SHAPE_MM))),
        values=values,
        sd=np.full_like(values, _NOISE_MM),
        unit="mm",
        positions_mm=np.array(_POSITIONS_MM),
        direction=(1.0, 0.0),
    )
    few = SamplerSettings(burn_in_steps=2, check_steps=2, max_steps=2)
    identify_free_decay(series, IdentifySettings(sampler=few))


def compile_for_division() -> None:
    """Compile what the division of a record into stretches needs."""
    stretch_costs(np.ones((6, 1), dtype=complex), 0.0, 1.0, np.int64(1))

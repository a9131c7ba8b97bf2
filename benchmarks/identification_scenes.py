"""Decays of the identification benchmark with their Cramer-Rao bounds, and real recordings."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.coverage_cases import SNR_DB, make
from modal_id.posterior import modal_bound
from tracker import DisplacementSeries, FloatArray

MODES = (0, 1, 2, 3, 4)
# Cases of the coverage study; "all together" adds drift, hum, missing samples, outliers and a neighbouring mode.
NOISE = ("white", "AR(1) 0.5", "AR(1) 0.9", "all together")
REAL = Path(os.environ.get("MODALCAM_REALDATA") or Path(__file__).parents[1] / "realdata") / "al_cantilever"
# file pattern: frequency in Hz from one-mode fits by other methods
RECORDINGS = {"30cm*21-08-55*": 16.33, "50cm*11-46-55*": 6.05}
_REAL_SECONDS = 8.0


@dataclass(frozen=True)
class Decay:
    """A recording of one mode; `zeta` and its bound are NaN if the true value is unknown."""

    name: str
    mode: int
    series: DisplacementSeries
    frequency_hz: float
    zeta: float
    bound_zeta: float

    @property
    def time_s(self) -> FloatArray:
        """Times of the samples."""
        return self.series.time_s

    @property
    def values(self) -> FloatArray:
        """Values of the channel, NaN where missing."""
        return self.series.values[:, 0]


def synthetic(noise: str, mode: int, seed: int) -> Decay:
    """10 s of one mode of the paper's beam at 1000 fps and 40 dB; the bound is for white noise."""
    series, frequency, zeta = make(noise, mode, seed)
    sd = np.sqrt(0.5) * 10.0 ** (-SNR_DB / 20.0)
    bound = modal_bound(series.time_s, frequency, zeta, np.ones(1), 0.0, np.full(1, sd), with_drift=False)
    return Decay(noise, mode, series, frequency, zeta, bound.damping_sd)


def real() -> list[Decay]:
    """Accelerometer recordings of aluminium strips after their release; empty if the files are missing."""
    decays = []
    for pattern, frequency in RECORDINGS.items():
        for path in sorted(REAL.glob(pattern)):
            time_s, acceleration = np.load(path)
            # after the release, which saturates the sensor
            rows = (time_s > 2.0) & (time_s < 2.0 + _REAL_SECONDS)
            values = acceleration[rows, None]
            series = DisplacementSeries(
                name=path.stem,
                time_s=time_s[rows] - time_s[rows][0],
                channels=("a",),
                values=values,
                sd=np.full(values.shape, np.nan),
                unit="g",
                positions_mm=np.array([np.nan]),
            )
            decays.append(Decay(path.stem, -1, series, frequency, float("nan"), float("nan")))
    return decays

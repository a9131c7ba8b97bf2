"""The decays of the identification benchmark, their bounds, and where real ones are."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.support.modal_decays import PAPER_HZ, PAPER_ZETA, cramer_rao, dirty, one_mode
from tracker.arrays import FloatArray
from tracker.results import DisplacementSeries

MODES = (0, 1, 2, 3, 4)
# Correlation of neighbouring noise samples; "dirty" has drift, lost samples, outliers and a neighbouring mode as well.
NOISE = {"white": 0.0, "AR(1) 0.5": 0.5, "AR(1) 0.9": 0.9}
REAL = Path(__file__).parents[1] / "../shared/realdata/al_cantilever"
# Recording and the frequency that other methods' one-mode fits give.
RECORDINGS = {"30cm*21-08-55*": 16.33, "50cm*11-46-55*": 6.05}
_REAL_SECONDS = 8.0


@dataclass(frozen=True)
class Decay:
    """A record with one mode to be found; truths and bounds are NaN where nobody knows them."""

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
        """The channel, NaN where lost."""
        return self.series.values[:, 0]


def synthetic(noise: str, mode: int, seed: int) -> Decay:
    """10 s of one mode of the paper's beam at 1000 fps and 40 dB."""
    if noise == "dirty":
        series, sd = dirty(mode, seed), float(np.sqrt(0.5) * 0.01)
    else:
        series, sd = one_mode(mode, seed, ar=NOISE[noise])
    bound = float(cramer_rao(mode, sd, series.time_s)[1])
    return Decay(noise, mode, series, float(PAPER_HZ[mode]), float(PAPER_ZETA[mode]), bound)


def real() -> list[Decay]:
    """Accelerometer records of aluminium strips, from their largest swing on; none where they are not to be had."""
    decays = []
    for pattern, frequency in RECORDINGS.items():
        for path in sorted(REAL.glob(pattern)):
            time_s, acceleration = np.load(path)
            # After the release and what the sensor clips of it.
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

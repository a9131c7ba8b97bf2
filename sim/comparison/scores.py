r"""Proper scores of a predictive density, and the standard error of their difference.

The log predictive density and the continuous ranked probability score (CRPS) of a normal prediction N(m, s^2) at the
sample y, z = (y - m) / s, are

.. math::  \log p = -\tfrac12 z^2 - \log s - \tfrac12 \log 2\pi , \qquad
           \mathrm{CRPS} = s \left( z (2 \Phi(z) - 1) + 2 \varphi(z) - \pi^{-1/2} \right) .

Larger log densities and smaller CRPS (in the unit of y) are better.

References
----------
Gneiting, Raftery, "Strictly proper scoring rules, prediction, and estimation", JASA 102 (2007) 359-378,
doi:10.1198/016214506000001437. Newey, West, Econometrica 55 (1987) 703-708, doi:10.2307/1913610.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from tracker import FloatArray

Score = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]


@dataclass(frozen=True)
class Tuning:
    """Correlation of the noise."""

    #: [periods] noise is taken as uncorrelated at this distance (Bartlett's weights)
    #: measurement: Standard errors agree with the scatter over 250 records, white or AR(1) 0.9, within 15 %
    #: (docs/theory.md).
    lag_periods: int = 4


TUNING = Tuning()
# quadrature nodes of the average over the noise of a sample
_NODES = 7


@dataclass(frozen=True)
class ScoreSum:
    """A sum of scores, or of differences of scores, with its standard error due to the noise of the recordings."""

    total: float
    se: float
    samples: int

    def __add__(self, other: ScoreSum) -> ScoreSum:
        """Sum over two recordings, whose noise is independent."""
        return ScoreSum(
            self.total + other.total, float(np.hypot(self.se, other.se)), self.samples + other.samples
        )

    @property
    def mean(self) -> float:
        """Per sample; NaN without samples."""
        return self.total / self.samples if self.samples else float("nan")

    @property
    def standard_errors(self) -> float:
        """The total over its standard error."""
        return self.total / self.se if self.se > 0.0 else float("nan")


def log_density(sample: FloatArray, mean: FloatArray, sd: FloatArray) -> FloatArray:
    """Log density of normal predictions at the samples, in nats for the unit of the samples; larger is better."""
    z = (sample - mean) / sd
    return np.asarray(-0.5 * z**2 - np.log(sd) - 0.5 * np.log(2.0 * np.pi))


def crps(sample: FloatArray, mean: FloatArray, sd: FloatArray) -> FloatArray:
    """Continuous ranked probability score of normal predictions, in the unit of the samples; smaller is better."""
    z = (sample - mean) / sd
    density = np.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi)
    return np.asarray(sd * (z * (2.0 * ndtr(z) - 1.0) + 2.0 * density - 1.0 / np.sqrt(np.pi)))


@dataclass(frozen=True)
class Prediction:
    """Normal predictive density of every sample: mean and standard deviation, shape (n, k)."""

    mean: FloatArray
    sd: FloatArray


@dataclass(frozen=True)
class Samples:
    """Measured samples of a mode, shape (n, k), those to be scored, and their noise about a fit to the recording."""

    time_s: FloatArray
    values: FloatArray
    used: NDArray[np.bool_]
    fitted: FloatArray
    noise_sd: FloatArray
    period_s: float


def score_sum(samples: Samples, score: Score, prediction: Prediction) -> ScoreSum:
    """Sum of the scores of one prediction."""
    return _sum(samples, lambda y: score(y, prediction.mean, prediction.sd))


def score_difference(samples: Samples, score: Score, one: Prediction, other: Prediction) -> ScoreSum:
    """Sum of the scores of `one` minus those of `other`.

    Notes
    -----
    The samples of a vibration are not independent: coloured noise correlates neighbours, and the difference between two
    models follows the motion. The standard error is that over repeated recordings of the same motion with independent
    noise: the contribution of a sample is its score minus the mean score over the noise about the fitted motion. The
    contributions are summed over periods of the mode and over all channels, and the variance of their sum allows for
    correlation within four periods (Newey and West, Bartlett's weights). A misfit of the fit counts as noise and
    increases it.
    """
    return _sum(samples, lambda y: score(y, one.mean, one.sd) - score(y, other.mean, other.sd))


def correlated_square(blocks: FloatArray) -> FloatArray:
    """Covariance of the sum of the rows, (p, c) to (c, c), one row a period (Newey and West, Bartlett's weights)."""
    total = blocks.T @ blocks
    for lag in range(1, min(TUNING.lag_periods, len(blocks))):
        cross = blocks[lag:].T @ blocks[:-lag]
        total = total + (1.0 - lag / TUNING.lag_periods) * (cross + cross.T)
    return np.asarray(total)


def _sum(samples: Samples, score: Callable[[FloatArray], FloatArray]) -> ScoreSum:
    valid = samples.used & np.isfinite(samples.values)
    if not np.any(valid):
        return ScoreSum(float("nan"), float("nan"), 0)
    observed = np.where(valid, samples.values, 0.0)
    scored = score(observed)
    nodes, weights = np.polynomial.hermite_e.hermegauss(_NODES)
    expected = sum(
        weight / np.sqrt(2.0 * np.pi) * score(samples.fitted + node * samples.noise_sd)
        for node, weight in zip(nodes, weights, strict=True)
    )
    moved = np.where(valid, scored - expected, 0.0).sum(axis=1)
    period = np.floor((samples.time_s - samples.time_s[0]) / samples.period_s).astype(np.int64)
    variance = float(
        correlated_square(np.bincount(period, weights=moved).astype(np.float64)[:, np.newaxis])[0, 0]
    )
    return ScoreSum(
        float(scored[valid].sum()), float(np.sqrt(max(variance, 0.0))), int(np.count_nonzero(valid))
    )

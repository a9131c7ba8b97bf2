"""The expected periodogram against its definition, and the likelihood's slopes against differences."""

import numpy as np
import pytest

from benchmarks.ambient_scenes import response
from modal_id.ambient import log_sds, transfer


def test_the_expected_periodogram_is_the_transform_of_the_windowed_autocovariance():
    """The sum term by term: equal to rounding."""
    hz, zeta, n, step_s = 3.0, 0.02, 600, 0.05
    root = np.sqrt(1.0 - zeta**2)
    lags = np.arange(1 - n, n)
    pole = 2.0 * np.pi * hz * complex(-zeta, root)
    covariance = (
        np.pi * hz / (4.0 * zeta) * np.real((1.0 - 1j * zeta / root) * np.exp(pole * np.abs(lags) * step_s))
    )
    at = np.array([0.5, 2.9, 3.0, 3.05, 5.0, 9.9])
    terms = (1.0 - np.abs(lags) / n) * covariance * np.cos(2.0 * np.pi * np.outer(at, lags) * step_s)
    expected = 2.0 * step_s * np.sum(terms, axis=1)
    assert np.abs(transfer(at, hz, zeta, n, step_s)) ** 2 == pytest.approx(expected, rel=1e-9)


def test_the_expected_periodogram_is_the_mean_of_those_of_simulations():
    """400 records of few bandwidths, 90 s at 2 %: each bin is exponential, its mean has a relative sd of 1 / 20."""
    hz, zeta, n, step_s = 2.0, 0.02, 900, 0.1
    rng = np.random.default_rng(1)
    runs = [response(np.array([hz]), np.array([zeta]), np.eye(1), n, step_s, rng)[:, 0] for _ in range(400)]
    power = np.mean(np.abs(np.fft.rfft(runs, axis=1)) ** 2, axis=0) * 2.0 * step_s / n
    at = np.arange(power.size)[150:210] / (n * step_s)
    # unit variance: the density of the force that gives it
    expected = np.abs(transfer(at, hz, zeta, n, step_s)) ** 2 * 4.0 * zeta / (np.pi * hz)
    ratio = power[150:210] / expected
    off = np.max(np.abs(ratio - 1.0))
    assert off < 4.5 / 20.0, f"off by {off:.2f}, 4.5 sd are 0.22"
    # 60 bins together: 0.0065; the receptance without leakage is 0.12 off at the peak
    assert np.mean(ratio) == pytest.approx(1.0, abs=4.0 / np.sqrt(60.0 * 400.0))


def test_the_law_is_the_information_of_the_spectrum():
    """Against sums over the frequencies of a band, the level of the force eliminated: the limit of long records."""
    hz, zeta, span_s, reach = 5.0, 0.005, 4000.0, 8.0
    at = np.arange(hz * (1.0 - reach * zeta), hz * (1.0 + reach * zeta), 1.0 / span_s)

    def log_density(log_hz, log_zeta):
        b, z = at / np.exp(log_hz), np.exp(log_zeta)
        return -np.log((1.0 - b**2) ** 2 + (2.0 * z * b) ** 2)

    h, centre = 1e-5, np.log([hz, zeta])
    slopes = [
        (log_density(*(centre + h * unit)) - log_density(*(centre - h * unit))) / (2.0 * h)
        for unit in np.eye(2)
    ]
    columns = np.stack([*slopes, np.ones(at.size)])
    sds = np.sqrt(np.diag(np.linalg.inv(columns @ columns.T)))[:2]
    # terms of the order of zeta times the reach
    assert log_sds(hz, zeta, span_s, reach) == pytest.approx(tuple(sds), rel=0.03)

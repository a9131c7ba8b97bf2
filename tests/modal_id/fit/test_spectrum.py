"""Noise level of a spectrum, computed where it is needed, and the strongest line above it."""

import numpy as np
import pytest
from scipy.ndimage import median_filter

from modal_id.fit import ResidualSpectrum, largest_significant, least_level, local_level, mean_per_median

THRESHOLD = 12.0


def levels(power, channels):
    wide, narrow = (median_filter(power, min(size, power.size), mode="reflect") for size in (122, 30))
    return np.maximum(wide, narrow) * mean_per_median(channels)


@pytest.mark.parametrize("size", [1, 5, 31, 121, 122, 150, 5001])
def test_the_level_and_its_bound_against_running_medians(size):
    rng = np.random.default_rng(size)
    for channels in (1, 3):
        power = rng.gamma(channels, size=size) * np.exp(np.linspace(0.0, 5.0, size))
        power[rng.integers(size, size=1 + size // 100)] *= 100.0
        expected = levels(power, channels)
        np.testing.assert_array_equal(local_level(power, channels, np.arange(size)), expected)
        assert np.all(least_level(power, channels) <= expected)
        look = rng.random(size) < 0.8
        excess = power / expected * channels
        lines = np.where(look & (excess > THRESHOLD), power, 0.0)
        spectrum = ResidualSpectrum(0.1 * np.arange(size), power, THRESHOLD, channels)
        peak, score = largest_significant(spectrum, look)
        if np.any(lines > 0.0):
            assert peak == np.argmax(lines)
            assert score == excess[peak] / THRESHOLD
        else:
            assert peak is None

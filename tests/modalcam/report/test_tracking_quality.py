"""Tracking quality against known noise."""

from dataclasses import replace

import numpy as np
import pytest
from kit import runs

from modalcam.report import prediction_residual, tracking_quality


def noisy_tracks(stated=0.02, sd=0.02, n=3000):
    tracks = runs.recording(0, seconds=n / 500).tracks
    rng = np.random.default_rng(5)
    k = len(tracks.markers)
    swing = np.sin(0.3 * np.arange(n))[:, None] * np.linspace(1.0, 4.0, k)
    x = 60 + swing + sd * rng.standard_normal((n, k))
    y = 100 + 0.1 * swing + sd * rng.standard_normal((n, k))
    stated_sd = np.full((n, k), stated)
    flags = np.zeros((n, k), np.uint32)
    return replace(tracks, x_px=x, y_px=y, sd_x_px=stated_sd, sd_y_px=stated_sd, flags=flags)


@pytest.mark.parametrize("stated", [0.01, 0.02, 0.04])
def test_scatter_is_the_noise_and_the_ratio_reveals_a_wrong_sd(stated):
    quality = tracking_quality(noisy_tracks(stated))
    # The sd of a median of 3000 absolute residuals is 1.17 / sqrt(3000) = 2.1 %: 4 sd for ten series.
    assert quality.scatter_px == pytest.approx(np.full((2, 5), 0.02), rel=0.09)
    assert np.all(quality.stated_px == stated)
    # Bins of 50 frames, 5 markers and 2 coordinates have an sd of 1 / sqrt(1000) = 3.2 %: 4 sd.
    assert quality.ratio == pytest.approx(np.full(quality.ratio.size, 0.02 / stated), rel=0.13)


def test_vibration_is_predicted_and_gaps_are_not_filled():
    n = np.arange(2000)
    wave = 5 * np.sin(0.21 * n) + 0.5 * np.sin(1.3 * n)
    wave[700] = np.nan
    residual = prediction_residual(wave)
    gaps = np.flatnonzero(np.isnan(residual))
    assert np.nanmax(np.abs(residual)) < 1e-6
    assert gaps.tolist() == [*range(8), *range(692, 709), *range(1992, 2000)]
    assert np.isnan(prediction_residual(np.zeros(50))).all()


def test_too_short_series_have_no_figure():
    tracks = noisy_tracks(n=50)
    assert tracking_quality(tracks) is None

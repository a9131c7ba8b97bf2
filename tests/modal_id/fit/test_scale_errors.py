"""The error of a correction of the scale in the interval of the damping ratio."""

from dataclasses import replace

import numpy as np
import pytest
from kit.series import series_of

from modal_id import IdentifySettings, identify
from tracker import ScaleChange


def test_an_error_of_the_scale_is_in_the_interval_of_the_damping_ratio():
    time_s = np.arange(1000) / 250.0
    omega, zeta, start_s = 66.0, 0.005, 100.0
    wave = 3.0 * np.exp(-zeta * omega * time_s) * np.cos(omega * time_s)
    values = wave + 0.02 * np.random.default_rng(2).standard_normal(1000)
    series = series_of(start_s + time_s, values, sd=0.02)
    # The coefficients of a straight line are proportional to the means of three knots.
    knots = start_s + np.repeat([0.0, time_s[-1]], 4)
    slope_per_s = 0.005
    root = slope_per_s * np.array([[0.0, 1.0, 2.0, 3.0]]).T * time_s[-1] / 3.0
    change = ScaleChange(knots, np.ones(4), root)
    settings = IdentifySettings(onset_s=start_s, seed=1)
    exact = identify(series, settings).modes[0]
    uncertain = identify(replace(series, scale_change=change), settings).modes[0]
    expected = np.hypot(exact.damping_ratio_sd, slope_per_s / omega)
    # The sd of the draws of both is known to a percent or two.
    assert uncertain.damping_ratio_sd == pytest.approx(expected, rel=0.05)
    assert uncertain.frequency_sd_hz == pytest.approx(exact.frequency_sd_hz, rel=0.1)

"""Predicted intervals: scaling laws and limiting effects."""

import numpy as np
import pytest

from modalcam.apps.plan import Plan, advice, predict
from modalcam.report.style import significant


def test_the_tolerance_of_the_rate_adds_to_the_frequency_alone(plan_of):
    """100 and 100 000 ppm of 10.6 Hz, in quadrature with the noise."""
    exact, some, much = (
        predict(plan_of(plan={"modes": [2]}, camera=camera))[0]
        for camera in ({}, {"fps_tolerance_ppm": 100.0}, {"fps_tolerance_ppm": 1e5})
    )
    for mode, ppm in ((some, 100.0), (much, 1e5)):
        clock_hz = 1e-6 * ppm * mode.frequency_hz
        assert mode.frequency_sd_hz == pytest.approx(np.hypot(exact.frequency_sd_hz, clock_hz))
        assert mode.damping_sd == exact.damping_sd


def noise_sd(mode):
    """Predicted standard deviation without the template factor."""
    return mode.damping_sd / mode.template_factor


def test_intervals_scale_with_amplitude_and_rate(plan_of):
    (base,) = predict(plan_of(plan={"modes": [2]}))
    (twice,) = predict(plan_of(plan={"modes": [2], "tip_amplitude_mm": [5.0]}))
    assert noise_sd(base) / noise_sd(twice) == pytest.approx(2.0, rel=1e-6)
    (fast,) = predict(plan_of({"fps": 1000}, plan={"modes": [2]}))
    # Twice the samples of the same motion.
    assert noise_sd(base) / noise_sd(fast) == pytest.approx(np.sqrt(2.0), rel=0.01)
    # More samples do not reduce the template noise.
    assert fast.template_factor > base.template_factor > 1.0


def test_limits_and_expected_failures_are_reported(plan_of):
    slow = predict(plan_of({"fps": 50}))
    texts = advice(Plan(plan_of(), slow))
    assert any("Aliased" in w and "20.74 Hz" in w for w in texts if w.startswith("Mode 3: ")), texts
    assert slow[1].seen_hz == pytest.approx(50.0 - slow[1].frequency_hz)
    fast = {"modes": [3], "tip_amplitude_mm": [60.0], "decay_s": 0.5}
    (blurred,) = predict(plan_of({"exposure_s": 0.0019}, plan=fast))
    assert "exposure blur" in [limit.cause for limit in blurred.limits]
    (short,) = predict(plan_of(plan={"modes": [2], "decay_s": 1.0}))
    assert short.limits[0].cause == "length of the record"
    (tiny,) = predict(plan_of(plan={"modes": [3], "tip_amplitude_mm": [0.02]}))
    assert any("light flicker" in w for w in advice(Plan(plan_of(), (tiny,))))
    # Mode 2 of a cantilever has its node at 0.783 of the length.
    (node,) = predict(plan_of(markers={"positions_mm": [391.7]}, plan={"modes": [2]}))
    assert node.limits[0].cause == "markers near nodes of the mode"
    assert node.limits[0].factor > 10.0


def test_a_nonlinear_amplitude_is_reported_with_the_largest_linear_one(plan_of):
    (large,) = predict(plan_of(plan={"modes": [3], "tip_amplitude_mm": [1.5], "decay_s": 2.0}))
    assert large.linear_tip_mm < 1.0
    tip_mm = 0.99 * large.linear_tip_mm
    (small,) = predict(plan_of(plan={"modes": [3], "tip_amplitude_mm": [tip_mm], "decay_s": 2.0}))
    assert small.linear_tip_mm == float("inf")
    texts = [text for text in advice(Plan(plan_of(), (large,))) if "amplitude-dependent" in text]
    assert len(texts) == 1
    assert f"{significant(large.linear_tip_mm, 2)} mm (mode 3)" in texts[0]

"""Scatter of rendered, tracked and identified recordings against the prediction."""

import pytest

from modalcam.apps.plan import predict, run_trials

# Short recordings of few pixels, each with another limit: mode 2 the length of the record, mode 3 motion blur
# at an amplitude with softening, mode 1 drift in a few slow cycles.
SETUPS = {
    "short": (
        {"fps": 200},
        {"positions_mm": [300.0, 480.0]},
        {"modes": [2], "tip_amplitude_mm": [1.5], "damping_ratio": [0.008], "decay_s": 2.0},
    ),
    "blur": (
        {"fps": 200, "mm_per_px": 0.7, "exposure_s": 0.0048},
        {"size_mm": 10.0, "positions_mm": [300.0, 488.0]},
        {"modes": [3], "tip_amplitude_mm": [1.5], "decay_s": 2.0, "read_noise_sd": 4.0},
    ),
    "aruco": (
        {"fps": 30, "mm_per_px": 2.0},
        {"kind": "aruco", "size_mm": 40.0, "positions_mm": [300.0, 460.0]},
        {"modes": [1], "tip_amplitude_mm": [5.0], "damping_ratio": [0.01]}
        | {"decay_s": 6.0, "read_noise_sd": 3.0},
    ),
}


def spread_over_prediction(asked, trials, jobs):
    (predicted,) = predict(asked)
    (tried,) = run_trials(asked, trials, seed=5, jobs=jobs)
    # of 100, 2 of "aruco" and 6 of "blur" have a short drive taken for a decay, or a rate for a converted one; flagged
    assert tried.identified >= 0.9 * trials, tried.problems
    return tried.damping_spread / predicted.damping_sd


@pytest.mark.usefixtures("in_process")
def test_a_few_rendered_recordings_scatter_as_predicted(plan_of):
    camera, _, plan = SETUPS["short"]
    one = plan_of({**camera, "fps": 100}, {"positions_mm": [480.0]}, plan)
    ratio = spread_over_prediction(one, 4, jobs=1)
    # Three degrees of freedom: chi-square's 0.1 % and 99.9 % points, 0.0243 and 16.27, give these ratios.
    assert 0.09 < ratio < 2.33, f"rendered recordings scatter {ratio:.2f} times as predicted"


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("name", SETUPS)
def test_a_hundred_rendered_recordings_scatter_as_predicted(name, plan_of):
    ratio = spread_over_prediction(plan_of(*SETUPS[name]), 100, jobs=2)
    # A standard deviation from 100 values has an sd of 7.1 %: two of these. Measured: 0.96, 1.04 and 1.12; the
    # last with 98 other seeds, tracked and projected on damping: 0.95.
    assert ratio == pytest.approx(1.0, abs=0.15), f"{name}: the spread is {ratio:.3f} of the prediction"

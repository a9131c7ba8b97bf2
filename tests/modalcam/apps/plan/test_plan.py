"""Trials of a plan against its prediction, suggested positions and frame rates, and the plan as a page."""

import numpy as np
import pytest
from kit.beams import BEAM
from support.command import finished
from support.html_page import assert_sound

from modalcam.apps.plan import (
    Plan,
    TrialSummary,
    better_positions,
    frame_rates,
    plan_html,
    predict,
    run_trials,
)
from modalcam.report.style import significant

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


def test_better_positions_narrow_the_intervals_and_are_far_enough_apart(plan_of):
    asked = plan_of(markers={"positions_mm": [20.0, 60.0, 391.0]})
    (positions,) = better_positions(asked)
    assert np.all(np.diff(positions.positions_mm) >= 20.0)
    assert min(positions.factors) < 0.9
    moved = predict(plan_of(markers={"positions_mm": list(positions.positions_mm)}))
    for now, then, factor in zip(predict(asked), moved, positions.factors, strict=True):
        assert then.damping_sd / now.damping_sd == pytest.approx(factor, rel=0.02)


def test_suggested_frame_rates_separate_the_modes(plan_of):
    asked = plan_of()
    modes = predict(asked)
    found = frame_rates(modes)
    assert found
    for rate in found:
        apparent = sorted([0.0, 0.5 * rate.fps, *rate.seen_hz])
        assert min(np.diff(apparent)) > 0.1
        assert rate.aliased == (max(m.frequency_hz for m in modes) > 0.5 * rate.fps)


def test_suggestions_follow_the_setup_of_each_recording(plan_of):
    """A mode recorded with another camera and other markers has separate suggestions."""
    near_node = {"positions_mm": [20.0, 60.0, 391.0]}
    recordings = [
        {"file": "a.avi", "mode": 2, **near_node},
        {"file": "b.avi", "mode": 3, "fps": 50, "positions_mm": [15.0, 40.0]},
    ]
    asked = plan_of(recordings=recordings)
    found = better_positions(asked)
    assert [(p.modes, len(p.positions_mm)) for p in found] == [((2,), 3), ((3,), 2)]
    assert {rate.modes for rate in frame_rates(predict(asked))} == {(2,), (3,)}


def test_the_command_prints_the_plan_and_writes_the_page(tmp_path):
    config = tmp_path / "experiment.toml"
    config.write_text(
        "[camera]\nfps = 500\nmm_per_px = 2.0\n[markers]\nkind = 'blob'\nsize_mm = 20.0\n"
        "positions_mm = [190.0, 390.0]\n[plan]\nmodes = [2]\n[beam]\n"
        + "".join(f"{k} = {v}\n" for k, v in BEAM.items())
    )
    out = tmp_path / "plan.html"
    assert "10.57" in finished("plan", config, "-o", out)
    found = assert_sound(out.read_text(encoding="utf-8"))
    assert "script" not in found.tags
    assert "10.579 ±" in found.words
    assert "± is one standard deviation" in found.words
    assert "Tip amplitudes of 10 mm over the mode number squared" in found.words


def test_trials_are_shown_with_the_prediction_and_the_reasons_of_failures(plan_of):
    request = plan_of(plan={"modes": [2]})
    modes = predict(request)
    sd = modes[0].damping_sd
    trials = TrialSummary(2, 4, 5, 1.1 * sd, ("no marker was seen",))
    words = assert_sound(plan_html(Plan(request, modes, trials=(trials,)))).words
    assert "1.10 of predicted" in words
    assert f"± {significant(100.0 * sd, 2)}" in words, "one sd, as in a run"
    assert "identified in 4 of 5 rendered recordings. No marker was seen." in words


def test_a_plan_is_plotted_with_its_intervals(plan_of):
    request = plan_of()
    axes = Plan(request, predict(request)).plot()
    assert "damping ratio" in axes.get_ylabel()
    assert [len(line.get_xdata()) for line in axes.lines[:1]] == [2]

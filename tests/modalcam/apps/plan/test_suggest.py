"""Suggested marker positions and frame rates."""

import numpy as np
import pytest

from modalcam.apps.plan import better_positions, frame_rates, predict


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

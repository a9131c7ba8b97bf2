"""Joint assignment of spots to markers, against the truth of random scenes."""

import numpy as np
import pytest

from tracker.markers import Expectation, Scene, assign, completed

CORNERS = np.array([[10.0, 10.0], [1270.0, 590.0]])
SIZE_PX = 16.0


def scene_of(expected, spots, sd_px=1.0):
    expectation = Expectation(expected, sd_px)
    return Scene(expectation, np.asarray(spots, dtype=float).reshape(-1, 2), SIZE_PX, CORNERS)


def line(rng, count, spacing, angle):
    along = spacing * (np.arange(count) - 0.5 * (count - 1)) * (1 + 0.1 * rng.uniform(-1, 1))
    return np.array([640.0, 300.0]) + along[:, None] * np.array([np.cos(angle), np.sin(angle)])


@pytest.mark.parametrize("jumps", [100, pytest.param(200, marks=pytest.mark.slow)])
def test_a_common_jump_by_any_distance_keeps_every_identity(jumps):
    rng = np.random.default_rng(1)
    refused = 0
    for _ in range(jumps):
        count, spacing, angle = int(rng.integers(2, 9)), rng.uniform(30, 60), rng.uniform(-0.3, 0.3)
        expected = line(rng, count, spacing, angle)
        jump = rng.uniform(-3, 3) * spacing * np.array([np.cos(angle), np.sin(angle)])
        order = rng.permutation(count)
        found = assign(scene_of(expected, (expected + jump + rng.normal(0, 0.3, expected.shape))[order]))
        if np.all(found.spots < 0):
            # A jump by a whole spacing may also be rest, with one dot hidden and one come into being.
            steps = np.hypot(*jump) / np.hypot(*np.diff(expected, axis=0)[0])
            assert abs(steps - round(steps)) < 0.2, f"{count} dots moved by {steps:.2f} spacings were refused"
            refused += 1
        else:
            assert order[found.spots].tolist() == list(range(count)), f"{count} dots moved by {jump} px"
    # Within an sd of the prediction of 1 px times 3 of a whole spacing of 30 to 60 px: 13 % of the jumps.
    assert refused < 0.2 * jumps


@pytest.mark.parametrize("scenes", [120, pytest.param(400, marks=pytest.mark.slow)])
def test_missing_dots_and_false_spots_never_give_a_neighbour(scenes):
    """A wrong identity needs a dot that is not found and a false spot at once, both in the right places."""
    rng = np.random.default_rng(2)
    refused = wrong = markers = 0
    for _ in range(scenes):
        count, angle = int(rng.integers(3, 9)), rng.uniform(-np.pi, np.pi)
        expected = line(rng, count, 45.0, angle)
        sd_px = 10 ** rng.uniform(0, 1)
        truth = expected + sd_px * rng.standard_normal(2) + rng.normal(0, 0.5, expected.shape)
        seen = np.flatnonzero(rng.random(count) > 0.1)
        false = rng.uniform([100, 100], [1200, 500], (rng.poisson(0.3), 2))
        found = assign(scene_of(expected, np.concatenate([truth[seen], false]), sd_px))
        for k, spot in enumerate(found.spots):
            is_right = spot >= 0 and spot < len(seen) and seen[spot] == k
            wrong += spot >= 0 and spot < len(seen) and not is_right
            refused += k in seen and spot < 0
            markers += 1
    assert wrong == 0, f"{wrong} of {markers} markers got a neighbour's position"
    # A motion of 10 px sd at a spacing of 45 px leaves an end in doubt in few scenes.
    assert refused < 0.05 * markers, f"{refused} of {markers} visible markers were left out"


@pytest.mark.parametrize("hidden", [0, 4])
def test_a_jump_with_one_end_hidden_is_ambiguous_unless_it_was_expected(hidden):
    expected = np.column_stack([np.linspace(400, 600, 5), np.full(5, 300.0)])
    seen = np.delete(expected + np.array([20.0, 0.0]), hidden, axis=0)
    # By 20 px to the right, or by 30 px to the left with the other end hidden: both unexpected.
    doubtful = assign(scene_of(expected, seen))
    assert np.all(doubtful.spots == -1)
    assert doubtful.ambiguous.sum() >= 3
    expected_jump = assign(scene_of(expected + np.array([19.0, 0.0]), seen))
    assert expected_jump.spots.tolist() == np.insert(np.arange(4), hidden, -1).tolist()


def test_a_line_that_bends_by_more_than_its_spacing_is_assigned_in_order():
    rng = np.random.default_rng(3)
    expected = np.column_stack([np.linspace(300, 700, 11), np.full(11, 300.0)])
    bent = expected + np.column_stack([np.zeros(11), 120.0 * np.sin(np.linspace(0, np.pi, 11))])
    order = rng.permutation(11)
    found = assign(scene_of(expected, bent[order]))
    assert order[found.spots].tolist() == list(range(11))


def test_without_spots_there_is_no_assignment():
    expected = np.array([[100.0, 100.0], [150.0, 100.0]])
    found = assign(scene_of(expected, []))
    assert found.spots.tolist() == [-1, -1]
    assert np.all(np.isnan(found.motion_px))


def test_missing_markers_are_placed_as_the_others_moved():
    form = np.column_stack([np.arange(5) * 40.0, np.zeros(5)])
    turned = form @ np.array([[0.96, 0.28], [-0.28, 0.96]]) + [7.0, -3.0]
    known = turned.copy()
    known[[1, 4]] = np.nan
    assert completed(known, form) == pytest.approx(turned, abs=1e-9)

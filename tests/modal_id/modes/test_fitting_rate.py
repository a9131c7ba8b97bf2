"""A wrong sampling rate is named where lines or their shapes are modes of the beam at another, and only there."""

import numpy as np
import pytest
from kit.series import clamped_free_shapes, pole_of, series_of

from modal_id import IdentifySettings, SamplerSettings, identify
from modal_id.modes import choose_target

THEORY_HZ = (1.876, 10.58, 29.26, 57.15, 94.34)
TRUE_HZ = {2: 10.19, 4: 53.2}
SHAPES = clamped_free_shapes()
# Rates do not depend on the posterior, which these few steps leave undetermined.
QUICK = SamplerSettings(walkers=16, burn_in_steps=2, check_steps=2, max_steps=2)


def choice_of(lines_hz, shapes, numbers, mode, rate_hz):
    """The choice among lines with these shapes, the strongest first."""
    settings = IdentifySettings(mode=mode, expected_frequencies_hz=THEORY_HZ, expected_shapes=SHAPES)
    strength = 1.0 / np.arange(1.0, len(lines_hz) + 1.0)
    return choose_target(np.array(lines_hz), np.array(shapes, complex), strength, numbers, settings, rate_hz)


@pytest.mark.parametrize(("mode", "true_rate_hz"), [(2, 200.0), (2, 500.0), (4, 500.0), (4, 250.0)])
@pytest.mark.parametrize("rate_hz", [25.0, 30.0, 150.0])
def test_the_rate_that_fits_is_named(mode, true_rate_hz, rate_hz):
    apparent_hz = np.array([TRUE_HZ[mode] * rate_hz / true_rate_hz])
    settings = IdentifySettings(mode=mode, expected_frequencies_hz=THEORY_HZ)
    choice = choose_target(apparent_hz, np.ones((1, 1)), np.ones(1), (None,), settings, rate_hz)
    assert choice.index is None
    assert f"at a sampling rate of {true_rate_hz:g} Hz (recorded: {rate_hz:g} Hz)" in choice.why.reason
    assert f"a ratio of {true_rate_hz / rate_hz:.3g}" in choice.why.reason


def test_a_rate_that_no_camera_offers_is_a_range():
    settings = IdentifySettings(mode=2, expected_frequencies_hz=THEORY_HZ)
    choice = choose_target(np.array([1.0]), np.ones((1, 1)), np.ones(1), (None,), settings, 33.0)
    assert "at a sampling rate of 314 to 384 Hz (recorded: 33 Hz), a ratio of 10.6" in choice.why.reason


def test_without_shapes_a_line_near_another_mode_is_said_to_be_either():
    settings = IdentifySettings(mode=2, expected_frequencies_hz=THEORY_HZ)
    choice = choose_target(np.array([25.47]), np.ones((1, 1)), np.ones(1), (3,), settings, 500.0)
    assert choice.index is None
    assert "would be mode 2 of the beam, unless it is mode 3 at the recorded rate" in choice.why.reason


def test_a_weak_line_near_the_wanted_mode_does_not_hide_the_rate():
    """At 1000 instead of 200 Hz mode 2 is at 50.95 Hz, and a line of another shape is where mode 2 should be."""
    choice = choice_of([50.95, 9.25], [SHAPES[:, 1], [1, -1, 1, -1, 1, -1]], (4, 2), 2, 1000.0)
    assert choice.index is None
    assert choice.why.reason.startswith("at a sampling rate of 200 Hz (recorded: 1000 Hz), a ratio of 0.2")
    assert "the mode found at 9.25 Hz has another shape" in choice.why.reason


def test_a_mode_that_was_not_excited_is_no_wrong_rate():
    """Mode 4 is wanted, and the line has frequency and shape of mode 2: the rate is right."""
    choice = choice_of([10.19], [SHAPES[:, 1]], (2,), 4, 200.0)
    assert (choice.index, choice.fitting) == (None, None)
    assert "sampling rate" not in choice.why.reason


def test_a_line_with_the_shape_of_no_mode_is_no_wrong_rate():
    """The support sways: all markers move alike, which is the shape of no clamped mode."""
    choice = choice_of([0.7], [np.ones(6)], (None,), 1, 200.0)
    assert (choice.index, choice.fitting) == (None, None)


def test_motion_of_the_support_below_the_first_mode_is_no_wrong_rate_where_a_mode_is_in_place():
    """Slow motion bends the beam as mode 1 does; a weaker mode 2 where theory expects it confirms the rate."""
    choice = choice_of([0.9, 10.19], [SHAPES[:, 0], SHAPES[:, 1]], (None, 2), None, 200.0)
    assert (choice.index, choice.fitting) == (0, None)


def test_without_a_wanted_mode_the_shape_decides():
    choice = choice_of([3.192], [SHAPES[:, 3]], (None,), None, 30.0)
    assert choice.index == 0
    assert (choice.fitting.limits_hz, choice.fitting.number) == ((500.0, 500.0), 4)


def test_at_the_true_rate_the_mode_is_found():
    choice = choice_of([53.2, 10.2], [SHAPES[:, 3], SHAPES[:, 1]], (4, 2), 4, 500.0)
    assert (choice.index, choice.why.reason, choice.fitting) == (0, "", None)


def random_identification(seed, error):
    """One to three modes of the cantilever, each off from theory by up to `error`, at two to eight positions.

    The wanted mode is the strongest, a weaker one, one that is not excited, or none.
    """
    rng = np.random.default_rng(seed)
    positions_mm = np.sort(rng.uniform(10.0, 495.0, rng.integers(2, 9)))
    excited = rng.permutation(5)[: rng.integers(1, 4)]
    time_s = np.arange(900) / 300.0
    shapes = clamped_free_shapes(positions_mm)
    values = 0.005 * rng.standard_normal((time_s.size, positions_mm.size))
    for rank, mode in enumerate(excited):
        hz = THEORY_HZ[mode] * rng.uniform(1.0 - error, 1.0 + error)
        motion = np.exp(pole_of(hz, 0.004) * time_s + 2j * np.pi * rng.random()).real
        values += 0.4**rank * motion[:, None] * shapes[:, mode] / np.abs(shapes[:, mode]).max()
    wanted = rng.choice([*excited, *rng.permutation(5)[:1], -1])
    settings = IdentifySettings(
        mode=None if wanted < 0 else int(wanted) + 1,
        onset_s=0.0,
        expected_frequencies_hz=THEORY_HZ,
        expected_shapes=shapes,
        reversed_shapes=clamped_free_shapes(500.0 - positions_mm),
        sampler=QUICK,
    )
    return identify(series_of(time_s, values, positions_mm=positions_mm), settings)


@pytest.mark.parametrize("seeds", [range(3), pytest.param(range(3, 150), marks=pytest.mark.slow)])
def test_a_right_rate_is_not_blamed(seeds):
    """Theory within 5 % of the measured frequencies, the distance at which the paper's beam is."""
    found = {seed: random_identification(seed, 0.05) for seed in seeds}
    blamed = {seed: str(one.fitting_rate) for seed, one in found.items() if one and one.fitting_rate}
    assert not blamed
    assert sum(bool(one) for one in found.values()) > 0.9 * len(found), "too few identifications to judge by"

import numpy as np
import pytest

from sim.ancf import AncfBeam
from sim.modes import beam_modes
from sim.paper_beam import MEASURED_FREQUENCY_HZ, paper_beam, sample_beam
from sim.updating import _Problem, update_properties

MEASURED = np.array(MEASURED_FREQUENCY_HZ)
NUMBERS = np.arange(1, 6)


def test_the_papers_frequencies_are_reached_with_gravity_within_the_bound():
    updated = update_properties(paper_beam(), MEASURED, 1e-5 * MEASURED, NUMBERS)
    np.testing.assert_allclose(updated.updated_hz, MEASURED, rtol=1e-4)
    recomputed = beam_modes(AncfBeam(updated.properties), 5).frequency_hz
    np.testing.assert_allclose(recomputed, updated.updated_hz, rtol=1e-12)
    np.testing.assert_allclose(updated.standard_hz, [1.8761, 10.5786, 29.2592, 57.1467, 94.339], atol=3e-4)
    for factor in (
        updated.width_factor,
        updated.thickness_factor,
        updated.density_factor,
        updated.elastic_modulus_factor,
    ):
        assert np.all(np.abs(np.asarray(factor) - 1.0) <= 0.1 + 1e-12)
    assert "under-determined" in updated.notes[0]


def test_uniform_thickness_fails_even_with_gravity():
    updated = update_properties(paper_beam(), MEASURED, 1e-5 * MEASURED, NUMBERS)
    error = updated.uniform_hz / MEASURED - 1.0
    assert updated.uniform_thickness_factor == pytest.approx(0.94, abs=0.005)
    assert error.min() == pytest.approx(-0.032, abs=0.001)
    assert error.max() == pytest.approx(0.027, abs=0.001)


def test_a_mode_measured_alone_is_matched_and_the_rest_stays_near():
    updated = update_properties(paper_beam(), np.array([26.84]), np.array([np.nan]), np.array([3]))
    assert updated.updated_hz[0] == pytest.approx(26.84, rel=1e-4)
    # 8 % in frequency takes a few per cent of each property
    assert np.abs(updated.thickness_factor - 1.0).max() < 0.08


def test_a_beam_that_fits_is_left_as_it_is():
    own = beam_modes(AncfBeam(sample_beam()), 5).frequency_hz
    updated = update_properties(sample_beam(), own, 1e-5 * own, NUMBERS)
    np.testing.assert_allclose(updated.thickness_factor, 1.0, atol=1e-6)
    assert updated.at_bound == 0


def test_a_bound_too_small_is_told():
    updated = update_properties(paper_beam(), MEASURED, 1e-5 * MEASURED, NUMBERS, bound=0.01)
    assert updated.at_bound > 20
    assert np.abs(updated.updated_hz / MEASURED - 1.0).max() > 0.01
    assert "at their bound" in updated.notes[-1]


def test_sensitivities_are_those_of_the_eigenvalue_problem():
    problem = _Problem(sample_beam(), MEASURED, NUMBERS)
    p = np.ones(42)
    slopes = problem.relative_sensitivity(p)
    for j in (0, 19, 25, 39, 40, 41):
        ends = []
        for sign in (-1.0, 1.0):
            moved = p.copy()
            moved[j] += sign * 2e-3
            ends.append(problem.frequency_hz(moved) / MEASURED)
        # the eigensolver's round-off in mode 1, 4e-8, over the difference of 4e-3
        np.testing.assert_allclose(slopes[:, j], (ends[1] - ends[0]) / 4e-3, atol=2e-5)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((MEASURED, MEASURED[:4], NUMBERS), "one value a mode each"),
        ((np.array([0.0]), np.array([0.0]), np.array([1])), "finite and positive"),
        ((MEASURED[:2], MEASURED[:2], np.array([1, 1])), "each once"),
    ],
)
def test_measured_values_that_do_not_fit_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        update_properties(paper_beam(), *arguments)

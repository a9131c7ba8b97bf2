import numpy as np
import pytest

from sim.ancf import AncfBeam
from sim.modes import beam_modes
from sim.paper_beam import MEASURED_FREQUENCY_HZ, paper_beam, sample_beam
from sim.updating import MeasuredShape, update_properties
from sim.updating.smoothest import _Problem

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


POSITIONS_M = np.array([0.09, 0.19, 0.29, 0.39, 0.49])


def measured_shapes(modes):
    """Of any scale and sign, as recordings give them."""
    values = modes.transverse_at(POSITIONS_M) * np.array([1.0, -2.0, 0.1, -0.5, 3.0])
    return tuple(MeasuredShape(n, POSITIONS_M, values[:, n - 1], np.full(5, np.nan)) for n in range(1, 6))


def shape_error(properties, truth):
    modes = beam_modes(AncfBeam(properties), 5)
    wanted, found = truth.transverse_at(POSITIONS_M), modes.transverse_at(POSITIONS_M)
    scale = np.sum(wanted * found, axis=0) / np.sum(found**2, axis=0)
    return np.linalg.norm(wanted - scale * found, axis=0) / np.linalg.norm(wanted, axis=0)


def test_measured_shapes_bring_the_updated_shapes_nearer():
    truth = beam_modes(AncfBeam(sample_beam()), 5)
    arguments = (paper_beam(), truth.frequency_hz, 1e-5 * truth.frequency_hz, NUMBERS)
    without = update_properties(*arguments)
    with_shapes = update_properties(*arguments, shapes=measured_shapes(truth))
    np.testing.assert_allclose(with_shapes.updated_hz, truth.frequency_hz, rtol=2e-4)
    before, after = shape_error(without.properties, truth), shape_error(with_shapes.properties, truth)
    # the mass of 0.46 g that bends the true shapes is not among the variables
    assert np.all(after < 0.7 * before), f"{after} against {before} without shapes"


def test_slopes_of_shapes_are_those_of_differences():
    truth = beam_modes(AncfBeam(sample_beam()), 5)
    problem = _Problem(paper_beam(), MEASURED, NUMBERS, measured_shapes(truth))
    p, sd = np.ones(42), np.full(5, 1e-4)
    slopes = problem.misfit_slopes(p, sd)[5:]
    for j in (0, 25, 40):
        ends = []
        for sign in (-1.0, 1.0):
            moved = p.copy()
            moved[j] += sign * 1e-3
            ends.append(problem.misfit(moved, sd)[5:])
        exact = (ends[1] - ends[0]) / 2e-3
        # the change of shape is made of twenty modes
        assert np.abs(slopes[:, j] - exact).max() < 0.1 * np.abs(exact).max()


def test_a_shape_of_zeros_is_refused():
    with pytest.raises(ValueError, match="finite and not all zero"):
        MeasuredShape(1, POSITIONS_M, np.zeros(5), np.zeros(5))


def test_sensitivities_are_those_of_the_eigenvalue_problem():
    problem = _Problem(sample_beam(), MEASURED, NUMBERS)
    p = np.ones(42)
    slopes = problem.misfit_slopes(p, np.ones(5))
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

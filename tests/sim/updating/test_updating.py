"""Updating with the paper's variables, uniform updating, and the smallest sufficient change of the properties."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from sim import MEASURED_FREQUENCY_HZ, paper_beam, sample_beam
from sim.beam import AncfBeam, PointMass, beam_modes
from sim.updating import (
    BeamFamily,
    MeasuredModes,
    MeasuredShape,
    Misfit,
    fit_within,
    smallest_bound,
    update_like_paper,
    update_uniform,
)

FREQUENCY_HZ = np.array(MEASURED_FREQUENCY_HZ)
NUMBERS = np.arange(1, 6)
MEASURED = MeasuredModes(NUMBERS, FREQUENCY_HZ, 1e-5 * FREQUENCY_HZ)
# Table 3, computed for a density that differs from Table 1
STANDARD_HZ = np.array([1.67, 10.47, 29.32, 57.46, 94.97])
OPTIMUM_HZ = np.array([1.84, 10.18, 26.81, 53.15, 88.79])
HIDDEN_DENSITY = 7850.0


def test_variables_of_the_paper_reproduce_table_3():
    standard = replace(paper_beam(), density_kg_m3=HIDDEN_DENSITY)
    found = update_like_paper(standard, MeasuredModes(NUMBERS, OPTIMUM_HZ, 1e-5 * OPTIMUM_HZ))
    # two decimals: rounding error of 0.3 % for 1.67, 0.05 % for the others
    np.testing.assert_allclose(found.standard_hz, STANDARD_HZ, rtol=1e-3)
    np.testing.assert_allclose(found.updated_hz, OPTIMUM_HZ, rtol=1e-3)
    assert found.properties.orientation == "none"
    recomputed = beam_modes(AncfBeam(found.properties), 5).frequency_hz
    np.testing.assert_allclose(recomputed, found.updated_hz, rtol=1e-7)


def test_variables_of_the_paper_reach_the_measured_frequencies_at_their_bounds():
    found = update_like_paper(paper_beam(), MEASURED)
    np.testing.assert_allclose(found.updated_hz, FREQUENCY_HZ, rtol=1e-6)
    factors = np.concatenate(
        [found.width_factor, found.thickness_factor, [found.density_factor, found.elastic_modulus_factor]]
    )
    assert np.abs(factors - 1.0).max() <= 0.1 + 1e-12
    at = np.flatnonzero(np.abs(np.abs(factors - 1.0) - 0.1) < 1e-6)
    thick_root = {f"thickness of element {e} (+10 %)" for e in (2, 3, 4)}
    thin_end = {f"thickness of element {e} (-10 %)" for e in (15, 16, 17, 18)}
    assert set(found.at_bound) == thick_root | thin_end
    assert at.size == len(found.at_bound)


def test_an_error_of_the_frame_rate_is_common_to_all_frequencies():
    """Frequencies that are all wrong by one factor cost one sd of the rate; others cost what they do without it."""
    exact = MeasuredModes(NUMBERS, FREQUENCY_HZ, 1e-5 * FREQUENCY_HZ)
    standard = Misfit.of(paper_beam(), exact).frequency_hz(np.ones(42))
    rate_sd, own_sd = 1e-3, np.hypot(1e-5, 1e-4)

    def square(factors):
        measured = MeasuredModes(NUMBERS, standard * factors, 1e-5 * standard * factors, rate_sd=rate_sd)
        misfit = Misfit.of(paper_beam(), measured)
        # The error of the mesh, up to 1.6e-4 for mode 5 of 20 elements, is part of the root as well.
        return float(np.sum(misfit.at(np.zeros(42))[0] ** 2))

    assert square(np.full(5, np.exp(2.0 * rate_sd))) == pytest.approx(4.0, rel=0.01), "two sd of the rate"
    apart = np.exp(own_sd * np.array([1.0, -1.0, 0.0, 0.0, 0.0]))
    assert square(apart) == pytest.approx(2.0, rel=0.01), "two modes, one sd of their own each, mean zero"


def test_other_starting_points_fit_equally_well_with_other_properties():
    """42 variables, five frequencies: results from random starts differ by a few percent per variable."""
    spread = update_like_paper(paper_beam(), MEASURED).start_spread
    assert 0.02 < np.sqrt(np.mean(spread**2)) < 0.06, "uniform starts within 10 % scatter by 5.8 %"


@pytest.mark.parametrize(("orientation", "expected"), [("hanging", 0.0484), ("none", 0.0781)])
def test_smallest_bound_that_reaches_the_measured_frequencies(orientation, expected):
    """Numerical searches found 5.0 and 7.8 %."""
    misfit = Misfit.of(paper_beam(orientation), MEASURED)
    bound, factor = smallest_bound(misfit)
    assert bound == pytest.approx(expected, abs=1e-4)
    np.testing.assert_allclose(misfit.frequency_hz(factor), FREQUENCY_HZ, rtol=1e-7)
    assert np.abs(factor - 1.0).max() <= bound + 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("orientation", ["hanging", "none"])
def test_least_squares_reach_the_frequencies_only_above_the_smallest_bound(orientation):
    misfit = Misfit.of(paper_beam(orientation), MEASURED)
    bound, _ = smallest_bound(misfit)
    for share, reached in ((0.99, False), (1.01, True)):
        factor = fit_within(misfit, np.ones(42), share * bound)
        error = np.abs(misfit.frequency_hz(factor) / FREQUENCY_HZ - 1.0).max()
        assert (error < 1e-5) == reached, f"error {error:.1e} at {share} of the smallest bound {bound}"


def test_uniform_properties_fail_even_with_gravity():
    found = update_uniform(paper_beam(), MEASURED)
    error = found.updated_hz / FREQUENCY_HZ - 1.0
    assert found.thickness_factor == pytest.approx(0.94, abs=0.003)
    # reference values for a factor of 0.94, within 0.002 of the optimum
    assert error.min() == pytest.approx(-0.032, abs=0.002)
    assert error.max() == pytest.approx(0.027, abs=0.002)
    np.testing.assert_allclose(found.standard_hz, [1.8761, 10.5786, 29.2592, 57.1467, 94.339], atol=3e-4)


def test_uniform_beam_frequencies_determine_one_combination():
    """Euler-Bernoulli beam with weight: only E I / (rho A), i.e. E h^2 / rho, for any width."""
    found = update_uniform(paper_beam(), MEASURED)
    assert found.known == 1
    # the axial strain due to weight depends on rho / E: 3e-8 of the frequency
    np.testing.assert_allclose(
        found.combinations[0], np.array([0.0, 2.0, -1.0, 1.0]) / np.sqrt(6.0), atol=1e-5
    )
    assert found.combination_sd[1] > 1e3


def test_taper_and_point_mass_fit_within_a_quarter_of_a_percent():
    """Least squares, four variables for five frequencies: thickness at clamp and tip, position and size of the mass."""
    middle = (np.arange(20) + 0.5) / 20

    def deviation(numbers):
        clamp, tip, position_m, mass_g = numbers
        beam = replace(paper_beam(), point_masses=(PointMass(position_m, 1e-3 * mass_g),))
        taper = np.zeros(42)
        taper[20:40] = np.log(clamp + (tip - clamp) * middle)
        return np.log(BeamFamily(beam, 5).modes(taper).frequency_hz[0] / FREQUENCY_HZ)

    found = least_squares(deviation, [1.0, 0.9, 0.36, 0.4], x_scale=[0.1, 0.1, 0.1, 1.0])
    assert np.sqrt(np.mean(found.fun**2)) == pytest.approx(0.0026, abs=5e-5)
    assert found.x[3] == pytest.approx(0.41, abs=0.02)
    # the smallest possible maximum is 0.32 %; least squares does not minimise the maximum
    assert 0.0032 < np.abs(found.fun).max() < 0.0045


def test_added_masses_determine_the_mass_of_the_beam():
    beam = sample_beam()
    frequency_hz = beam_modes(AncfBeam(beam), 5).frequency_hz
    found = update_uniform(beam, MeasuredModes(NUMBERS, frequency_hz, 1e-5 * frequency_hz))
    assert found.known == 2
    assert found.thickness_factor == pytest.approx(1.0, abs=1e-5)


def test_a_matching_beam_is_not_changed():
    beam = replace(sample_beam(), orientation="none")
    own = beam_modes(AncfBeam(beam), 5).frequency_hz
    found = update_like_paper(beam, MeasuredModes(NUMBERS, own, 1e-5 * own))
    np.testing.assert_allclose(found.thickness_factor, 1.0, atol=1e-6)
    assert found.at_bound == ()


def test_too_small_a_bound_is_reported():
    found = update_like_paper(paper_beam(), MEASURED, bound=0.01)
    assert len(found.at_bound) > 20
    assert np.abs(found.updated_hz / FREQUENCY_HZ - 1.0).max() > 0.01
    assert found.smallest_bound > 0.01


def test_more_precise_measurements_give_the_same_result():
    """Relative sd from 1e-4 to 1e-8: the result converges to the exact fit."""
    answers = []
    for sd in (1e-4, 1e-6, 1e-8):
        sharp = MeasuredModes(NUMBERS, FREQUENCY_HZ, sd * FREQUENCY_HZ, model_sd=1e-9)
        found = update_like_paper(paper_beam(elements=10), sharp)
        np.testing.assert_allclose(found.updated_hz, FREQUENCY_HZ, rtol=1e-6)
        answers.append(found.thickness_factor)
    np.testing.assert_allclose(answers[1], answers[0], atol=1e-4)
    np.testing.assert_allclose(answers[2], answers[0], atol=1e-4)


POSITIONS_M = np.array([0.09, 0.19, 0.29, 0.39, 0.49])


def measured_with_shapes(modes):
    """Measured modes with shapes of arbitrary scale and sign, as from recordings."""
    values = modes.transverse_at(POSITIONS_M) * np.array([1.0, -2.0, 0.1, -0.5, 3.0])
    shapes = tuple(MeasuredShape(n, POSITIONS_M, values[:, n - 1], np.full(5, np.nan)) for n in NUMBERS)
    return MeasuredModes(NUMBERS, modes.frequency_hz, 1e-5 * modes.frequency_hz, shapes)


def shape_error(properties, truth):
    modes = beam_modes(AncfBeam(properties), 5)
    wanted, found = truth.transverse_at(POSITIONS_M), modes.transverse_at(POSITIONS_M)
    scale = np.sum(wanted * found, axis=0) / np.sum(found**2, axis=0)
    return np.linalg.norm(wanted - scale * found, axis=0) / np.linalg.norm(wanted, axis=0)


def test_measured_shapes_improve_the_updated_shapes():
    # a beam within the range of the variables: all factors deviate by less than 10 %
    along = np.linspace(-1.0, 1.0, 8)
    standard = paper_beam("none", elements=8)
    truth = beam_modes(
        AncfBeam(standard.scaled(width=1.0 + 0.05 * along**2, thickness=0.95 - 0.04 * along**3)), 5
    )
    measured = measured_with_shapes(truth)
    without = update_like_paper(standard, replace(measured, shapes=()))
    with_shapes = update_like_paper(standard, measured)
    np.testing.assert_allclose(with_shapes.updated_hz, truth.frequency_hz, rtol=2e-4)
    before, after = shape_error(without.properties, truth), shape_error(with_shapes.properties, truth)
    assert np.all(after < 0.2 * before), f"{after} with shapes, {before} without"


def test_zero_shape_is_refused():
    with pytest.raises(ValueError, match="finite and not all zero"):
        MeasuredShape(1, POSITIONS_M, np.zeros(5), np.zeros(5))


def test_invalid_bounds_are_refused():
    with pytest.raises(ValueError, match=r"positive and at most 0\.5"):
        update_like_paper(paper_beam(), MEASURED, bound=0.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((NUMBERS, FREQUENCY_HZ, FREQUENCY_HZ[:4]), "one value per mode each"),
        ((np.array([1]), np.array([0.0]), np.array([0.0])), "finite and positive"),
        ((np.array([1, 1]), FREQUENCY_HZ[:2], FREQUENCY_HZ[:2]), "each once"),
        ((NUMBERS, FREQUENCY_HZ, FREQUENCY_HZ, (), 0.0), "model_sd"),
    ],
)
def test_inconsistent_measured_values_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        MeasuredModes(*arguments)

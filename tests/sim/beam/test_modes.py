from dataclasses import replace

import mpmath
import numpy as np
import pytest
from scipy.optimize import root
from support.exact_modes import exact_frequencies_hz

from docs.reference_solutions import euler_bernoulli_hz, rayleigh_ritz_hz
from sim import MEASURED_FREQUENCY_HZ, paper_beam, sample_beam, tapered_beam
from sim.beam import (
    AncfBeam,
    BuckledBeamError,
    ElasticClamp,
    PointMass,
    beam_modes,
    from_band,
    static_equilibrium,
)


def frequencies(properties, count=5, **options):
    return beam_modes(AncfBeam(properties, **options), count).frequency_hz


def test_frequencies_without_gravity_match_euler_bernoulli():
    properties = paper_beam("none")
    theory = euler_bernoulli_hz(properties, 5)
    np.testing.assert_allclose(theory, [1.6553, 10.3735, 29.0462, 56.9190, 94.0912], atol=6e-5)
    error = frequencies(properties) / theory - 1.0
    assert np.abs(error).max() < 2e-4, (
        f"with 20 cubic elements, mode 5 is 1.7e-4 too high, (beta h)^4 / 720; got {error}"
    )


@pytest.mark.parametrize("elements", [10, 20, 40])
@pytest.mark.parametrize(
    "beam", [lambda ne: paper_beam("hanging", ne), sample_beam], ids=["uniform", "sample"]
)
def test_frequencies_agree_with_fifty_digits(beam, elements):
    found = frequencies(beam(elements))
    error = [
        float(mpmath.mpf(float(f)) / exact - 1)
        for f, exact in zip(found, exact_frequencies_hz(beam(elements), found), strict=True)
    ]
    # a curvature is a difference of nodal values over (L / ne)^2: an error of ne^2 2^-53 of it, 2e-13 for 40
    assert np.abs(error).max() < 1e-12, f"on every processor, rounding leaves ne^2 2^-53; got {error}"


@pytest.mark.parametrize(
    "properties",
    [
        paper_beam(),
        sample_beam(),
        paper_beam("horizontal"),
        replace(sample_beam(), clamp=ElasticClamp(0.3)),
        replace(paper_beam("horizontal"), ends=("pinned", "clamped"), tension_n=5.0),
    ],
    ids=["straight", "sample", "sagging", "elastic clamp", "tension"],
)
def test_the_energy_of_a_motion_is_that_of_the_tangent(properties):
    beam = AncfBeam(properties)
    q = static_equilibrium(beam)
    v = np.random.default_rng(3).normal(size=(4, beam.ndof)) / beam.dof_scale
    v[:, beam.fixed] = 0.0
    padded = [np.pad(x, [(0, 0)] * (x.ndim - 1) + [(beam.held, 0)]) for x in (q, v)]
    expected = np.einsum("fi,ij,fj->f", v, from_band(beam.elastic(q).tangent), v)
    # random motion stretches the axis, so that the matrix loses nothing
    np.testing.assert_allclose(beam.second_variation(*padded), expected, rtol=1e-12)


def test_frequencies_converge_with_the_fourth_power_of_the_element_length():
    theory = euler_bernoulli_hz(paper_beam("none"), 5)
    errors = np.array([frequencies(paper_beam("none", ne)) / theory - 1.0 for ne in (12, 24)])
    order = np.log2(errors[0] / errors[1])
    assert np.all((order > 3.7) & (order < 4.3)), f"Hermite cubics converge with order 4; observed {order}"


def test_hanging_and_standing_frequencies_agree_with_rayleigh_ritz():
    hanging, standing = frequencies(paper_beam("hanging")), frequencies(paper_beam("standing"))
    np.testing.assert_allclose(hanging, [1.8761, 10.5786, 29.2592, 57.1467, 94.339], atol=3e-4)
    assert standing[0] == pytest.approx(1.3994, rel=1e-4)
    # 20 elements are up to 1.7e-4 too stiff at mode 5; polynomials of degree 19 are exact
    np.testing.assert_allclose(
        hanging, rayleigh_ritz_hz(paper_beam("hanging"), 5, tension_sign=1.0), rtol=2e-4
    )
    np.testing.assert_allclose(
        standing, rayleigh_ritz_hz(paper_beam("standing"), 5, tension_sign=-1.0), rtol=2e-4
    )


def test_standard_column_of_the_paper_is_theory_for_density_7850():
    """Standard column of Table 3: Euler-Bernoulli without gravity, density 7850 instead of the printed 8000."""
    theory = euler_bernoulli_hz(replace(paper_beam("none"), density_kg_m3=7850.0), 5)
    # printed with two decimals
    np.testing.assert_allclose(theory, [1.67, 10.47, 29.32, 57.46, 94.97], atol=0.02)


def test_modes_are_mass_normalised_with_positive_tip_displacement():
    beam = AncfBeam(sample_beam())
    modes = beam_modes(beam, 8)
    np.testing.assert_allclose(modes.phi.T @ beam.mass_matrix() @ modes.phi, np.eye(8), atol=1e-9)
    assert np.all(modes.transverse_at(np.array([0.5]))[0] > 0.0)
    nodes = [
        np.count_nonzero(np.diff(np.sign(shape)))
        for shape in modes.transverse_at(np.linspace(0.02, 0.5, 97)).T
    ]
    assert nodes == list(range(8)), "mode n of a cantilever has n - 1 nodes"


def test_axial_modes_are_excluded():
    properties = paper_beam("none")
    speed = np.sqrt(properties.elastic_modulus_pa / properties.density_kg_m3)
    axial = speed / (4.0 * properties.length_m)
    modes = beam_modes(AncfBeam(properties), 35)
    assert modes.frequency_hz[-1] > axial
    share = np.linalg.norm(modes.phi[0::2], axis=0) / np.linalg.norm(modes.phi, axis=0)
    assert share.max() < 1e-6, "modes of a straight beam are transverse"


def test_tip_mass_lowers_the_first_frequency_by_rayleighs_quotient():
    properties = paper_beam("none")
    shape = beam_modes(AncfBeam(properties), 1)
    mass = 1e-5
    loaded = frequencies(replace(properties, point_masses=(PointMass(0.5, mass),)), 1)[0]
    predicted = shape.frequency_hz[0] / np.sqrt(1.0 + mass * shape.transverse_at(np.array([0.5]))[0, 0] ** 2)
    # second order in the mass ratio (2e-3)
    assert loaded == pytest.approx(predicted, rel=1e-6)


def test_horizontal_beam_sags_and_has_bending_modes():
    beam = AncfBeam(paper_beam("horizontal"))
    q = static_equilibrium(beam)
    x, y, angle = beam.points(np.array([0.5]), q)
    assert y[0] < -0.08
    assert 0.4 < x[0] < 0.5
    assert angle[0] < 0.0
    assert np.all(np.diff(beam_modes(beam, 5).frequency_hz) > 0.0)


def test_buckled_standing_beam_is_an_error():
    tall = replace(paper_beam("standing"), length_m=0.8)
    with pytest.raises(BuckledBeamError, match=r"buckles under its own weight.*9\.1.*7\.837"):
        beam_modes(AncfBeam(tall), 5)


def test_buckling_limit_of_a_standing_beam_is_greenhills():
    properties = paper_beam("standing")
    load = properties.mass_kg * 9.80665 / (210e9 * properties.second_moment_m4[0])
    # at constant weight per length q, q L^3 is proportional to the cube of the length
    limit = (7.83735 / (load / 0.5)) ** (1.0 / 3.0)
    below_limit = replace(properties, length_m=0.999 * limit)
    above_limit = replace(properties, length_m=1.001 * limit)
    assert frequencies(below_limit, 1)[0] < 0.1
    with pytest.raises(BuckledBeamError):
        frequencies(above_limit, 1)


def test_sample_beam_has_the_measured_frequencies_of_the_paper():
    error = frequencies(sample_beam()) / np.array(MEASURED_FREQUENCY_HZ) - 1.0
    assert np.abs(error).max() < 1e-7, f"Table 2 within the eleven digits of the properties, got {error}"


def test_sample_beam_is_the_result_of_a_search():
    scale = np.array([1e-3, 1e-3, 1e-3, 1.0, 1e-3])

    def deviation(point):
        return frequencies(tapered_beam(point * scale, 20)) / np.array(MEASURED_FREQUENCY_HZ) - 1.0

    reached = root(deviation, [0.515, 0.450, 0.0, 0.359, 0.46], options={"eps": 1e-8, "xtol": 1e-13})
    assert np.max(np.abs(reached.fun)) < 1e-7, "the frequencies of Table 2"
    found, fixed = tapered_beam(reached.x * scale, 20), sample_beam()
    # a relative change of 1e-7 in a frequency corresponds to at most about 1e-5 in a property
    np.testing.assert_allclose(found.thickness_m, fixed.thickness_m, rtol=1e-5)
    assert found.point_masses[0].position_m == pytest.approx(fixed.point_masses[0].position_m, rel=1e-5)
    assert found.point_masses[0].mass_kg == pytest.approx(fixed.point_masses[0].mass_kg, rel=1e-5)


def test_too_many_modes_are_refused():
    with pytest.raises(ValueError, match="1 to 40 bending modes, 41 were requested"):
        beam_modes(AncfBeam(paper_beam()), 41)

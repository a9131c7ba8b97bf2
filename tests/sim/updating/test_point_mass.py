"""An unknown point mass: exact sensitivities, and the truth within the region of its place and size."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom
from support.beams import assert_exact_sensitivities

from sim import paper_beam, sample_beam
from sim.beam import AncfBeam, PointMass, beam_modes
from sim.updating import (
    BeamFamily,
    MeasuredModes,
    MeasuredShape,
    PointMassPosterior,
    SmoothPrior,
    UpdatingSettings,
    chosen_methods,
    find_point_mass,
    update_by,
)

PLACE_M, MASS_KG, SD = 0.355, 0.41e-3, 1e-4
# one factor each on width, thickness, density and modulus, with a standard deviation of 5 %
UNIFORM = SmoothPrior(0.05, np.inf)


def measured(beam, rng, modes=5, at_m=None):
    """Frequencies and shapes with errors of the usual size, that of the model included."""
    exact, shapes = beam_modes(AncfBeam(beam), modes), ()
    seen = exact.frequency_hz * (1.0 + SD * rng.standard_normal(modes))
    if at_m is not None:
        rows = exact.transverse_at(at_m).T
        rows += 0.01 * np.abs(rows).max(axis=1, keepdims=True) * rng.standard_normal(rows.shape)
        shapes = tuple(MeasuredShape(n, at_m, row, np.zeros(at_m.size)) for n, row in enumerate(rows, 1))
    return MeasuredModes(np.arange(1, modes + 1), seen, np.zeros(modes), shapes, model_sd=SD)


@pytest.mark.parametrize("orientation", ["hanging", "horizontal"])
def test_masses_have_exact_sensitivities(orientation):
    bodies = (PointMass(0.2, 3e-4), PointMass(0.31, 5e-4, 2e-8), PointMass(0.5, 2e-4))
    beam = replace(paper_beam(orientation, 8), point_masses=bodies)
    family = BeamFamily(beam, 4, (), 2)
    u = np.zeros(family.variables)
    u[-2:] = [0.3, -0.4]
    scaled = family.properties(u)
    assert scaled.point_masses[0] == bodies[0]
    assert scaled.point_masses[1].rotary_inertia_kg_m2 == pytest.approx(np.exp(0.3) * 2e-8)
    assert_exact_sensitivities(family, u)


def search(seed, prior, elements, at_m=None):
    """The mass of the sample on a beam drawn from the prior, as it is found on the standard beam of 20 elements."""
    rng, basis = np.random.default_rng(seed), prior.basis(elements)
    drawn = BeamFamily(paper_beam("hanging", elements), 1).properties(
        basis @ rng.standard_normal(basis.shape[1])
    )
    beam = replace(drawn, point_masses=(PointMass(PLACE_M, MASS_KG),))
    return find_point_mass(paper_beam("hanging", 20), measured(beam, rng, at_m=at_m), prior=prior, seed=seed)


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_place_and_mass_are_found(seed):
    found = search(seed, UNIFORM, 60)
    assert found.credibility(PLACE_M, MASS_KG) < 0.9
    (region,) = found.regions()
    # a place moves the frequencies by up to 2 n pi / L of 4 % / 2: an sd of 1e-4 is 0.2 mm of mode 5, 0.7 mm of mode 1
    assert region.high_m - region.low_m < 5e-3
    assert region.mass_low_kg < MASS_KG < region.mass_high_kg, (
        "its mass relative to that of the beam is known"
    )
    assert found.credibility(PLACE_M, 3.0 * MASS_KG) > 0.99
    assert found.credibility(0.2, MASS_KG) > 0.99
    assert found.log_odds > 100.0


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["uniform", "smooth"])
def test_regions_contain_the_truth_as_often_as_they_say(kind):
    """A uniform beam by frequencies alone, and one whose section varies smoothly by the shapes at five markers, too."""
    markers_m = np.array([0.09, 0.19, 0.29, 0.39, 0.49])
    arguments = {"uniform": (UNIFORM, 60), "smooth": (SmoothPrior(), 20, markers_m)}[kind]
    inside = sum(search(seed, *arguments).credibility(PLACE_M, MASS_KG) < 0.9 for seed in range(10))
    assert inside >= binom.ppf(1e-3, 10, 0.9), f"{inside} of 10 within the 90 % region"


def test_frequencies_do_not_tell_the_ends_of_a_symmetric_beam_apart():
    beam = replace(paper_beam("none", 12), ends=("pinned", "pinned"))
    seen = measured(replace(beam, point_masses=(PointMass(0.15, 1e-3),)), np.random.default_rng(4), 4)
    found = find_point_mass(beam, seen, prior=UNIFORM)
    first, second = found.regions()
    assert first.low_m + second.high_m == pytest.approx(0.5, abs=2e-3)
    # mirrored cells have the same likelihood: only the draws of the prior differ
    assert first.probability == pytest.approx(second.probability, abs=0.02)
    assert found.credibility(0.35, 1e-3) == pytest.approx(found.credibility(0.15, 1e-3), abs=0.05)


def test_a_beam_without_a_mass_has_odds_against_one():
    beam = paper_beam("hanging", 12)
    settings = UpdatingSettings(point_mass=True, correlation_length=100.0)
    assert chosen_methods(settings)[0] == "point_mass"
    assert "point_mass" not in chosen_methods(UpdatingSettings())
    found = update_by("point_mass", beam, measured(beam, np.random.default_rng(5)), settings)
    assert isinstance(found, PointMassPosterior)
    assert found.log_odds < 0.0
    # at the clamp nothing is known of a mass; elsewhere 1e-4 of a frequency is 2e-4 of the mass
    place, mass = found.draws
    assert np.quantile(mass[place > 0.1], 0.9) < 5e-3 * beam.mass_kg


def test_a_smooth_section_and_a_mass_are_confused():
    """With a prior that allows every smooth section, five frequencies leave the place open."""
    found = find_point_mass(paper_beam("hanging", 10), measured(sample_beam(20), np.random.default_rng(6)))
    assert sum(region.high_m - region.low_m for region in found.regions()) > 0.02
    assert found.log_odds < 15.0

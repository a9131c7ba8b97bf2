"""The paper's tables recomputed, against theory and the printed values."""

import numpy as np
import pytest
from support.paper_runs import paper

from docs.reference_solutions import euler_bernoulli_hz, rayleigh_ritz_hz
from sim import reference as printed
from sim.beam import AncfBeam, beam_modes

STANDARD, OPTIMUM = np.array(printed.TABLE_3_STANDARD_HZ), np.array(printed.TABLE_3_OPTIMUM_HZ)


def test_the_standard_column_is_theory_without_gravity_at_7850_kg_m3():
    s = paper().standard
    assert np.abs(s.handbook_density_hz / STANDARD - 1.0).max() < 1e-3, "required: 0.1 % with 7850 kg/m3"
    assert np.all(np.abs(s.printed_density_hz / STANDARD - 1.0 + 0.0091) < 0.0004), "8000 kg/m3 is 0.9 % low"
    assert s.best_density_kg_m3 == pytest.approx(7850.0, rel=1e-3)
    # With 20 elements, mode 5 is within 2e-4 of theory; the error with 18 polynomials is negligible.
    beam = printed.TABLE_1_STANDARD.beam("none")
    np.testing.assert_allclose(s.printed_density_hz, euler_bernoulli_hz(beam, 5), rtol=2e-4)
    np.testing.assert_allclose(s.hanging_hz, rayleigh_ritz_hz(beam, 5, tension_sign=1.0), rtol=2e-4)
    np.testing.assert_allclose(s.standing_hz, rayleigh_ritz_hz(beam, 5, tension_sign=-1.0), rtol=2e-4)


def test_the_optimum_column_is_reached_by_the_papers_variables_within_their_bound():
    reached = paper().optimum.reached
    found = beam_modes(AncfBeam(reached.properties), 5).frequency_hz
    assert np.abs(found / OPTIMUM - 1.0).max() < 1e-3, "required: 0.1 %"
    # Two assemblies of one beam: differences of round-off in curvatures.
    np.testing.assert_allclose(found, reached.updated_hz, rtol=1e-11)
    standard = printed.TABLE_1_STANDARD.beam("none")
    factors = np.concatenate(
        [
            reached.properties.width_m / standard.width_m,
            reached.properties.thickness_m / standard.thickness_m,
            [reached.properties.density_kg_m3 / standard.density_kg_m3],
            [reached.properties.elastic_modulus_pa / standard.elastic_modulus_pa],
        ]
    )
    assert factors.size == 42
    change = np.abs(factors - 1.0)
    assert change.max() <= 0.10 + 1e-9
    assert len(reached.at_bound) == np.count_nonzero(change > 0.10 - 1e-6) > 0
    # DESIGN: without gravity, each variable needs a change of about 7.8 %
    assert 0.07 < reached.smallest_bound < 0.08


def test_uniform_optimum_values_of_table_1_give_another_beam():
    o = paper().optimum
    np.testing.assert_allclose(o.uniform_hz, [1.593, 9.980, 27.946, 54.765, 90.540], atol=6e-4)
    np.testing.assert_allclose(o.uniform_hanging_hz, [1.821, 10.193, 28.167, 54.998, 90.781], atol=6e-4)
    assert "gravity" in o.to_test.evidence.models[0].name, "the test column favours the hanging beam"


def test_the_values_of_the_equations():
    e = paper().equations
    assert e.alpha_1_s == pytest.approx(0.2282, abs=5e-5)
    assert e.beta_s == pytest.approx(3.18e-5, abs=5e-8)
    np.testing.assert_allclose(100.0 * e.rayleigh_ratio, [1.0, 0.28, 0.336, 0.566, 0.906], atol=5e-4)
    # 80 modes in double precision over five decades of frequency
    assert e.eq6_right_error < 1e-9
    assert e.eq6_printed_error > 1.0
    assert abs(e.ratio_above) < 1e-12

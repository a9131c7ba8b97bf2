import numpy as np
import pytest

from sim import MEASURED_DAMPING_RATIO, MEASURED_FREQUENCY_HZ, paper_beam
from sim.beam import AncfBeam, beam_modes
from sim.damping import GenericDamping, NoDamping, RayleighDamping, WithAirDrag

OMEGA = 2.0 * np.pi * np.array(MEASURED_FREQUENCY_HZ)


@pytest.fixture(scope="module")
def modes():
    return beam_modes(AncfBeam(paper_beam()), 8)


def test_rayleigh_of_table_2_eq_4():
    model = RayleighDamping.from_modes(tuple(OMEGA[:2]), MEASURED_DAMPING_RATIO[:2])
    assert model.alpha_1_s == pytest.approx(0.2282, abs=5e-5)
    assert model.beta_s == pytest.approx(3.18e-5, abs=5e-9)
    ratio = model.damping_ratio(OMEGA)
    np.testing.assert_allclose(ratio[:2], MEASURED_DAMPING_RATIO[:2], rtol=1e-12)
    np.testing.assert_allclose(100 * ratio[2:], [0.336, 0.566, 0.906], atol=5e-4)


def test_air_drag_keeps_the_caution_of_its_model():
    model = RayleighDamping(1.0, -1e-5)
    assert "beta is negative" in WithAirDrag(model).caution
    assert WithAirDrag(RayleighDamping(1.0, 1e-5)).caution == ""


def test_rayleigh_needs_two_different_modes():
    with pytest.raises(ValueError, match="two different positive frequencies"):
        RayleighDamping.from_modes((10.0, 10.0), (0.01, 0.01))


def test_generic_keeps_measured_ratios_and_reports_the_residual(modes):
    given = GenericDamping(MEASURED_DAMPING_RATIO).coefficients(modes)
    np.testing.assert_array_equal(given.damping_ratio[:5], MEASURED_DAMPING_RATIO)
    assert given.damping_ratio[5] == pytest.approx(MEASURED_DAMPING_RATIO[-1])
    np.testing.assert_allclose(given.damping_ratio[5:] / modes.omega_rad_s[5:], 0.5 * given.stiffness_s)


def test_generic_without_residual_is_eq_6(modes):
    given = GenericDamping(MEASURED_DAMPING_RATIO, residual_ratio=0.0).coefficients(modes)
    assert given.stiffness_s == 0.0
    np.testing.assert_array_equal(given.damping_ratio[5:], 0.0)


def test_generic_needs_a_mode_above_the_measured_ones(modes):
    with pytest.raises(ValueError, match="needs at least 6 modes of the beam, got 5"):
        GenericDamping(MEASURED_DAMPING_RATIO).coefficients(modes.first(5))


@pytest.mark.parametrize("ratios", [(), (0.01, -0.001), (1.0,), (float("nan"),)])
def test_invalid_ratios_are_refused(ratios):
    with pytest.raises(ValueError, match="between 0 and 1"):
        GenericDamping(ratios)


def test_no_damping_has_zero_ratios(modes):
    assert not NoDamping().coefficients(modes).damping_ratio.any()

"""Damping laws against closed forms, their evidence against other integrations, models and parts made of them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal, norm

from docs.reference_solutions import damping_and_frequency_error, small_decay
from modalcam.pipeline import damping_candidates
from sim import MEASURED_DAMPING_RATIO, MEASURED_FREQUENCY_HZ, paper_beam
from sim.beam import AncfBeam, beam_modes
from sim.damping import (
    DAMPING_MODELS,
    MATERIALS,
    MeasuredDamping,
    RayleighDamping,
    beam_section,
    compare_laws,
    skipped_damping_models,
    thermoelastic_ratio,
    viscous_air_ratio,
)
from sim.damping import law as law_module
from tracker import Failure

SECTION = beam_section(paper_beam(), "steel")
OMEGA = 2.0 * np.pi * np.array(MEASURED_FREQUENCY_HZ)
REFERENCE = float(np.exp(np.mean(np.log(OMEGA))))
LAWS = {key: entry.law for key, entry in DAMPING_MODELS.items() if entry.law is not None}
PAPER = MeasuredDamping(
    (1, 2, 3, 4, 5),
    MEASURED_FREQUENCY_HZ,
    MEASURED_DAMPING_RATIO,
    damping_sd=tuple(0.02 * zeta for zeta in MEASURED_DAMPING_RATIO),
    section=SECTION,
)


def first(measured, count):
    """The lowest measured modes."""
    fields = ("numbers", "frequency_hz", "damping_ratio", "damping_sd")
    return replace(measured, **{name: getattr(measured, name)[:count] for name in fields})


def test_thermoelastic_damping_agrees_with_the_exact_solution():
    """Lifshitz, Roukes, Eq. 25, in xi = h sqrt(omega rho c / 2 k) = pi sqrt(omega tau / 2); stated errors."""
    material = MATERIALS["steel"]
    heat = SECTION.density_kg_m3 * material.heat_capacity_j_kg_k
    tau = SECTION.thickness_m**2 * heat / (np.pi**2 * material.conductivity_w_m_k)
    phase = np.array([0.01, 0.1, 1.0, 5.0, 10.0, 100.0])
    xi = np.pi * np.sqrt(phase / 2.0)
    sinh, cosh = np.sinh(xi) + np.sin(xi), np.cosh(xi) + np.cos(xi)
    strength = SECTION.elastic_modulus_pa * material.expansion_1_k**2 * 293.15 / heat
    exact = 0.5 * strength * (6.0 / xi**2 - 6.0 / xi**3 * sinh / cosh)
    ratio = thermoelastic_ratio(phase / tau, SECTION) / exact
    np.testing.assert_allclose(ratio[:4], 1.0, atol=0.015, err_msg="up to omega tau = 5")
    np.testing.assert_allclose(ratio[4:], [0.95, 0.86], atol=0.005, err_msg="at omega tau = 10 and 100")


def test_viscous_air_damping_agrees_with_another_fit():
    """Maali et al., J. Appl. Phys. 97 (2005) 074907, made for Re of 1 to 30: Gamma in powers of the viscous depth."""
    reynolds = np.array([0.5, 2.0, 8.0, 30.0])
    omega = 4.0 * reynolds * SECTION.air_viscosity_pa_s / (1.204 * SECTION.width_m**2)
    depth = np.sqrt(2.0 * SECTION.air_viscosity_pa_s / (1.204 * omega)) / SECTION.width_m
    share = 0.25 * np.pi * 1.204 * SECTION.width_m / (SECTION.density_kg_m3 * SECTION.thickness_m)
    expected = 0.5 * share * (3.8018 * depth + 2.7364 * depth**2) / (1.0 + share * (1.0553 + 3.7997 * depth))
    # the other fit states 1 to 2 % for itself
    np.testing.assert_allclose(viscous_air_ratio(omega, SECTION), expected, rtol=0.02)


def test_the_evidence_of_a_constant_law_is_that_of_a_normal_distribution():
    """Given the scatter, ln zeta is normal with a covariance of the level, the scatter and the errors."""
    y = np.log(MEASURED_DAMPING_RATIO)
    scatters = 0.01 ** (1.0 - (np.arange(16) + 0.5) / 16)

    def log_density(used):
        covariances = [
            4.0 + np.diag(np.array(PAPER.damping_sd) ** 2 / np.exp(2.0 * y) + s**2) for s in scatters
        ]
        values = [
            multivariate_normal(np.full(y.size, np.log(0.003))[used], c[np.ix_(used, used)]).logpdf(y[used])
            for c in covariances
        ]
        return logsumexp(values) - np.log(16)

    fit, everything = LAWS["constant"].fit(PAPER), np.arange(5)
    # the same sum in another order: rounding of terms up to 1e4
    assert fit.log_evidence == pytest.approx(log_density(everything), abs=1e-9)
    for at, one in enumerate(fit.left_out):
        expected = fit.log_evidence - log_density(np.delete(everything, at))
        assert one.log_density == pytest.approx(expected, abs=1e-9)


def test_the_evidence_of_rayleigh_damping_is_that_of_an_integral_over_both_levels(monkeypatch):
    """At a single scatter of 20 %, over both coefficients on a grid of another shape."""
    narrow = replace(law_module.TUNING, least_scatter=0.2, largest_scatter=0.2, scatters=1)
    monkeypatch.setattr(law_module, "TUNING", narrow)
    y = np.log(MEASURED_DAMPING_RATIO)
    sd = np.hypot(0.2, np.array(PAPER.damping_sd) / MEASURED_DAMPING_RATIO)
    mass, stiffness = np.meshgrid(*[np.arange(-20.0, -3.0, 0.02)] * 2, indexing="ij")
    curve = np.logaddexp(
        mass[..., None] + np.log(REFERENCE / OMEGA), stiffness[..., None] + np.log(OMEGA / REFERENCE)
    )
    log_density = norm.logpdf(y, curve, sd).sum(axis=-1)
    # of the sum and of the ratio; the levels have the same volume as (ln sum, ln ratio)
    log_density += norm.logpdf(np.logaddexp(mass, stiffness), np.log(0.003), 2.0)
    log_density += norm.logpdf(stiffness - mass, 0.0, np.log(10.0))
    expected = logsumexp(log_density) + 2.0 * np.log(0.02)
    # the prior beyond four standard deviations of the ratio, 6e-5, and beyond the grid
    assert LAWS["rayleigh_all_modes"].log_evidence(PAPER) == pytest.approx(expected, abs=1e-3)


def test_caughey_passes_through_all_modes_and_two_of_them_are_rayleigh():
    law = LAWS["caughey"]
    np.testing.assert_allclose(law.damping_ratio(PAPER, OMEGA), MEASURED_DAMPING_RATIO, rtol=1e-12)
    two = first(PAPER, 2)
    rayleigh = RayleighDamping.from_modes(tuple(OMEGA[:2]), MEASURED_DAMPING_RATIO[:2])
    np.testing.assert_allclose(law.damping_ratio(two, OMEGA), rayleigh.damping_ratio(OMEGA), rtol=1e-12)
    # mode 5 by the series through the others, whose coefficients solve 2 zeta omega = sum a_j omega^2j
    at = OMEGA[:4, np.newaxis] ** (2 * np.arange(4)) / (2.0 * OMEGA[:4, np.newaxis])
    coefficients = np.linalg.solve(at, MEASURED_DAMPING_RATIO[:4])
    expected = coefficients @ OMEGA[4] ** (2 * np.arange(4)) / (2.0 * OMEGA[4])
    # the matrix has a condition of 1e9
    assert law.fit(PAPER).left_out[4].damping_ratio == pytest.approx(expected, rel=1e-6)


def test_a_caughey_series_that_is_negative_between_modes_says_so():
    gap = MeasuredDamping((1, 3, 4), (1.85, 26.84, 53.2), (0.001, 0.001, 0.05))
    model = DAMPING_MODELS["caughey"].build(gap, OMEGA[:4])
    # 2 zeta omega at mode 2, by weights of 0.829, 0.181 and -0.0104
    assert model.damping_ratio[1] < 0.0
    assert "adds energy" in model.caution
    assert not DAMPING_MODELS["caughey"].build(PAPER, OMEGA).caution


def test_a_damping_ratio_of_0_has_no_law_but_generic_damping():
    hz = tuple((f, f) for f in MEASURED_FREQUENCY_HZ)
    zero = tuple((z, 0.0 if z > 0.009 else z) for z in MEASURED_DAMPING_RATIO)
    drawn = replace(PAPER, frequency_draws_hz=hz, damping_draws=zero)
    found = damping_candidates(("generic", "rayleigh_all_modes", "caughey"), paper_beam(), drawn)
    assert [len(candidate.draws) for candidate in found.values()] == [2, 1, 1]
    (none,) = (d for d in drawn.draws() if d.damping_ratio[0] == 0.0)
    assert skipped_damping_models(("caughey",), none) == (
        "Caughey damping needs positive damping ratios: not simulated.",
    )


@pytest.mark.parametrize("key", ["caughey", "mass_and_constant"])
def test_a_law_is_simulated_with_its_damping_ratios(key):
    """Mode 2 over 2 s of small vibration, by least squares at the pole: the integrator is exact for modal ratios."""
    beam = AncfBeam(paper_beam())
    modes = beam_modes(beam, 6)
    model = DAMPING_MODELS[key].build(PAPER, modes.omega_rad_s[:5])
    ratio = float(model.coefficients(modes).damping_ratio[1])
    run = small_decay(beam, modes, model, 2, 1e-3)
    error = damping_and_frequency_error(run, modes.omega_rad_s[1], ratio)[0]
    # 5e-7 with generic damping and half the step (docs/studies/verification.md)
    assert abs(error) < 1e-5, f"relative error of the simulated damping ratio {error:.1e}"


def test_laws_without_what_they_need_are_left_out_with_the_reason():
    bare = replace(PAPER, section=replace(SECTION, material=None))
    found = compare_laws(bare)
    assert found.notes == ("Damping laws that need [beam] material were left out.",)
    assert "thermoelastic" not in found.keys
    assert "viscous_air" in found.keys
    assert skipped_damping_models(("generic", "thermoelastic"), bare) == (
        "Thermoelastic damping needs [beam] material: not simulated.",
    )
    assert list(damping_candidates(("generic", "thermoelastic"), paper_beam(), bare)) == ["generic"]
    without = compare_laws(replace(PAPER, section=None))
    assert {"mass", "constant", "caughey"} <= set(without.keys)
    assert not any("air" in key or "thermo" in key for key in without.keys)
    assert np.isnan(without.parts.value[1:3]).all()
    np.testing.assert_array_equal(without.parts.value[3], MEASURED_DAMPING_RATIO)


@pytest.mark.parametrize(
    "measured",
    [first(PAPER, 2), replace(PAPER, damping_ratio=(0.01, 0.0, 0.003, 0.002, 0.003))],
    ids=["two modes", "a ratio of 0"],
)
def test_too_little_to_compare_is_a_failure(measured):
    found = compare_laws(measured)
    assert isinstance(found, Failure)
    assert "at least 3 modes with positive damping ratios" in found.reason


def test_parts_add_up_and_their_sd_is_that_of_drawn_properties():
    parts = compare_laws(PAPER).parts
    np.testing.assert_allclose(parts.value[1:].sum(axis=0), MEASURED_DAMPING_RATIO, rtol=1e-12)
    rng, material = np.random.default_rng(6), MATERIALS["steel"]
    drawn_ratios = []
    for a, k, c, h in 1.0 + rng.standard_normal((2000, 4)) * [*material.relative_sd, 0.02]:
        changed = replace(
            material,
            expansion_1_k=a * material.expansion_1_k,
            conductivity_w_m_k=k * material.conductivity_w_m_k,
            heat_capacity_j_kg_k=c * material.heat_capacity_j_kg_k,
        )
        section = replace(SECTION, material=changed, thickness_m=h * SECTION.thickness_m)
        drawn_ratios.append(thermoelastic_ratio(OMEGA, section))
    # 2000 draws give a sd within 1.6 % (one sigma); second-order terms of sd of 10 % add a few per cent
    np.testing.assert_allclose(parts.sd[1], np.std(drawn_ratios, axis=0), rtol=0.08)
    expected = np.sqrt(np.array(PAPER.damping_sd) ** 2 + parts.sd[1] ** 2 + parts.sd[2] ** 2)
    np.testing.assert_allclose(parts.sd[3], expected, rtol=1e-12)

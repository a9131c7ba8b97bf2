"""The equations against layered sections, an exact Timoshenko beam and Saint-Venant torsion."""

import numpy as np
import pytest
from kit.bars import CLAMPED_ROOTS, bending_stiffness, free_timoshenko, sandwich_stiffness, torsion_constant

from modalcam.apps.material import (
    bar_modulus,
    clamped_coefficient,
    flexural_correction,
    free_bar,
    modified_oberst_layer,
    oberst_layer,
    sandwich_core,
    torsional_correction,
)

E, H = 70e9, 2e-3
LAYERS = [(0.1, 0.1), (0.5, 0.5), (1.0, 1.5), (3.0, 0.3)]


@pytest.mark.parametrize("number", [1, 2, 3, 4, 5])
def test_a_clamped_bar_has_its_modulus(number):
    length, density = 0.3, 2700.0
    inertia, area = H**3 / 12.0, H
    omega = (CLAMPED_ROOTS[number - 1] / length) ** 2 * np.sqrt(E * inertia / (density * area))
    found = bar_modulus(omega / (2.0 * np.pi), number, length_m=length, thickness_m=H, density_kg_m3=density)
    # C_n is printed with five digits: twice half a unit of the last one, at most that of 19.242.
    assert found == pytest.approx(E, rel=2.0 * 0.0005 / 19.242)


def composite(layers, density_ratio_total):
    """Squared frequency ratio and loss factor of a section over those of the bar alone, which is E H^3 / 12."""
    stiffness = bending_stiffness(layers) / (E * H**3 / 12.0)
    return stiffness.real / density_ratio_total, stiffness.imag / stiffness.real


@pytest.mark.parametrize(("thickness_ratio", "loss_factor"), LAYERS)
@pytest.mark.parametrize("modulus_ratio", [1e-3, 0.05, 2.0])
@pytest.mark.parametrize("sides", [1, 2])
def test_a_layer_there_and_back(thickness_ratio, loss_factor, modulus_ratio, sides):
    t, d = thickness_ratio, 0.4
    layer = E * modulus_ratio * (1.0 + 1j * loss_factor)
    sections = {1: [(E, H), (layer, t * H)], 2: [(layer, t * H), (E, H), (layer, t * H)]}
    squared_ratio, eta = composite(sections[sides], 1.0 + sides * d * t)
    back = {1: oberst_layer, 2: modified_oberst_layer}[sides]
    found = back(squared_ratio * (1.0 + sides * d * t), eta, base_modulus_pa=E, thickness_ratio=t)
    assert abs(found / layer - 1.0) < 1e-6


def test_with_a_real_ratio_the_equation_of_the_layer_is_not_exact():
    """Why `oberst_layer` is complex: E1 with the real ratio, for a layer of 0.05 E and a loss factor of 0.5."""
    layer, t = 0.05 * E, 1.0
    a, _ = composite([(E, H), (layer * (1.0 + 0.5j), t * H)], 1.0)
    b = 4.0 + 6.0 * t + 4.0 * t**2
    real = E / (2.0 * t**3) * ((a - b) + np.sqrt((a - b) ** 2 - 4.0 * t**2 * (1.0 - a)))
    assert real > 1.01 * layer


@pytest.mark.parametrize(("thickness_ratio", "loss_factor"), LAYERS)
@pytest.mark.parametrize("shear_pa", [1e5, 1e7, 1e9])
def test_a_sandwich_there_and_back(thickness_ratio, loss_factor, shear_pa):
    t, length, number = thickness_ratio, 0.25, 2
    core = shear_pa * (1.0 + 1j * loss_factor)
    # The wave number of the rounded C_n, whose error belongs to the standard.
    wave_number = np.sqrt(2.0 * np.pi * clamped_coefficient(number)) / length
    stiffness = sandwich_stiffness(E, H, core, t * H, wave_number) / (E * H**3 / 12.0)
    # of which the real part is (fs / fn)^2 (2 + D T)
    found = sandwich_core(
        stiffness.real, stiffness.imag / stiffness.real, number,
        base_modulus_pa=E, thickness_ratio=t, length_m=length, thickness_m=H,
    )  # fmt: skip
    assert abs(found / core - 1.0) < 1e-6


@pytest.mark.parametrize(
    ("poisson_ratio", "slenderness", "within"),
    [(0.3, r, 5e-4) for r in (0.02, 0.05, 0.1, 0.2)]
    + [(mu, r, 1.6e-3) for mu in (0.2, 0.4) for r in (0.02, 0.05, 0.1)],
)
def test_the_flexural_correction_is_that_of_a_timoshenko_beam(poisson_ratio, slenderness, within):
    """The polynomial of Spinner, Reichard and Tefft has errors of these sizes, which its authors' fit leaves."""
    exact = 1.0 / free_timoshenko(slenderness, poisson_ratio)
    assert flexural_correction(slenderness, poisson_ratio) == pytest.approx(exact, rel=within)


@pytest.mark.parametrize("ratio", [1.0, 2.0, 5.0, 20.0])
def test_the_torsional_correction_of_a_long_bar_is_that_of_saint_venant(ratio):
    polar = ratio * (ratio**2 + 1.0) / 12.0
    exact = polar / torsion_constant(ratio, 1.0)
    # Its constants have four digits: 2.521 and 1.991 of 2.52099 and 1.99116.
    assert torsional_correction(ratio, 1.0, 1e9) == pytest.approx(exact, rel=1e-5)


def test_a_free_bar_has_its_moduli_and_poissons_ratio():
    e, mu, density = 210e9, 0.29, 7850.0
    length, width, thickness = 0.1, 0.02, 0.005
    euler = 4.7300407449**2 / (2.0 * np.pi * length**2) * np.sqrt(e * thickness**2 / (12.0 * density))
    bending = euler * np.sqrt(free_timoshenko(thickness / length, mu))
    polar = width * thickness * (width**2 + thickness**2) / 12.0
    g = e / (2.0 * (1.0 + mu))
    torsion = np.sqrt(g * torsion_constant(width, thickness) / (density * polar)) / (2.0 * length)
    sizes = {"length_m": length, "width_m": width, "thickness_m": thickness}
    mass = density * length * width * thickness
    found = free_bar(np.array([bending]), np.array([torsion]), mass_kg=mass, **sizes)
    # 0.9465 is 9e-5 high and T1 5e-4 off; R subtracts the warping of a short bar, which Saint-Venant's theory
    # lacks, here 0.060 (b/L)^1.5 (b/t - 1)^2 of R = 4.8, 1.0 %; mu = E/(2G) - 1 has both, times 1.29.
    assert found[0][0] == pytest.approx(e, rel=1e-3)
    assert found[1][0] == pytest.approx(g, rel=0.011)
    assert found[2][0] == pytest.approx(mu, abs=1.29 * 0.012)

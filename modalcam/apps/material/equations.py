"""Equations of ASTM E756 for clamped bars and of ASTM E1876 and ISO 12680-1 for free ones, in SI units.

All are element by element over arrays of one shape, so that draws pass through as they are; NaN gives NaN. No equation
knows gravity, added masses, air or a clamp that is not rigid. The loss factor of a mode is twice its damping ratio.
They are as the literature attributes them to the standards; tests verify each against theory that does not use it.

References
----------
ASTM E756-05(2017), Standard Test Method for Measuring Vibration-Damping Properties of Materials.
ASTM E1876 and ISO 12680-1, dynamic moduli by impulse excitation of vibration.
S. Spinner, T. W. Reichard, W. E. Tefft, J. Res. NBS 64A(2), 1960: the correction of the flexural frequency.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tracker import FloatArray

ComplexArray = NDArray[np.complex128]

# C_n of the clamped-free bar; from mode 6 on (pi/2)(n - 1/2)^2.
_CLAMPED = (0.55959, 3.5069, 9.8194, 19.242, 31.809)
# Each step leaves a few per cent of the error of Poisson's ratio, so that about ten suffice.
_MOST_STEPS = 100


def clamped_coefficient(number: int) -> float:
    """C_n of bending mode `number`, from 1, of a clamped-free bar; ValueError below 1."""
    if number < 1:
        msg = f"modes count from 1, got {number}"
        raise ValueError(msg)
    return _CLAMPED[number - 1] if number <= len(_CLAMPED) else 0.5 * np.pi * (number - 0.5) ** 2


def bar_modulus(
    frequency_hz: FloatArray,
    number: int,
    *,
    length_m: FloatArray,
    thickness_m: FloatArray,
    density_kg_m3: FloatArray,
) -> FloatArray:
    """Young's modulus in Pa of a uniform clamped bar, ``E = 12 rho l^4 f^2 / (H^2 C_n^2)``, from mode `number`.

    Too low for a clamp that is not rigid or a free length that begins inside the jaws (by four times the relative error
    of the length), and for added masses; too high for a hanging bar.
    """
    ratio = frequency_hz / (thickness_m * clamped_coefficient(number))
    return np.asarray(12.0 * density_kg_m3 * length_m**4 * ratio**2)


def oberst_layer(
    stiffening: FloatArray,
    loss_factor: FloatArray,
    *,
    base_modulus_pa: FloatArray,
    thickness_ratio: FloatArray,
) -> ComplexArray:
    """Complex modulus ``E1 (1 + i eta1)`` in Pa of a layer on one side of a bar (Oberst).

    E756 has ``E1 = E / (2 T^3) [(a - b) + sqrt((a - b)^2 - 4 T^2 (1 - a))]`` with ``b = 4 + 6 T + 4 T^2``; here with a
    complex ``a (1 + i eta_c)`` it holds for any loss factor. For E1 = 0.05 E, T = 1 and eta1 = 0.5
    the real equations give E1 1.1 % too high and eta1 1.0 % too low, for E1 = E 9 and 6 %.

    Parameters
    ----------
    stiffening : array
        ``a = (fc / fn)^2 (1 + D T)``, D the ratio of the densities, layer to bar. The modulus is 0 at 1.
    loss_factor : array
        Of the composite, eta_c.
    base_modulus_pa : array
        E of the bar, which dissipates nothing.
    thickness_ratio : array
        T, layer to bar.
    """
    a, t = stiffening * (1.0 + 1j * loss_factor), thickness_ratio
    p = a - (4.0 + 6.0 * t + 4.0 * t**2)
    root = np.sqrt(p**2 - 4.0 * t**2 * (1.0 - a))
    # Of the two forms of the solution the one that does not subtract nearly equal numbers.
    stiff = p.real > 0.0
    below = np.where(stiff, 1.0, t * (root - p))
    return np.asarray(base_modulus_pa * np.where(stiff, 0.5 * (p + root) / t**3, 2.0 * (a - 1.0) / below))


def modified_oberst_layer(
    stiffening: FloatArray,
    loss_factor: FloatArray,
    *,
    base_modulus_pa: FloatArray,
    thickness_ratio: FloatArray,
) -> ComplexArray:
    """Complex modulus in Pa of equal layers on both sides of a bar; parameters as of `oberst_layer`, T of one layer.

    ``E1 = E (a - 1) / (8 T^3 + 12 T^2 + 6 T)``, ``a = (fm / fn)^2 (1 + 2 D T)``; its imaginary part is E756's for eta1.
    """
    a, t = stiffening * (1.0 + 1j * loss_factor), thickness_ratio
    return np.asarray(base_modulus_pa * (a - 1.0) / (8.0 * t**3 + 12.0 * t**2 + 6.0 * t))


def sandwich_core(
    stiffening: FloatArray,
    loss_factor: FloatArray,
    number: int,
    *,
    base_modulus_pa: FloatArray,
    thickness_ratio: FloatArray,
    length_m: FloatArray,
    thickness_m: FloatArray,
) -> ComplexArray:
    """Complex shear modulus ``G1 (1 + i eta1)`` in Pa of the core between two equal bars, from mode `number`.

    E756's equations for G1 and eta1 are the parts of ``z / (1 - 2 z) 2 pi C_n E H H1 / l^2``, where ``z`` is ``A (1 + i
    eta_s) - B``, computed here as one. They leave out bending and extension of the core. `stiffening` is ``(fs / fn)^2
    (2 + D T)``, which is 2 without a core; E, H and l are those of one bar, T is H1 / H.
    """
    b = 1.0 / (6.0 * (1.0 + thickness_ratio) ** 2)
    z = 0.5 * b * stiffening * (1.0 + 1j * loss_factor) - b
    scale = 2.0 * np.pi * clamped_coefficient(number) * base_modulus_pa * thickness_ratio
    return np.asarray(z / (1.0 - 2.0 * z) * scale * (thickness_m / length_m) ** 2)


def flexural_correction(slenderness: FloatArray, poisson_ratio: FloatArray) -> FloatArray:
    """T1 of a free bar: shear and rotary inertia in its first bending mode; `slenderness` is t/L.

    At a Poisson's ratio of 0.3, within 5e-4 of the exact frequency of a Timoshenko beam up to 0.2.
    """
    r, mu = slenderness, poisson_ratio
    first = 6.585 * (1.0 + 0.0752 * mu + 0.8109 * mu**2) * r**2
    second = 8.340 * (1.0 + 0.2023 * mu + 2.173 * mu**2) * r**4
    third = 1.0 + 6.338 * (1.0 + 0.1408 * mu + 1.536 * mu**2) * r**2
    return np.asarray(1.0 + first - 0.868 * r**4 - second / third)


def free_bar_modulus(frequency_hz: FloatArray, poisson_ratio: FloatArray, **sizes: FloatArray) -> FloatArray:
    """Young's modulus in Pa from the first bending mode of a free bar, ``0.9465 (m f^2 / b) (L^3 / t^3) T1``.

    `sizes` are mass_kg, length_m, width_m and thickness_m. The rounded 0.9465 makes it 9e-5 too high.
    """
    slenderness = sizes["thickness_m"] / sizes["length_m"]
    stiffness = 0.9465 * sizes["mass_kg"] * frequency_hz**2 / (sizes["width_m"] * slenderness**3)
    return np.asarray(stiffness * flexural_correction(slenderness, poisson_ratio))


def torsional_correction(width_m: FloatArray, thickness_m: FloatArray, length_m: FloatArray) -> FloatArray:
    """R of a free bar: the torsional stiffness of its rectangular section, and the warping of a short bar."""
    w, b = width_m / thickness_m, width_m / length_m
    section = (1.0 + w**2) / (4.0 - 2.521 / w * (1.0 - 1.991 / (np.exp(np.pi * w) + 1.0)))
    return np.asarray(section * (1.0 + 0.00851 * b**2) - 0.060 * b**1.5 * (w - 1.0) ** 2)


def free_bar(
    frequency_hz: FloatArray, torsion_hz: FloatArray, **sizes: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """E and G in Pa and Poisson's ratio of an isotropic free bar from its first bending and torsional modes.

    ``G = (4 L m f_t^2 / (b t)) R``. E depends on Poisson's ratio by T1, and Poisson's ratio is ``E / (2 G) - 1``: both
    are iterated until neither changes. `sizes` as of `free_bar_modulus`. NaN where it does not converge.
    """
    length, width, thickness = (sizes[name] for name in ("length_m", "width_m", "thickness_m"))
    g = 4.0 * length * sizes["mass_kg"] * torsion_hz**2 / (width * thickness)
    g = g * torsional_correction(width, thickness, length)
    mu = np.full_like(g, 0.3)
    for _ in range(_MOST_STEPS):
        e = free_bar_modulus(frequency_hz, mu, **sizes)
        before, mu = mu, e / (2.0 * g) - 1.0
        settled = np.abs(mu - before) <= 1e-13 * (1.0 + np.abs(mu))
        if np.all(settled):
            break
    return np.where(settled, e, np.nan), g, np.where(settled, mu, np.nan)

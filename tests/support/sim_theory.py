"""Frequencies of beams by other means than finite elements."""

import numpy as np
from scipy.linalg import eigh
from scipy.optimize import brentq

# shear and rotary inertia are left out by theory and element alike


def cantilever_roots(count):
    """Roots of cos(x) cosh(x) = -1: beta_n L of the clamped-free beam."""
    guesses = [1.875, *((np.pi * (n - 0.5)) for n in range(2, count + 1))]
    return np.array(
        [brentq(lambda x: np.cos(x) + 1.0 / np.cosh(x), g - 0.3, g + 0.3, xtol=1e-14) for g in guesses]
    )


def euler_bernoulli_hz(properties, count):
    """Uniform cantilever without gravity."""
    stiffness = properties.elastic_modulus_pa * properties.second_moment_m4[0]
    line_mass = properties.density_kg_m3 * properties.area_m2[0]
    beta = cantilever_roots(count) / properties.length_m
    return beta**2 * np.sqrt(stiffness / line_mass) / (2.0 * np.pi)


def rayleigh_ritz_hz(properties, count, *, tension_sign):
    """Uniform cantilever whose weight pulls (+1, hanging) or pushes (-1, standing), by global polynomials.

    The trial functions are x^2 times Legendre polynomials over the whole beam; the axial force is
    tension_sign rho A g (L - x).
    """
    terms = 18
    nodes, weights = np.polynomial.legendre.leggauss(60)
    length = properties.length_m
    x, w = 0.5 * (nodes + 1.0), 0.5 * weights
    polynomials = [
        np.polynomial.Polynomial([0, 0, 1])
        * np.polynomial.Legendre.basis(n, domain=[0, 1]).convert(kind=np.polynomial.Polynomial)
        for n in range(terms)
    ]
    value = np.array([p(x) for p in polynomials])
    slope = np.array([p.deriv(1)(x) for p in polynomials]) / length
    curve = np.array([p.deriv(2)(x) for p in polynomials]) / length**2
    stiffness = properties.elastic_modulus_pa * properties.second_moment_m4[0]
    line_mass = properties.density_kg_m3 * properties.area_m2[0]
    tension = tension_sign * line_mass * properties.gravity_m_s2 * length * (1.0 - x)
    k = length * ((curve * w * stiffness) @ curve.T + (slope * w * tension) @ slope.T)
    m = length * (value * w * line_mass) @ value.T
    scale = 1.0 / np.sqrt(np.diag(m))
    square = eigh(k * np.outer(scale, scale), m * np.outer(scale, scale), eigvals_only=True)
    return np.sqrt(square[:count]) / (2.0 * np.pi)

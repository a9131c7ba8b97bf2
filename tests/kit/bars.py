"""Bars computed independently of the equations of the standards: layered sections, a free Timoshenko beam, torsion."""

import numpy as np
from scipy.optimize import brentq

#: Roots of cos(x) cosh(x) = -1 (clamped-free) and the first of cos(x) cosh(x) = 1 (free-free).
CLAMPED_ROOTS = (1.8751040687, 4.6940911330, 7.8547574382, 10.9955407349, 14.1371683910)
FREE_ROOT = 4.7300407449


def bending_stiffness(layers):
    """Stiffness per width, about the neutral axis, of a section of (modulus, thickness) from the bottom; complex."""
    bounds = np.concatenate([[0.0], np.cumsum([thickness for _, thickness in layers])])
    moduli = np.array([modulus for modulus, _ in layers])
    axis = np.sum(moduli * np.diff(bounds**2) / 2.0) / np.sum(moduli * np.diff(bounds))
    return np.sum(moduli * np.diff((bounds - axis) ** 3) / 3.0)


def sandwich_stiffness(modulus, thickness, core_shear, core_thickness, wave_number):
    """Stiffness per width of two bars with a core that only shears (Ross, Kerwin, Ungar), at a wave number; complex.

    The bars move by u and -u along the beam and bend with the slope k w: the core has the shear (2 u - d k w) / H1,
    d the distance of the bars' mid-planes. u minimises the energy, as the virtual work of each bar requires.
    """
    k, h, h1 = wave_number, thickness, core_thickness
    d = h + h1
    # Energy per width and squared w: E h k^2 u^2 (extension), G/(2 H1) (2 u - d k)^2 (shear), E h^3/12 k^4 (bending).
    extension, shear = modulus * h * k**2, core_shear / (2.0 * h1)
    u = 2.0 * shear * d * k / (extension + 4.0 * shear)
    energy = extension * u**2 + shear * (2.0 * u - d * k) ** 2 + modulus * h**3 / 12.0 * k**4
    return 2.0 * energy / k**4


def free_timoshenko(slenderness, poisson_ratio):
    """Squared first bending frequency of a free-free Timoshenko beam over that of a Bernoulli-Euler beam.

    Rectangle, shear coefficient of Cowper (1966), 10 (1 + mu) / (12 + 11 mu). Symmetric modes of Huang (1961).
    The boundary conditions of zero moment and shear at the ends give the determinant. Unit length and rho A = EI = 1.
    """
    kappa = 10.0 * (1.0 + poisson_ratio) / (12.0 + 11.0 * poisson_ratio)
    r2 = slenderness**2 / 12.0
    s2 = r2 * 2.0 * (1.0 + poisson_ratio) / kappa

    def determinant(b):
        # w'''' + b^2 (r2 + s2) w'' - b^2 (1 - b^2 r2 s2) w = 0 with w = cosh(p x), cos(q x); psi' = w'' + b^2 s2 w
        half = 0.5 * b**2 * (r2 + s2)
        root = np.sqrt(half**2 + b**2 * (1.0 - b**2 * r2 * s2))
        p, q = np.sqrt(root - half), np.sqrt(root + half)
        moment = np.array([(p**2 + b**2 * s2) * np.cosh(0.5 * p), (b**2 * s2 - q**2) * np.cos(0.5 * q)])
        # shear = psi'' + b^2 r2 psi, psi = integral of psi'
        shear = np.array([
            (p**2 + b**2 * s2) / p * (p**2 + b**2 * r2) * np.sinh(0.5 * p),
            (b**2 * s2 - q**2) / q * (b**2 * r2 - q**2) * np.sin(0.5 * q),
        ])  # fmt: skip
        return moment[0] * shear[1] - moment[1] * shear[0]

    euler = FREE_ROOT**2
    return (brentq(determinant, 0.4 * euler, 1.001 * euler, xtol=1e-13) / euler) ** 2


def torsion_constant(width, thickness):
    """Saint-Venant's J of a rectangle by its series (Timoshenko and Goodier, article 109)."""
    n = np.arange(1, 400, 2)
    tail = np.sum(np.tanh(0.5 * np.pi * n * width / thickness) / n**5)
    return width * thickness**3 / 3.0 * (1.0 - 192.0 * thickness / (np.pi**5 * width) * tail)

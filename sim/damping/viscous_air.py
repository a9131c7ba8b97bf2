r"""Viscous damping by still air at small amplitude, of a thin blade: a law without a free parameter.

.. math:: \zeta = \frac{t \Gamma_i}{2 (1 + t \Gamma_r)}, \quad t = \frac{\pi \rho_{air} b}{4 \rho h}, \quad
          \mathrm{Re} = \frac{\rho_{air} \omega b^2}{4 \mu}

:math:`\Gamma` is that of a cylinder, corrected for the section of a blade. The flow is two-dimensional and attached: a
motion that is not small against the width is damped more (`StillAir`), and so is a beam beside a wall.

References
----------
Sader, J. Appl. Phys. 84 (1998) 64, doi:10.1063/1.368002, Eq. 20 and 21: within 0.1 % for Re from 1e-6 to 1e4.
"""

from __future__ import annotations

import numpy as np

from sim.damping.entry import law_entry
from sim.damping.law import ComputedLaw
from sim.damping.section import BeamSection
from tracker import FloatArray

# Eq. 21, real and imaginary: coefficients of powers of log10 Re, from the constant on
_ABOVE = (
    (0.91324, -0.48274, 0.46842, -0.12886, 0.044055, -0.0035117, 0.00069085),
    (-0.024134, -0.029256, 0.016294, -0.00010961, 0.000064577, -0.000044510, 0.0),
)
_BELOW = (
    (1.0, -0.56964, 0.48690, -0.13444, 0.045155, -0.0035862, 0.00069085),
    (1.0, -0.59702, 0.55182, -0.18357, 0.079156, -0.014369, 0.0028361),
)


def viscous_air_ratio(omega: FloatArray, section: BeamSection) -> FloatArray:
    """Damping ratio at these angular frequencies."""
    from scipy.special import kve  # noqa: PLC0415 - a run that is up to date loads none of SciPy

    air, width = section.air_density_kg_m3, section.width_m
    reynolds = air * omega * width**2 / (4.0 * section.air_viscosity_pa_s)
    root = np.sqrt(1j * reynolds)
    powers = np.log10(reynolds) ** np.arange(7)[:, np.newaxis]
    blade = np.array([1.0, 1.0j]) @ ((_ABOVE @ powers) / (_BELOW @ powers))
    gamma = (1.0 + 4.0j * kve(1, -1j * root) / (root * kve(0, -1j * root))) * blade
    ratio = 0.25 * np.pi * air * width / (section.density_kg_m3 * section.thickness_m)
    return np.asarray(0.5 * ratio * gamma.imag / (1.0 + ratio * gamma.real))


_TEXT = (
    "Viscosity of still air at small amplitude, computed from the section without a free parameter (Sader)."
)
_LAW = ComputedLaw(viscous_air_ratio, needs_material=False)
VISCOUS_AIR = law_entry("viscous_air", "viscous air damping", _TEXT, ("#4b6bd0", "#a9bcff"), _LAW)

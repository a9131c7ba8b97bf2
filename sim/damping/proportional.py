r"""Damping proportional to stiffness alone (Kelvin-Voigt) or to mass alone: the two terms of Eq. 3.

Kelvin-Voigt: :math:`\sigma = E (\varepsilon + \beta \dot\varepsilon)`, :math:`\zeta = \beta \omega / 2`; mass:
:math:`\zeta = \alpha / (2 \omega)`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from sim.damping.entry import law_entry
from sim.damping.law import PowerLaw
from sim.damping.models import RayleighDamping
from tracker import FloatArray

if TYPE_CHECKING:
    from sim.damping.entry import MeasuredDamping


class Proportional(PowerLaw):
    """A damping ratio proportional to the frequency (power 1) or to its inverse (-1)."""

    def model(self, measured: MeasuredDamping, omega_rad_s: FloatArray) -> RayleighDamping:
        """Rayleigh damping with one coefficient, so that modes above the measured ones follow the law too."""
        top = omega_rad_s[-1:]
        coefficient = float((2.0 * self.damping_ratio(measured, top) / top**self.power)[0])
        return RayleighDamping(0.0, coefficient) if self.power > 0 else RayleighDamping(coefficient, 0.0)


KELVIN_VOIGT = law_entry(
    "kelvin_voigt",
    "Kelvin-Voigt damping",
    "β K(q): viscous material, damping ratio proportional to the frequency.",
    ("#9c3848", "#f0909f"),
    Proportional(1),
)
MASS = law_entry(
    "mass",
    "mass-proportional damping",
    "α M: damping ratio inversely proportional to the frequency.",
    ("#3f6f8f", "#8fc3e6"),
    Proportional(-1),
)

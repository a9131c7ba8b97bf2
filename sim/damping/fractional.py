"""Fractional damping: ``zeta ~ omega^alpha``, between mass-proportional (-1), hysteretic (0) and viscous (1) damping.

In the fractional Kelvin-Voigt model ``sigma = E (e + tau^a D^a e)`` the loss factor grows as omega^a for small losses.

References
----------
Bagley, Torvik, "A theoretical basis for the application of fractional calculus to viscoelasticity", J. Rheol. 27
(1983), doi:10.1122/1.549724.
"""

from __future__ import annotations

import numpy as np

from sim.damping.entry import law_entry
from sim.damping.law import ParametricLaw
from sim.damping.section import BeamSection
from tracker import FloatArray

# Uniform prior; the step is a third of what a scatter of 1 % over a factor of 50 in frequency determines.
_EXPONENTS = np.linspace(-1.0, 1.0, 501)


class Fractional(ParametricLaw):
    """A damping ratio proportional to a power of the frequency, uniformly distributed from -1 to 1."""

    shape_name = "exponent"

    def nodes(self) -> tuple[FloatArray, FloatArray]:
        """Exponents."""
        return _EXPONENTS, np.full(_EXPONENTS.size, 1.0 / _EXPONENTS.size)

    def log_ratio(self, omega: FloatArray, reference: float, section: BeamSection | None) -> FloatArray:  # noqa: ARG002
        """Exponent times the logarithm of the frequency."""
        return np.outer(_EXPONENTS, np.log(omega / reference))


FRACTIONAL = law_entry(
    "fractional",
    "fractional damping",
    "Damping ratio proportional to a power of the frequency between -1 and 1.",
    ("#8a5a00", "#e0b060"),
    Fractional(),
)

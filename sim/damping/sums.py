r"""Sums of two laws, each of a level or computed without a free parameter.

Two levels: their ratio at the reference has the prior :math:`\ln r \sim N(0, (\ln 10)^2)`, their sum that of a level.
With a computed law, which is not fitted, the level has its own prior.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from sim.damping.constant import CONSTANT
from sim.damping.entry import DampingModelEntry, law_entry
from sim.damping.law import TUNING, ParametricLaw, normal_nodes
from sim.damping.proportional import KELVIN_VOIGT, MASS
from sim.damping.section import BeamSection
from sim.damping.thermoelastic import THERMOELASTIC
from sim.damping.viscous_air import VISCOUS_AIR
from tracker import FloatArray


class SumOfLaws(ParametricLaw):
    """Sum of two laws without a parameter beside the level; a computed one is the second."""

    def __init__(self, *entries: DampingModelEntry) -> None:
        first, second = (entry.law for entry in entries)
        if not (isinstance(first, ParametricLaw) and isinstance(second, ParametricLaw)):
            msg = f"expected two laws of a level, got {[entry.key for entry in entries]}"
            raise TypeError(msg)
        self._laws, self.free_level = (first, second), second.free_level
        self.shape_name = "log ratio" if self.free_level else "log level" if first.free_level else ""

    def lacks(self, section: BeamSection | None) -> str:
        """Of either."""
        return self._laws[0].lacks(section) or self._laws[1].lacks(section)

    def nodes(self) -> tuple[FloatArray, FloatArray]:
        """Logarithm of the ratio of the levels, second over first, or of the level of the first."""
        if not self.shape_name:
            return super().nodes()
        level = np.log(TUNING.level), TUNING.level_sd
        return normal_nodes(*((0.0, np.log(10.0)) if self.free_level else level))

    def log_ratio(self, omega: FloatArray, reference: float, section: BeamSection | None) -> FloatArray:
        """Sum at each node; of two levels, relative to their sum at the reference."""
        first, second = (law.log_ratio(omega, reference, section) for law in self._laws)
        node = self.nodes()[0][:, np.newaxis]
        if self.free_level:
            return np.asarray(np.logaddexp(first, node + second) - np.logaddexp(0.0, node))
        return np.asarray(np.logaddexp(first + node, second))


def _sum(first: DampingModelEntry, second: DampingModelEntry, at: int) -> DampingModelEntry:
    name = f"{first.name} and {second.name}"
    colours = (f"#{90 + 7 * at:02x}5a{154 - 9 * at:02x}", f"#{176 + 6 * at:02x}c4{240 - 9 * at:02x}")
    key, law = f"{first.key}_and_{second.key}", SumOfLaws(first, second)
    return law_entry(key, name, f"Sum of {name}.", colours, law, draw_stride=8)


_PARTS = (MASS, CONSTANT, KELVIN_VOIGT, VISCOUS_AIR, THERMOELASTIC)
_PAIRS = (pair for pair in combinations(_PARTS, 2) if pair != (MASS, KELVIN_VOIGT))
SUMS = tuple(_sum(*pair, at) for at, pair in enumerate(_PAIRS))
MASS_AND_STIFFNESS = SumOfLaws(MASS, KELVIN_VOIGT)  # the law of Rayleigh's entry

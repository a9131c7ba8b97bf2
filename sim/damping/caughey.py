r"""Caughey's series through all measured modes: :math:`2 \zeta \omega = \sum_j a_j \omega^{2j}`, j = 0 to n - 1.

Caughey, "Classical normal modes in damped linear systems", J. Appl. Mech. 27 (1960) 269, doi:10.1115/1.3643949.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from sim.damping.entry import law_entry
from sim.damping.models import DampingCoefficients, DampingModel
from sim.damping.through_all import ThroughAllModes
from tracker import FloatArray

if TYPE_CHECKING:
    from sim.beam import BeamModes
    from sim.damping.entry import MeasuredDamping


def caughey_weights(known: FloatArray, omega: FloatArray) -> FloatArray:
    """Weight of each known damping ratio in that at `omega`, shape (m, n): Lagrange's form of the series."""
    pairs = [(one**2, np.delete(known, k) ** 2) for k, one in enumerate(known)]
    columns = [np.prod((omega[:, np.newaxis] ** 2 - rest) / (one - rest), axis=1) for one, rest in pairs]
    return np.stack(columns, axis=1) * np.divide.outer(1.0 / omega, 1.0 / known)


@dataclass(frozen=True)
class CaugheyDamping(DampingModel):
    """Damping ratios of modes 1 to m by the series; above, where it is unbounded, that of mode m."""

    damping_ratio: tuple[float, ...]

    @property
    def caution(self) -> str:
        """Warning about a negative damping ratio."""
        return (
            "Caughey's series is negative at a mode: it adds energy." if min(self.damping_ratio) < 0.0 else ""
        )

    def coefficients(self, modes: BeamModes) -> DampingCoefficients:
        """Modal ratios."""
        ratio = np.pad(self.damping_ratio, (0, modes.count), mode="edge")
        return DampingCoefficients(0.0, 0.0, 0.0, ratio[: modes.count])


class Caughey(ThroughAllModes):
    """The series."""

    def model(self, measured: MeasuredDamping, omega_rad_s: FloatArray) -> CaugheyDamping:
        """Damping ratios by the series through the beam's own frequencies: it would magnify their errors."""
        at = np.array(measured.numbers) - 1
        own = replace(measured, frequency_hz=tuple(omega_rad_s[at] / (2.0 * np.pi)))
        return CaugheyDamping(tuple(map(float, self.damping_ratio(own, omega_rad_s))))


_SHOWN = "Caughey damping", "Caughey's series with one term for each measured mode.", ("#6b7a1c", "#c4d468")
CAUGHEY = law_entry("caughey", *_SHOWN, Caughey(caughey_weights))

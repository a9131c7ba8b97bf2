r"""Laws with one parameter for each measured mode: Caughey's series, and generic damping between measured modes.

The values are the parameters, independent, with the prior of a level. What such a law says of a mode left out is its
interpolation through the others, normal about it with the scatter of the prior.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sim.damping.law import TUNING, DampingLaw, LawFit, LeftOut, log_data, scatters
from tracker import INTERVAL_SD, FloatArray

if TYPE_CHECKING:
    from sim.damping.entry import MeasuredDamping


def neighbour_weights(known: FloatArray, omega: FloatArray) -> FloatArray:
    """Weight of each known damping ratio in that at `omega`, shape (m, n): linear, constant outside."""
    return np.stack([np.interp(omega, known, unit) for unit in np.eye(known.size)], axis=1)


@dataclass(frozen=True)
class ThroughAllModes(DampingLaw):
    """An interpolation of all measured damping ratios by their weights."""

    weights: Callable[[FloatArray, FloatArray], FloatArray] = neighbour_weights

    def log_evidence(self, measured: MeasuredDamping) -> float:
        """Of independent values."""
        _, y, relative_sd = log_data(measured)
        return float(_log_normal(y, np.log(TUNING.level), np.hypot(TUNING.level_sd, relative_sd)).sum())

    def fit(self, measured: MeasuredDamping) -> LawFit:
        """The values themselves."""
        left_out = [self._left_out(measured, at) for at in range(len(measured.numbers))]
        return LawFit(self.log_evidence(measured), len(left_out), tuple(left_out))

    def damping_ratio(self, measured: MeasuredDamping, omega_rad_s: FloatArray) -> FloatArray:
        """The interpolation; Caughey's series may be negative between the modes."""
        omega, y, _ = log_data(measured)
        return np.asarray(self.weights(omega, np.asarray(omega_rad_s)) @ np.exp(y))

    def _left_out(self, measured: MeasuredDamping, at: int) -> LeftOut:
        omega, y, relative_sd = log_data(measured)
        zeta, rest = np.exp(y), np.arange(y.size) != at
        parts = self.weights(omega[rest], omega[at : at + 1])[0] * zeta[rest]
        mean = float(parts.sum())
        variance = np.add.outer(scatters() ** 2, relative_sd[rest] ** 2) @ parts**2 + (scatters() * mean) ** 2
        density = _log_normal(zeta[at], mean, np.sqrt(variance + (relative_sd[at] * zeta[at]) ** 2)) + y[at]
        reach = INTERVAL_SD * float(np.sqrt(np.mean(variance)))
        log_mean = float(np.logaddexp.reduce(density) - np.log(density.size))
        return LeftOut(log_mean, mean, mean - reach, mean + reach)


def _log_normal(value: FloatArray, mean: float, sd: FloatArray) -> FloatArray:
    return np.asarray(-0.5 * ((value - mean) / sd) ** 2 - np.log(sd * np.sqrt(2.0 * np.pi)))

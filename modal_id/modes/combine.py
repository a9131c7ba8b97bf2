"""One value from repeated recordings, and whether they agree."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # its parts are loaded when they are used
from scipy.special import chdtrc, chdtri

from modal_id.fit import FALSE_ALARM
from tracker import INTERVAL_LEVEL, FloatArray


@dataclass(frozen=True)
class Combined:
    """Several values as one.

    Attributes
    ----------
    value, sd : float
        Weighted mean and its standard deviation, which includes `between_sd`.
    between_sd : float
        Standard deviation between recordings in excess of their own; 0 where their own explain the scatter.
    chi_square : float
        Weighted sum of squares about the mean without `between_sd`.
    dof : int
    p_value : float
        Of `chi_square`; NaN for a single value.
    """

    value: float
    sd: float
    between_sd: float
    chi_square: float
    dof: int
    p_value: float

    @property
    def disagree(self) -> bool:
        """Whether the scatter is larger than the standard deviations explain but for one mode in a hundred."""
        return self.p_value < FALSE_ALARM


def combine(values: Sequence[float], sds: Sequence[float]) -> Combined:
    """Random-effects mean of independent values.

    Raises
    ------
    ValueError
        If there is no value, or a standard deviation is not positive.

    Notes
    -----
    Paule & Mandel (1982), doi:10.6028/jres.087.022: the variance between recordings is that at which the weighted
    sum of squares equals its expectation, and at least zero.
    """
    x, sd = _checked(values, sds)
    dof = x.size - 1
    chi_square = _square(0.0, x, sd)
    between = _between(float(dof), x, sd) if dof else 0.0
    weight = 1.0 / (sd**2 + between)
    mean = float(np.sum(weight * x) / np.sum(weight))
    p_value = float(chdtrc(dof, chi_square)) if dof else float("nan")
    return Combined(mean, float(np.sum(weight)) ** -0.5, between**0.5, chi_square, dof, p_value)


def between_interval(values: Sequence[float], sds: Sequence[float]) -> tuple[float, float]:
    """Central 90 % interval of the standard deviation between independent values; from 0 to infinity for one.

    Raises
    ------
    ValueError
        As `combine`.

    Notes
    -----
    Q profile, Viechtbauer (2007), doi:10.1002/sim.2514: the weighted sum of squares is that of chi-square at the ends.
    """
    x, sd = _checked(values, sds)
    if x.size == 1:
        return 0.0, float("inf")
    ends = chdtri(x.size - 1, [0.5 * (1.0 - INTERVAL_LEVEL), 0.5 * (1.0 + INTERVAL_LEVEL)])
    low, high = (_between(float(end), x, sd) ** 0.5 for end in ends)
    return low, high


def _checked(values: Sequence[float], sds: Sequence[float]) -> tuple[FloatArray, FloatArray]:
    x, sd = np.asarray(values, dtype=float), np.asarray(sds, dtype=float)
    if x.size == 0 or x.shape != sd.shape or not np.all(np.isfinite(x)) or not np.all(sd > 0.0):
        msg = f"expected finite values with positive standard deviations, got {x.tolist()} and {sd.tolist()}"
        raise ValueError(msg)
    return x, sd


def _between(chi_square: float, x: FloatArray, sd: FloatArray) -> float:
    """Variance between values at which the weighted sum of squares is `chi_square`, at least zero."""
    if _square(0.0, x, sd) <= chi_square:
        return 0.0
    # Relative to the scatter of the values: the search ends at an absolute error.
    unit = float(np.ptp(x)) ** 2
    return unit * float(
        scipy.optimize.brentq(lambda v: _square(unit * v, x, sd) - chi_square, 0.0, x.size / chi_square)
    )


def _square(between: float, x: FloatArray, sd: FloatArray) -> float:
    weight = 1.0 / (sd**2 + between)
    mean = np.sum(weight * x) / np.sum(weight)
    return float(np.sum(weight * (x - mean) ** 2))

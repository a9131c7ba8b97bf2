"""Factors within a bound that bring the modes to the measured ones, and the smallest bound that can.

Factors are those of the paper: of each element's width and thickness, of density and modulus, between 1 - bound and
1 + bound. Of the many answers the one nearest to the start is taken: where the data say nothing, nothing moves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog, lsq_linear

from sim.beam import BeamProperties
from sim.updating.family import BeamFamily, Points
from sim.updating.measured import MeasuredModes

FloatArray = NDArray[np.float64]

# Weight of the distance from the start, in bounds, beside misfits in standard deviations: it decides only what
# the data leave open, and holds the frequencies off by less than 1e-7.
_PULL = 0.1
_MAX_ITERATIONS = 40
_SMALLEST_SHARE = 1e-3
_MOVE_TOLERANCE = 1e-9
_LARGEST_BOUND = 0.9


@dataclass(frozen=True)
class Misfit:
    """Deviation of a beam's modes from measured ones, over standard deviations, as a function of the factors.

    Attributes
    ----------
    family : BeamFamily
    measured : MeasuredModes
    """

    family: BeamFamily
    measured: MeasuredModes

    @classmethod
    def of(cls, properties: BeamProperties, measured: MeasuredModes) -> Misfit:
        """Misfit of the beams that come from `properties`."""
        points = tuple(Points(shape.mode_number, shape.positions_m) for shape in measured.shapes)
        return cls(BeamFamily(properties, measured.highest, points), measured)

    def frequency_hz(self, factor: FloatArray) -> FloatArray:
        """Of the measured modes, shape (m,)."""
        modes = self.family.modes(np.log(factor))
        return np.asarray(modes.frequency_hz[0, self.measured.mode_numbers - 1])

    def at(self, log_factor: FloatArray, *, slopes: bool = False) -> tuple[FloatArray, FloatArray]:
        """Misfits, shape (n, k), and their derivatives to the logarithms of the factors, (n, k, v) or (n, 0, v).

        Frequencies first, as ``log(f / f_measured) / sd``; then each measured shape, its scale and sign set free.
        """
        modes = self.family.modes(log_factor, slopes=slopes)
        at, sd = self.measured.mode_numbers - 1, self.measured.relative_sd
        parts = [np.log(modes.frequency_hz[:, at] / self.measured.frequency_hz) / sd]
        parts += [
            shape.misfit(values) for shape, values in zip(self.measured.shapes, modes.shapes, strict=True)
        ]
        misfit = np.concatenate(parts, axis=1)
        if not slopes:
            return misfit, np.zeros((misfit.shape[0], 0, self.family.variables))
        rows = [modes.log_frequency_slopes[:, at] / sd[:, np.newaxis]]
        for shape, values, change in zip(self.measured.shapes, modes.shapes, modes.shape_slopes, strict=True):
            rows.append(shape.misfit_slopes(values, change))
        return misfit, np.concatenate(rows, axis=1)


def fit_within(misfit: Misfit, start: FloatArray, bound: float, free: FloatArray | None = None) -> FloatArray:
    """Factors within `bound` with the least sum of squared misfits; of several answers the nearest to `start`.

    Gauss-Newton, each linearised problem solved with its bounds exactly; a step that does not help is halved.

    Parameters
    ----------
    misfit : Misfit
    start : array, shape (v,)
        Factors to begin with.
    bound : float
        Largest relative change of any factor.
    free : array, shape (v, k), optional
        Changes of the factors that are allowed, one a column; the bound then holds for the columns' multiples,
        and `start` must be 1. All factors are free when absent.
    """
    columns = np.eye(start.size) if free is None else free
    moved, p = np.zeros(columns.shape[1]), start.copy()
    low, high = (1.0 - bound - start, 1.0 + bound - start) if free is None else (-bound, bound)
    pull = _PULL / bound

    def residual(change: FloatArray) -> FloatArray:
        return np.concatenate([misfit.at(np.log(start + columns @ change))[0][0], pull * change])

    now = residual(moved)
    for _ in range(_MAX_ITERATIONS):
        _, slopes = misfit.at(np.log(p), slopes=True)
        rows = np.vstack([slopes[0] / p @ columns, pull * np.eye(moved.size)])
        room = (np.minimum(low - moved, -1e-13), np.maximum(high - moved, 1e-13))
        move = np.asarray(lsq_linear(rows, -now, bounds=room, method="bvls").x)
        share = 1.0
        while share > _SMALLEST_SHARE:
            trial = np.clip(moved + share * move, low, high)
            then = residual(trial)
            if then @ then < now @ now:
                break
            share *= 0.5
        else:
            return p
        moved, now = trial, then
        p = start + columns @ moved
        if np.max(np.abs(share * move)) < _MOVE_TOLERANCE:
            break
    return p


def smallest_bound(misfit: Misfit, movable: NDArray[np.bool_] | None = None) -> tuple[float, FloatArray]:
    """Smallest bound on the change of any factor with which all measured frequencies are reached exactly.

    Linear programs in turn, each minimising the bound subject to the linearised frequencies; measured shapes are
    not asked for.

    Parameters
    ----------
    misfit : Misfit
    movable : bool array, shape (v,), optional
        Factors that may change; all when absent.

    Returns
    -------
    bound : float
        NaN where none below 0.9 does.
    factor : array, shape (v,)
    """
    v, m = misfit.family.variables, misfit.measured.mode_numbers.size
    free = np.flatnonzero(np.ones(v, dtype=np.bool_) if movable is None else movable)
    p, bound = np.ones(v), float("nan")
    weight = misfit.measured.relative_sd
    for _ in range(_MAX_ITERATIONS):
        values, slopes = misfit.at(np.log(p), slopes=True)
        off = values[0, :m] * weight
        rows = (slopes[0, :m] / p)[:, free] * weight[:, np.newaxis]
        ones, size = np.ones((free.size, 1)), free.size
        solved = linprog(
            np.append(np.zeros(size), 1.0),
            A_ub=np.vstack([np.hstack([np.eye(size), -ones]), np.hstack([-np.eye(size), -ones])]),
            b_ub=np.concatenate([1.0 - p[free], p[free] - 1.0]),
            A_eq=np.hstack([rows, np.zeros((m, 1))]),
            b_eq=-off,
            bounds=[(-0.2, 0.2)] * size + [(0.0, _LARGEST_BOUND)],
        )
        if not solved.success:
            return float("nan"), p
        p[free] += solved.x[:-1]
        previous, bound = bound, float(solved.x[-1])
        if abs(bound - previous) < 1e-9 and np.max(np.abs(off)) < 1e-8:
            break
    return bound, p

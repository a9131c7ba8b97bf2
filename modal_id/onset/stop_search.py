"""Instants at which the shaking may have stopped, tried one by one and followed downhill."""

from __future__ import annotations

import numpy as np

from modal_id.onset.piecewise import Kink, Solution, bounds, descend, scan
from tracker.arrays import FloatArray

# What a descent from a minimum of the scan may still gain.
HOPELESS = 300.0
FIRST_STEPS = 3
MINIMA = 3
_COARSE_POINTS = 300
_POINTS_A_CYCLE = 24.0


def searched(kink: Kink, start: FloatArray, reach_s: float) -> Solution | None:
    """The best solution within `reach_s` of where the search starts; None where nothing can be solved."""
    starts = [at_instant(start, instant) for instant in instants_within(kink, start, reach_s)]
    return lowest([descend(kink, one, FIRST_STEPS) for one in scan(kink, starts, MINIMA)])


def instants_within(kink: Kink, start: FloatArray, reach_s: float) -> FloatArray:
    """Instants to try within `reach_s`, as many as the model's turns ask for."""
    low, high = bounds(kink, start[0] - reach_s, start[0] + reach_s)
    finest = 2.0 * (high - low) / float(kink.scale[0])
    per_cycle = _POINTS_A_CYCLE * (high - low) * float(start[1]) / (2.0 * np.pi)
    return np.linspace(low, high, int(min(max(9.0, min(finest, per_cycle)), _COARSE_POINTS)))


def at_instant(nonlinear: FloatArray, instant_s: float) -> FloatArray:
    """The same parameters with another instant."""
    return np.concatenate([[instant_s], nonlinear[1:]])


def moved_to(nonlinear: FloatArray, instant_s: float) -> FloatArray:
    """The same drive, stopped at another instant."""
    amplitude = complex(nonlinear[2], nonlinear[3]) * np.exp(1j * nonlinear[1] * (instant_s - nonlinear[0]))
    return np.concatenate([[instant_s, nonlinear[1], amplitude.real, amplitude.imag], nonlinear[4:]])


def lowest(solutions: list[Solution]) -> Solution | None:
    """The solution of least chi-square; None where there is none."""
    return min(solutions, key=lambda s: s.chi_square, default=None)

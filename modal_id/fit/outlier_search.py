"""Rejection of outliers against the model and, where they are many, against motion that the model may lack."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from modal_id.data import FitData, limited, reject_outliers
from modal_id.fit.candidates import Band, candidates
from modal_id.solve import (
    LinearSolution,
    ModeColumns,
    Problem,
    damping_ratio,
    frequency_hz,
    motion,
    rough_poles,
    solve_linear,
)
from tracker import FloatArray

_MOST_LINES = 4
# Half-width of the band about a removed line in which no other is looked for, and reach of its fit, relative to its
# frequency; largest damping ratio of a line.
_HALF_WIDTH, _REACH, _MAX_DAMPING = 0.01, 0.05, 0.5


def without_outliers(
    data: FitData, original_weights: FloatArray, linear: LinearSolution, lowest_hz: float, own: list[Band]
) -> FitData:
    """The data without outliers; `original_weights` are those before any rejection, `own` the bands of the modes.

    Many large residuals in the beginning are not rejected, since they may be a mode that the model lacks. A knock there
    hides such a mode, because it raises the spectrum at all frequencies. Therefore the strongest lines of the clipped
    residual are removed one by one, until some of what remains is rejected.
    """
    residual = linear.residual
    cleaned = reject_outliers(data, original_weights, residual)
    excluded = list(own)
    for _ in range(_MOST_LINES):
        within = limited(original_weights, residual)
        if np.array_equal(within, residual) or not np.array_equal(cleaned.weights, data.weights):
            break
        found = candidates(data, within, linear.noise_variance, lowest_hz, tuple(excluded))
        if not found:
            break
        line = found[0]
        excluded.append(Band(line.frequency_hz, _HALF_WIDTH * line.frequency_hz))
        problem = Problem(replace(data, values=within), np.ones((data.time_s.size, 1)))
        pole = rough_poles(problem, np.array([-line.decay_per_s + 2j * np.pi * line.frequency_hz]))
        near = abs(float(frequency_hz(pole)[0]) / line.frequency_hz - 1.0) < _REACH
        if not near or not 0.0 < float(damping_ratio(pole)[0]) < _MAX_DAMPING:
            continue
        amplitudes = solve_linear(problem, ModeColumns(data.time_s, pole)).amplitudes
        residual = residual - motion(data.time_s, pole, amplitudes)
        cleaned = reject_outliers(data, original_weights, residual)
    return cleaned

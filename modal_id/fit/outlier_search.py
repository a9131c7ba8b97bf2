"""Rejection of outliers against the model and, where they are many, against motion that the model may lack."""

from __future__ import annotations

from dataclasses import dataclass, replace

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


@dataclass(frozen=True)
class Tuning:
    """Lines removed before outliers are looked for."""

    #: [1] largest number of lines removed
    most_lines: int = 4
    #: [1] half-width of the band about a removed line, over its frequency, in which no other is looked for
    half_width: float = 0.01
    #: [1] reach of the fit of a line, over its frequency
    reach: float = 0.05
    #: [1] largest damping ratio of such a line
    max_damping: float = 0.5


TUNING = Tuning()


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
    for _ in range(TUNING.most_lines):
        within = limited(original_weights, residual)
        if np.array_equal(within, residual) or not np.array_equal(cleaned.weights, data.weights):
            break
        found = candidates(data, within, linear.noise_variance, lowest_hz, tuple(excluded))
        if not found:
            break
        line = found[0]
        excluded.append(Band(line.frequency_hz, TUNING.half_width * line.frequency_hz))
        problem = Problem(replace(data, values=within), np.ones((data.time_s.size, 1)))
        pole = rough_poles(problem, np.array([-line.decay_per_s + 2j * np.pi * line.frequency_hz]))
        near = abs(float(frequency_hz(pole)[0]) / line.frequency_hz - 1.0) < TUNING.reach
        if not near or not 0.0 < float(damping_ratio(pole)[0]) < TUNING.max_damping:
            continue
        amplitudes = solve_linear(problem, ModeColumns(data.time_s, pole)).amplitudes
        residual = residual - motion(data.time_s, pole, amplitudes)
        cleaned = reject_outliers(data, original_weights, residual)
    return cleaned

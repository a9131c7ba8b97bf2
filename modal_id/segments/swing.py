"""Slow swing of the supports, which is removed before the search for events of a faster motion."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from modal_id.data import FitData, baseline_splines
from modal_id.fit import candidates
from modal_id.solve import Problem, no_columns, solve_linear
from tracker import FloatArray

# A swing has fewer cycles than this, and less than this share of the frequency of the motion.
FEW_CYCLES = 12.0


@dataclass(frozen=True)
class Tuning:
    """Swings of the whole set-up."""

    #: [1] largest frequency of a swing over that of the motion
    slow: float = 0.25
    #: [1] bandwidth of the splines over the frequency of the swing
    #: physics: They follow a sine within 1e-3 of its amplitude.
    followed: float = 6.0


TUNING = Tuning()


def without_swing(data: FitData, variance: FloatArray, frequency_hz: float, detrended: FloatArray) -> FitData:
    """The data less its slow motion, where that has a line of few cycles far below `frequency_hz`.

    `variance`, shape (k,), is the noise variance of each channel, `detrended`, shape (n, k), the data less offset and
    trend. In windows of two cycles of the motion, the curvature of a swing many times as large looks like a change of
    the motion.
    """
    lines = [c.frequency_hz for c in candidates(data, detrended, variance, 0.0, ())]
    slow = [f for f in lines if f < TUNING.slow * frequency_hz and f * data.span_s < FEW_CYCLES]
    if not slow:
        return data
    bandwidth = min(TUNING.followed * max(slow), TUNING.slow * frequency_hz)
    problem = Problem(data, baseline_splines(data.time_s, bandwidth))
    moving = solve_linear(problem, no_columns(data.time_s)).residual
    return replace(data, values=np.where(data.weights > 0.0, moving, 0.0))

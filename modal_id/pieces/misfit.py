"""How much of the motion the fit of a decay leaves unexplained, and where."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modal_id.fit.linear import LinearSolution, Problem, solve_linear
from modal_id.fit.model_order import ModalFit
from modal_id.fit.poles import frequency_hz, mode_functions

_LEAST_ROWS = 8
# Mean square residual of a window, relative to the lower quartile of all windows, that noise may reach.
_NOISE = 3.0


@dataclass(frozen=True)
class Misfit:
    """Unexplained motion of a fit.

    Attributes
    ----------
    share : float
        Residual power beyond the noise, as a share of the power of the motion.
    start_s, end_s : float
        Window with the largest unexplained power, in the time of the fit's data.
    """

    share: float
    start_s: float
    end_s: float


def misfit(model: ModalFit) -> Misfit:
    """Unexplained motion of a fit, in windows of a cycle of its strongest mode.

    The noise is that of the quarter of the windows that fit best. Where a mode stands for an unresolved pair, the pair
    explains what one mode does not.
    """
    cycle_s = 1.0 / float(frequency_hz(model.fit.poles)[model.strongest])
    found = _misfit(model.problem, model.fit.linear, cycle_s)
    if not model.unresolved:
        return found
    poles = list(model.fit.poles)
    for pair in model.unresolved:
        del poles[int(np.argmin(np.abs(np.array(poles) - pair[0])))]
        poles += list(pair)
    functions = mode_functions(model.data.time_s, np.array(poles))
    both = _misfit(model.problem, solve_linear(model.problem, functions), cycle_s)
    return min(found, both, key=lambda one: one.share)


def _misfit(problem: Problem, linear: LinearSolution, cycle_s: float) -> Misfit:
    data = problem.data
    length = max(_LEAST_ROWS, int(np.ceil(cycle_s / data.step_s)))
    starts = np.arange(0, data.time_s.size, length)
    weights = data.weights / linear.noise_variance
    used = np.add.reduceat(np.count_nonzero(data.weights > 0.0, axis=1), starts)
    left = np.add.reduceat(np.sum(weights * linear.residual**2, axis=1), starts)
    moved = np.add.reduceat(np.sum(weights * (data.values - linear.baseline) ** 2, axis=1), starts)
    count = np.maximum(used, 1)
    known = used >= 0.5 * length * data.values.shape[1]
    if not np.any(known):
        return Misfit(0.0, 0.0, 0.0)
    noise = float(np.quantile((left / count)[known], 0.25))
    excess = np.where(known, np.maximum(left - _NOISE * noise * count, 0.0), 0.0)
    total = max(float(np.sum(np.maximum(moved - noise * count, 0.0))), 1e-300)
    worst = int(np.argmax(excess))
    end = min(starts[worst] + length, data.time_s.size) - 1
    return Misfit(float(np.sum(excess)) / total, float(data.time_s[starts[worst]]), float(data.time_s[end]))

"""One mode of a fit by itself: the record averaged as far as the mode's frequency allows."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from modal_id.fit.modal_fit import ModalFit
from modal_id.solve import ModeColumns, Problem, frequency_hz, motion, solve_linear, thinning


@dataclass(frozen=True)
class Tuning:
    """The fit of one mode's own decay."""

    #: [1] factor on the averages per cycle that `thinning` chooses
    finer: float = 4.0 / 3.0
    #: [1] logarithm of the ratio of frequencies within which another mode is fitted beside it
    #: convention: The motion of the others is subtracted.
    close: float = 0.7


TUNING = Tuning()


def own_decay(model: ModalFit, mode: int) -> ModalFit:
    """The fit of the mode with this index, which comes first, and of those close to it, on fewer samples.

    At least sixteen averages a cycle of the mode lose 1.3 % of the information about it. The noise of a sample of
    weight 1 is that of these averages.
    """
    fit, data = model.fit, model.data
    hz = frequency_hz(fit.poles)
    close = np.abs(np.log(hz / hz[mode])) < TUNING.close
    close[mode] = False
    order = np.append(mode, np.flatnonzero(close))
    factor = max(thinning(data.time_s, fit.poles[[mode]] * TUNING.finer), 1)
    problem = Problem(replace(data, values=fit.linear.residual), model.problem.sparse)
    problem = problem.thinned(factor) if factor > 1 else problem
    # Each average of the motion is that of a whole block of even samples with equal weights, a constant factor on the
    # motion at its mean time: uneven ones would move it. The averages of what the fit leaves have the same factor.
    seen, poles = problem.data, fit.poles[order]
    offsets_s = float(np.median(np.diff(data.time_s))) * (np.arange(factor) - 0.5 * (factor - 1))
    factors = np.mean(np.exp(np.outer(offsets_s, poles)), axis=0)
    moved = motion(seen.time_s, poles, factors[:, None] * fit.linear.amplitudes[order])
    problem = Problem(replace(seen, values=seen.values + moved), problem.sparse)
    linear = solve_linear(problem, ModeColumns(seen.time_s, poles))
    both = np.stack([2 * order, 2 * order + 1], axis=1).ravel()
    own = replace(fit, poles=poles, linear=linear, covariance=fit.covariance[np.ix_(both, both)])
    return replace(model, problem=problem, fit=own, repeating=None)

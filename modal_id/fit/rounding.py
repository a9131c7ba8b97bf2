"""Values rounded to multiples of a step, as by a coarse converter or a tracker of whole pixels.

The error is a function of the value whose period is the step: it returns with the motion and does not average out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from modal_id.fit.model_order import ModalFit, refit
from tracker import DisplacementSeries, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Rounding."""

    #: [1] share of the samples that may differ from each other where values are rounded coarsely
    #: convention: Finer steps are below the noise.
    different: float = 0.25
    #: [steps] distance of a value from a multiple of the step that is a rounding error of the number itself
    exact: float = 1e-3
    #: [1] factor by which noise reduces the errors that return, below which they are ignored
    #: convention: They are then below a tenth of the other half of the error, which is noise.
    least: float = 0.1
    #: [1] number of simulated records
    #: statistics: Their standard deviation is known to a fifth.
    records: int = 16


TUNING = Tuning()


def with_rounding_errors(model: ModalFit, series: DisplacementSeries, channels: NDArray[np.intp]) -> ModalFit:
    """The fit with the errors that rounding causes in its poles, added to ``repeating``.

    The standard deviations are those of fits of the same motion, about other values, rounded to the same step.

    Parameters
    ----------
    series : DisplacementSeries
        Its values are examined.
    channels : int array, shape (k,)
        Index in the series of each channel of `model`.

    Notes
    -----
    Noise of standard deviation s reduces the part of the error that returns with the motion by the factor
    ``exp(-2 pi^2 s^2 / step^2)``. Widrow, Kollar & Liu, IEEE Trans. Instrum. Meas. 45 (1996) 353,
    doi:10.1109/19.492748.
    """
    linear, data = model.fit.linear, model.data
    steps = np.array([_step(series.values[:, channel]) for channel in channels])
    noise = np.sqrt(np.maximum(linear.noise_variance - steps**2 / 12.0, 0.0))
    # the same as exp(-2 pi^2 (noise / step)^2) > least
    reach = float(np.sqrt(-np.log(TUNING.least) / 2.0)) / np.pi
    coarse = np.flatnonzero((steps > 0.0) & (noise < reach * steps))
    if not coarse.size:
        return model
    rng = np.random.default_rng(0)
    fitted, shifts = data.values - linear.residual, []
    for _ in range(TUNING.records):
        values = fitted + noise * rng.standard_normal(fitted.shape)
        about = steps * rng.random(steps.size)
        rounded = values.copy()
        of_step = (values[:, coarse] + about[coarse]) / steps[coarse]
        rounded[:, coarse] = steps[coarse] * np.round(of_step) - about[coarse]
        shift = refit(model, model.fit.poles, replace(data, values=rounded)).fit.poles - model.fit.poles
        shifts.append(np.column_stack([shift.real, shift.imag]).ravel())
    more = np.array(shifts).T @ np.array(shifts) / TUNING.records
    return replace(model, repeating=more if model.repeating is None else model.repeating + more)


def _step(values: FloatArray) -> float:
    """Step of which all values are multiples, but for an offset; 0 where they are not rounded coarsely."""
    finite = values[np.isfinite(values)]
    different = np.unique(finite)
    if not 2 < different.size < TUNING.different * finite.size:
        return 0.0
    apart = np.diff(different)
    apart = apart[apart > 1e-9 * float(np.max(np.abs(different)))]
    step = float(np.min(apart, initial=np.inf))
    places = (different - different[0]) / step
    return step if np.all(np.abs(places - np.round(places)) < TUNING.exact) else 0.0

"""Error of a slow correction of the image's scale: an error of all decay rates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from modal_id.fit.model_order import ModalFit
from tracker import ScaleChange


def with_scale_errors(model: ModalFit, change: ScaleChange, start_s: float) -> ModalFit:
    """The fit with the error of the scale in the covariance of its poles; `start_s` is its first time in the series.

    A relative error that changes slowly grows or decays all modes alike: the decay rate of each is wrong by the slope
    of the error where the mode is strong, its frequency is not.
    """
    poles, data = model.fit.poles, model.data
    used = np.any(data.weights > 0.0, axis=1)
    time_s, size = data.time_s[used], np.zeros((2 * poles.size, change.root.shape[1]))
    for index, pole in enumerate(poles):
        power = np.exp(2.0 * np.minimum(pole.real, 0.0) * time_s)
        size[2 * index] = change.rate_errors(start_s + time_s, power)
    known = 0.0 if model.repeating is None else model.repeating
    return replace(model, repeating=known + size @ size.T)

"""Whether modes close to each other imitate one that is interrupted: a pluck within a record beats like a pair."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from modal_id.fit.model_order import ModalFit
from modal_id.modes.decays import FittedDecay
from modal_id.segments.steadiness import close_modes
from tracker.arrays import BoolArray


def single_modes(model: ModalFit) -> ModalFit | None:
    """The fit with only the strongest of each set of close modes; None where no modes are close."""
    energy = model.energy
    kept = np.array(
        [bool(np.all(one >= energy[close])) for one, close in zip(energy, close_modes(model), strict=True)]
    )
    return None if np.all(kept) else _only(model, kept)


def _only(model: ModalFit, kept: BoolArray) -> ModalFit:
    fit = model.fit
    linear = replace(fit.linear, amplitudes=fit.linear.amplitudes[kept])
    return replace(model, fit=replace(fit, poles=fit.poles[kept], linear=linear))


def is_rather_interrupted(whole: FittedDecay, parts: tuple[FittedDecay, ...]) -> bool:
    """Whether the parts explain the samples that they share with the whole better, by the information criterion."""
    rows = np.isin(whole.rows, np.concatenate([part.rows for part in parts]))
    if any(part.moving.tolist() != whole.moving.tolist() for part in parts):
        return False
    linear = whole.model.fit.linear
    weights = whole.model.data.weights / linear.noise_variance
    together = float(np.sum((weights * linear.residual**2)[rows]))
    apart = sum(
        float(np.sum(part.model.data.weights / linear.noise_variance * part.model.fit.linear.residual**2))
        for part in parts
    )
    count = float(np.count_nonzero(whole.model.data.weights[rows]))
    parameters = [_parameters(one.model) for one in (whole, *parts)]
    more = sum(parameters[1:]) + 1.0 - parameters[0]
    return bool(count * np.log(together / max(apart, 1e-300)) > more * np.log(count))


def _parameters(model: ModalFit) -> float:
    channels = model.data.values.shape[1]
    return float(model.fit.poles.size * (2 + 2 * channels) + channels * model.problem.baseline.shape[1])

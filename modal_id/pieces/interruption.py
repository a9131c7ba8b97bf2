"""Whether modes close to each other imitate one that is interrupted: a pluck within a record beats like a pair."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from modal_id.data import FitData
from modal_id.fit import ModalFit
from modal_id.modes import FittedDecay
from modal_id.segments import close_modes
from modal_id.solve import frequency_hz
from tracker import BoolArray


@dataclass(frozen=True)
class Tuning:
    """Interruptions of a decay."""

    #: [1] fewest close modes that together describe a transient
    #: convention: A step or a stop.
    transient_modes: int = 3
    #: [cycles] largest number of cycles of each of these modes
    few_cycles: float = 12.0
    #: [1] rms of a channel at rest over that of the motion that follows
    rest_share: float = 0.2


TUNING = Tuning()


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


def is_transient(model: ModalFit) -> bool:
    """Whether several close modes of few cycles each imitate a step or a stop, which no decay does."""
    few = frequency_hz(model.fit.poles) * model.data.span_s < TUNING.few_cycles
    alike = np.count_nonzero(close_modes(model)[few][:, few], axis=1)
    return bool(np.any(alike >= TUNING.transient_modes))


def rests_until(data: FitData, time_s: float) -> bool:
    """Whether each channel moves by less than a small share of its later motion until a time: before a release."""
    moves = []
    for rows in (data.time_s < time_s, data.time_s >= time_s):
        weights = data.weights[rows]
        total = np.maximum(np.sum(weights, axis=0), 1e-300)
        centred = data.values[rows] - np.sum(weights * data.values[rows], axis=0) / total
        moves.append(np.sqrt(np.sum(weights * centred**2, axis=0) / total))
    return bool(np.all(moves[0] < TUNING.rest_share * moves[1]))


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
    # A part alone gains by all of its modes, because those of the whole must fit the rest of the record, too.
    more = 1.0 + sum(_mode_parameters(part.model) + _splines(part.model) for part in parts)
    more -= float(np.mean(rows)) * _splines(whole.model)
    more -= _mode_parameters(whole.model) if len(parts) > 1 else 0.0
    return bool(count * np.log(together / max(apart, 1e-300)) > more * np.log(count))


def _mode_parameters(model: ModalFit) -> float:
    return float(model.fit.poles.size * (2 + 2 * model.data.values.shape[1]))


def _splines(model: ModalFit) -> float:
    return float(model.data.values.shape[1] * model.problem.baseline.shape[1])

"""Whether a motion keeps its amplitude, as a driven one does, or decays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modal_id.data import FitData, rough_variance
from modal_id.fit import ModalFit, find_modes
from modal_id.segments.drive_odds import PRIOR, drive_probability, is_rather_driven
from modal_id.solve import PoleFit, Problem, damping_ratio, fit_poles, frequency_hz
from tracker import BoolArray


@dataclass(frozen=True)
class Tuning:
    """Steady motion."""

    #: [1] largest number of modes of the fit
    modes: int = 4
    #: [1] relative distance from the frequency looked for within which a line is the dominant one
    same_line: float = 0.05
    #: [1] amplitude over the strongest from which a line must be steady
    strong: float = 0.2
    #: [1] fall of the log amplitude from which it decays
    decayed: float = 0.5
    #: [beats] modes with fewer beats in the record are close
    #: physics: One mode whose amplitude changes may imitate them.
    close_beats: float = 4.0
    #: [1] share of the power that the fit of a free decay may leave
    most_left: float = 0.05
    #: [1] share from which the fit tells nothing of a drive
    unexplained: float = 0.3


TUNING = Tuning()

# Standard deviations of a rate beyond which a line decays.
_DECAY_SD = 3.0


def probability_of_drive(
    data: FitData, line_hz: float, lowest_hz: float, prior: float, follows: FitData | None = None
) -> float:
    """Probability that the line at this frequency is driven, from the change of its amplitude over the data.

    All modes are fitted, because the residual of a weaker mode would hide a slow decay. 0 where the fit fails.
    `follows` is the motion after a change.
    """
    data, fit, index = _line(data, line_hz, lowest_hz)
    if not fit.converged:
        return 0.0
    later = None
    if follows is not None:
        _, after, line = _line(follows, line_hz, lowest_hz)
        later = float(damping_ratio(complex(after.poles[line]))) if after.converged else None
    return _probability(data, fit, index, prior, later)


def decays(data: FitData, line_hz: float, lowest_hz: float) -> bool:
    """Whether the line at this frequency decays significantly, and free decays leave little beside it."""
    data, fit, index = _line(data, line_hz, lowest_hz)
    sd = float(fit.pole_sd[index, 0]) * _noise_factor(data, fit, index)
    decays_ = -float(fit.poles[index].real) > _DECAY_SD * sd
    return fit.converged and decays_ and _left(data, fit) < TUNING.most_left


def _left(data: FitData, fit: PoleFit) -> float:
    """Share of the power of the motion that a fit leaves beyond noise."""
    centred = data.values - np.mean(data.values, axis=0)
    left = float(np.sum(np.maximum(fit.linear.rss - rough_variance(data) * data.counts, 0.0)))
    return left / max(float(np.sum(data.weights * centred**2)), 1e-300)


def _line(data: FitData, line_hz: float, lowest_hz: float) -> tuple[FitData, PoleFit, int]:
    """Fit of all modes, or of one, and the index of the mode at this frequency."""
    model = find_modes(data, TUNING.modes, lowest_hz)
    if model is not None:
        distance = np.abs(frequency_hz(model.fit.poles) / line_hz - 1.0)
        index = int(np.argmin(distance))
        if distance[index] < TUNING.same_line:
            return model.data, model.fit, index
    start = np.array([-1e-3 / max(data.span_s, 1e-9) + 2j * np.pi * line_hz])
    return data, fit_poles(Problem(data, np.ones((data.time_s.size, 1))), start), 0


def keeps_amplitude(model: ModalFit, follows: ModalFit | None) -> bool:
    """Whether the strongest mode of a fit is rather driven than free, before another motion, where that has a fit."""
    pole, index = complex(model.fit.poles[model.strongest]), model.strongest
    later = None
    if follows is not None:
        near = np.abs(frequency_hz(follows.fit.poles) / float(frequency_hz(pole)) - 1.0)
        if np.min(near) < TUNING.same_line:
            later = float(damping_ratio(complex(follows.fit.poles[int(np.argmin(near))])))
    return is_rather_driven(_probability(model.data, model.fit, index, PRIOR, later))


def close_modes(model: ModalFit) -> BoolArray:
    """Which modes of a fit are close to each other, and to themselves; shape (modes, modes)."""
    hz = frequency_hz(model.fit.poles)
    return np.asarray(np.abs(hz[:, None] - hz) < TUNING.close_beats / model.data.span_s)


def holds_a_decay(model: ModalFit) -> bool:
    """Whether one of the stronger modes of a fit decays significantly, to less than two thirds.

    Close modes are one driven motion whose amplitude changes.
    """
    fit = model.fit
    strength = np.max(np.abs(fit.linear.amplitudes), axis=1)
    alone = np.count_nonzero(close_modes(model), axis=1) == 1
    for index in np.flatnonzero(alone & (strength > TUNING.strong * np.max(strength))).tolist():
        rate, sd = -float(fit.poles[index].real), float(fit.pole_sd[index, 0])
        if rate * model.data.span_s > TUNING.decayed and rate > _DECAY_SD * sd * _noise_factor(
            model.data, fit, index
        ):
            return True
    return False


def _probability(data: FitData, fit: PoleFit, index: int, prior: float, follows: float | None) -> float:
    if _left(data, fit) > TUNING.unexplained:
        # What free decays do not explain tells nothing of one of them.
        return prior
    pole, span_s = complex(fit.poles[index]), data.span_s
    sd = float(fit.pole_sd[index, 0]) * _noise_factor(data, fit, index)
    return drive_probability(-pole.real * span_s, sd * span_s, abs(pole) * span_s, prior, follows)


def _noise_factor(data: FitData, fit: PoleFit, index: int) -> float:
    """Residual spectrum beside the line relative to white noise, as a factor on standard deviations, at least 1."""
    centre = float(fit.poles[index].imag) / (2.0 * np.pi)
    aside = np.array([-6.5, -5.5, -4.5, -3.5, -2.5, 2.5, 3.5, 4.5, 5.5, 6.5]) / max(data.span_s, 1e-300)
    waves = np.exp(-2j * np.pi * (centre + aside)[:, None] * data.time_s)
    power = np.mean(np.abs(waves @ (data.weights * fit.linear.residual)) ** 2, axis=0)
    white = np.maximum(fit.linear.noise_variance * np.sum(data.weights**2, axis=0), 1e-300)
    return float(np.sqrt(max(float(np.max(power / white)), 1.0)))

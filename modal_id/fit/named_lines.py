"""Modes at frequencies that the user names, where the search for lines has found none.

The user may have chosen the highest of all peaks of the spectrum. A named line must therefore exceed what noise makes
in any line of the spectrum; it need not exceed the threshold of the search, which is higher.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from modal_id.data import FitData, bandwidth_hz, baseline_splines
from modal_id.fit.modal_fit import OWN_BAND, ModalFit
from modal_id.fit.model_order import is_significant, refit, start_pole, with_line
from modal_id.fit.spectrum import LEVEL_BINS, SAME_LINE, Band, highest_near, nyquist_hz
from modal_id.sentences import Reason, Refusal
from modal_id.solve import (
    ModeColumns,
    PoleFit,
    Problem,
    damping_ratio,
    frequency_hz,
    no_columns,
    objective,
    rough_poles,
    solve_linear,
)
from tracker import ComplexArray


@dataclass(frozen=True)
class Tuning:
    """Lines whose frequency is given."""

    #: [bins] distance from a given frequency within which a line has that name, where a bin is 1 / span of the record
    #: physics: The resolution of the record.
    named_bins: float = 2.0
    #: [1] damping ratio above which it is no line
    #: convention: What decays faster is sought by `damped`; the noise about it is not that at its frequency.
    most_damped: float = 0.1


TUNING = Tuning()


def with_named(model: ModalFit | None, data: FitData, named_hz: Sequence[float]) -> ModalFit | None:
    """Add a mode at each named frequency at which the model has none and the data have one.

    The result has the reason for each that is refused. It is `model` where nothing is named, and None where neither the
    search nor the names give a mode.
    """
    if not named_hz:
        return model
    current = _still(data, min(named_hz)) if model is None else model
    for hz in named_hz:
        if not np.any(np.abs(frequency_hz(current.fit.poles) - hz) < _reach_hz(hz, data)):
            current = _with_one(current, hz)
    if not current.fit.poles.size:
        return None
    order = np.argsort(frequency_hz(current.fit.poles))
    return current if current is model else refit(current, current.fit.poles[order], current.data)


def _with_one(model: ModalFit, hz: float) -> ModalFit:
    reason = _no_line_there(model, hz)
    if reason is None:
        joint = _joint(model, hz)
        if joint is not None:
            return replace(joint, added_hz=(*model.added_hz, hz))
        reason = Reason.NAMED_IS_NOISE(hz=hz)
    return replace(model, refused=(*model.refused, (hz, reason)))


def _no_line_there(model: ModalFit, hz: float) -> Refusal | None:
    """Why no line of its own can be sought at a frequency, or None."""
    near = [f for f in frequency_hz(model.fit.poles) if abs(f - hz) < OWN_BAND * f]
    nyquist, lowest_hz = nyquist_hz(model.data.time_s), model.lowest_line_hz
    if near:
        return Reason.NAMED_IS_CLOSE(hz=hz, mode_hz=near[0])
    if hz >= nyquist:
        return Reason.NAMED_ABOVE_NYQUIST(hz=hz, nyquist_hz=nyquist)
    if model.fit.poles.size and hz < lowest_hz:
        return Reason.NAMED_IS_DRIFT(hz=hz, lowest_hz=lowest_hz)
    return None


def _joint(model: ModalFit, hz: float) -> ModalFit | None:
    """The model with a mode near a frequency; None where noise explains it."""
    data, linear = model.data, model.fit.linear
    left = Problem(replace(data, values=linear.residual), model.problem.baseline)
    tried = highest_near(data, linear.residual, linear.noise_variance, Band(hz, SAME_LINE * hz))
    starts = [rough_poles(left, start_pole(candidate)) for candidate in tried]
    starts = [start for start in starts if _is_near(complex(start[0]), hz, data)]
    if not starts:
        return None
    joint = with_line(model, min(starts, key=lambda start: _misfit(left, start)))
    if joint is None or not _is_near(complex(joint.fit.poles[-1]), hz, data):
        return None
    channels = data.values.shape[1]
    level = joint.spectrum.level(hz) / channels
    return joint if is_significant(model, joint, level, LEVEL_BINS * channels, len(tried)) else None


def _misfit(left: Problem, start: ComplexArray) -> float:
    return objective(left.data, solve_linear(left, ModeColumns(left.data.time_s, np.atleast_1d(start))))


def _is_near(pole: complex, hz: float, data: FitData) -> bool:
    frequency, damping = float(frequency_hz(pole)), float(damping_ratio(pole))
    return abs(frequency - hz) < _reach_hz(hz, data) and abs(damping) < TUNING.most_damped


def _reach_hz(hz: float, data: FitData) -> float:
    return max(SAME_LINE * hz, TUNING.named_bins / max(data.span_s, 1e-300))


def _still(data: FitData, lowest_hz: float) -> ModalFit:
    """A model without modes."""
    bandwidth = bandwidth_hz(lowest_hz)
    problem = Problem(data, baseline_splines(data.time_s, bandwidth))
    linear = solve_linear(problem, no_columns(data.time_s))
    return ModalFit(
        problem, PoleFit(np.empty(0, dtype=complex), linear, np.zeros((0, 0)), converged=True), bandwidth
    )

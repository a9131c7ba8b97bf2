"""Slow motion faster than the baseline, whose spectrum leaks into the modes above it: widen the baseline."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modal_id.data import RELATIVE_BANDWIDTH
from modal_id.fit.spectrum import ResidualSpectrum
from modal_id.solve import PoleFit, Problem, damping_ratio, frequency_hz
from tracker import BoolArray, ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """What is slow motion and no mode."""

    #: [1] share of the noise level at a mode that slow motion may contribute
    leak: float = 0.02
    #: [cycles] number of cycles below which a motion may be a swing on soft supports or by hand
    few_cycles: float = 15.0
    #: [1] largest frequency of a swing over that of the lowest mode
    #: physics: A beam's first mode lies at a sixth of the second.
    far_below: float = 0.1
    #: [1] damping ratio from which a low frequency with few cycles is a swing
    #: convention: A beam's first mode is weakly damped.
    strongly_damped: float = 0.02
    #: [1] largest number of splines of the slow motion
    max_splines: int = 300


TUNING = Tuning()


def wider_baseline(
    problem: Problem, fit: PoleFit, bandwidth_hz: float, spectrum: ResidualSpectrum
) -> tuple[ComplexArray, float] | None:
    """Poles to keep and a wider bandwidth of the baseline, or None where the present bandwidth suffices.

    In a record of length T, motion left in the residual at a low frequency f leaks ``1 / (pi (f_n - f) T)^2`` of its
    power to a mode at f_n, on average half of that. Where this exceeds 2 % of the noise there, the baseline is extended
    to 0.4 of the lowest mode's frequency. `spectrum` is that of the residual.
    """
    span = problem.data.span_s
    swing = _swings(fit, span)
    kept = fit.poles[~swing]
    lowest = float(np.min(frequency_hz(kept)))
    cap = min(RELATIVE_BANDWIDTH * lowest, 0.5 * TUNING.max_splines / span)
    if 1.2 * bandwidth_hz > cap or _leak(spectrum, span, frequency_hz(kept)) < TUNING.leak:
        return None
    return kept, cap


def _swings(fit: PoleFit, span_s: float) -> BoolArray:
    """Mask of strongly damped motions of a few cycles, far below all other modes."""
    all_hz = frequency_hz(fit.poles)
    has_few_cycles = all_hz * span_s < TUNING.few_cycles
    if np.all(has_few_cycles):
        return np.zeros(all_hz.size, dtype=bool)
    low = all_hz < TUNING.far_below * float(np.min(all_hz[~has_few_cycles]))
    return np.asarray(has_few_cycles & low & (damping_ratio(fit.poles) > TUNING.strongly_damped))


def _leak(spectrum: ResidualSpectrum, span_s: float, modes_hz: FloatArray) -> float:
    """Largest share of the residual level at a mode that has leaked from far below it."""
    frequency, power = spectrum.frequency_hz, spectrum.power
    worst = 0.0
    for mode in modes_hz:
        below = frequency < RELATIVE_BANDWIDTH * mode
        distance = np.pi * (mode - frequency[below]) * span_s
        # Every second bin is independent.
        leaked = 0.5 * 0.5 * float(np.sum(power[below] / distance**2))
        worst = max(worst, leaked / max(spectrum.level(float(mode)), 1e-300))
    return worst

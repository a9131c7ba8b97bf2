"""Whether a base that stopped dead, or a force that ended, explains a recording: `stop`'s strict models."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from modal_id.onset.piecewise import Kink, Solution, descend, scan, solve
from modal_id.onset.stop_search import FIRST_STEPS, HOPELESS, MINIMA, instants_within, lowest, moved_to
from modal_id.onset.stop_shapes import stopped_shape, unpacked_poles
from tracker.arrays import BoolArray, ComplexArray, FloatArray

FALSE_ALARM = 0.01
# A side whose residual exceeds the noise by more than this is not steady (or not one decay) all along: less of it is
# used.
MISFIT = 1.2
# Share of the base's velocity in the shaken mode at the marker that moves most, for first guesses: 1.57, 0.87, 0.51,
# 0.36, 0.28 for a cantilever's modes at the tip.
_GUESSES = (1.2, 0.4)


@dataclass(frozen=True)
class MechanicalModel:
    """A mechanical model that the data allow."""

    kink: Kink
    solution: Solution
    kick: bool


def mechanical_models(
    loose: Kink, best: Solution, base: BoolArray, reach_s: float, weak: ComplexArray, *, trend: bool
) -> list[MechanicalModel]:
    """Mechanical models that fit as well as their fewer parameters let expect: base stopped, force ended."""
    noise = max(best.chi_square / np.count_nonzero(loose.data.weights), 1.0)
    if noise > MISFIT:
        # Where even free amplitudes and phases do not fit, a stricter model is no better founded for failing likewise.
        return []
    for unseen in (False, True):
        allowed = []
        for kick, gains in ((True, _gains(base)), (False, [np.zeros(base.size)])):
            shape = stopped_shape(loose.data.time_s, weak, kick=kick, trend=trend, unseen=unseen)
            found = _mechanical(replace(loose, shape=shape), best, gains, reach_s, trend=trend)
            if found is None:
                continue
            fewer = best.coefficients.size - found[1].coefficients.size - 2
            worse = (found[1].chi_square - best.chi_square) / noise
            if worse < float(chi2.isf(FALSE_ALARM, max(fewer, 1))):
                allowed.append(MechanicalModel(*found, kick))
        if allowed:
            return sorted(allowed, key=lambda one: one.solution.chi_square)
    return []


def _gains(base: BoolArray) -> list[FloatArray]:
    """How the base's motion enters the channels: a reference that stands still follows no base."""
    if np.any(base):
        return [np.where(base, 1.0, 0.0), np.where(base, 0.0, 1.0)]
    return [np.ones(base.size)]


def _mechanical(
    model: Kink, best: Solution, gains: list[FloatArray], reach_s: float, *, trend: bool
) -> tuple[Kink, Solution] | None:
    found = []
    for gain in gains:
        for amplitude in _amplitudes(model, best, gain, trend=trend):
            size = abs(amplitude)
            scale = np.concatenate([model.scale[:2], [size, size], model.scale[2:]])
            kink = replace(model, gain=gain, scale=scale)
            pair = np.array([amplitude.real, amplitude.imag])
            first = solve(kink, np.concatenate([best.nonlinear[:2], pair, best.nonlinear[2:]]))
            if first is not None:
                found.append((kink, descend(kink, first, FIRST_STEPS)))
    if not found:
        return None
    kink, solution = min(found, key=lambda pair: pair[1].chi_square)
    # The same drive, stopped sooner or later: where the looser model cannot tell one cycle from the next, this can.
    starts = [moved_to(solution.nonlinear, t) for t in instants_within(kink, solution.nonlinear, reach_s)]
    near = [one for one in scan(kink, starts, MINIMA) if one.chi_square < solution.chi_square + HOPELESS]
    others = [descend(kink, one, FIRST_STEPS) for one in near]
    best_near = lowest([solution, *others])
    return None if best_near is None else (kink, descend(kink, best_near))


def _amplitudes(loose: Kink, best: Solution, gain: FloatArray, *, trend: bool) -> list[complex]:
    """First guesses of the base's complex amplitude at the stop."""
    coefficients = best.coefficients
    driven = coefficients[1 + trend] - 1j * coefficients[2 + trend]
    if np.any(gain == 0.0) and np.any(gain == 1.0):
        return [complex(np.mean(driven[gain == 1.0]))]
    drive, pole = float(best.nonlinear[1]), complex(unpacked_poles(best.nonlinear[2:4])[0])
    response = drive**2 / (abs(pole) ** 2 - drive**2 - 2j * pole.real * drive)
    loudest = int(np.argmax(np.abs(driven) ** 2 / loose.variance))
    return [
        complex(driven[loudest] / (1.0 + sign * share * response)) for share in _GUESSES for sign in (1, -1)
    ]

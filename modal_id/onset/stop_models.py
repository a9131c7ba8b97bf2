"""Models of a marker's motion while steady shaking stops, and the selection among them.

Nonlinear parameters of the joined model: instant, drive frequency in rad/s, (Re, Im) of each pole. The mechanical
models have (Re, Im) of the base's complex amplitude before the poles.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from modal_id.fit.linear import real_columns
from modal_id.onset.piecewise_fit import (
    FIRST_STEPS,
    LARGEST_GAIN,
    MINIMA,
    Columns,
    PiecewiseFit,
    PiecewiseProblem,
    descend,
    instants_within,
    lowest,
    scan,
    solve,
)
from tracker.arrays import BoolArray, ComplexArray, FloatArray

FALSE_ALARM = 0.01
# Where the mean square residual of a side exceeds the noise by more than this factor, the shaking is not steady (or the
# decay not free) throughout, and less of that side is used.
MISFIT = 1.2
# Participation of the excited mode at the marker that moves most, as starting values: 1.57, 0.87, 0.51, 0.36, 0.28 for
# the modes of a cantilever at the tip.
_PARTICIPATION = (1.2, 0.4)
# Relative uncertainty of a theoretical frequency.
_FREQUENCY_UNCERTAINTY = 0.03


def unpacked_poles(nonlinear: FloatArray) -> ComplexArray:
    """Poles from pairs of real and imaginary part."""
    return np.asarray(nonlinear[0::2] + 1j * nonlinear[1::2])


def joined_model(time_s: FloatArray, *, trend: bool) -> Callable[[FloatArray], Columns]:
    """Sinusoid, then free decays: amplitudes and phases free, displacement continuous."""

    def model(nonlinear: FloatArray) -> Columns:
        stop, drive, poles = float(nonlinear[0]), float(nonlinear[1]), unpacked_poles(nonlinear[2:])
        since = time_s - stop
        after = since >= 0.0
        free = np.where(after[:, None], _decays(np.maximum(since, 0.0), poles), 0.0)
        columns = real_columns(free)
        # Continuity determines the in-phase part of the excited mode.
        tied = columns[:, 0].copy()
        columns[:, 2::2] -= tied[:, None]
        age = np.minimum(time_s, stop) - time_s[0]
        on = real_columns(_decays(age, poles[:1]))
        on[after] *= tied[after][:, None]
        driven = np.where(after, tied, np.cos(drive * since))
        quadrature = np.where(after, 0.0, np.sin(drive * since))
        offset = np.where(after, 1.0 - tied, 0.0)
        slow = _slow(since, trend=trend)
        return Columns(
            np.column_stack([slow, driven, quadrature, on, columns[:, 1:], offset]), np.zeros(since.size)
        )

    return model


def mechanical_model(
    time_s: FloatArray, weak: ComplexArray, *, base_stops: bool, trend: bool, unseen: bool
) -> Callable[[FloatArray], Columns]:
    """The equations of `modal_id.onset.stop_instant`; nonlinear parameters: instant, drive, Re B, Im B, poles.

    Without `base_stops` a force on the structure ends instead: the base rests throughout, no velocity jumps, and B
    stands for the force. With `unseen`, each channel has a component proportional to the base's motion before the stop:
    undetected modes far from the drive respond in phase or in antiphase.
    """

    def model(nonlinear: FloatArray) -> Columns:
        stop, drive = float(nonlinear[0]), float(nonlinear[1])
        poles = np.concatenate([unpacked_poles(nonlinear[4:]), weak])
        amplitude = complex(nonlinear[2], nonlinear[3])
        since = time_s - stop
        after = since >= 0.0
        wave = np.exp(1j * drive * np.minimum(since, 0.0))
        base = np.real(amplitude * wave)
        velocity = (1j * drive * amplitude).real if base_stops else 0.0
        own = np.abs(poles) ** 2
        steady = amplitude * drive**2 / (own - drive**2 - 2j * poles.real * drive)
        position, speed = steady.real, (1j * drive * steady).real + velocity
        free_amplitude = position - 1j * (speed - poles.real * position) / poles.imag
        late = np.maximum(since, 0.0)
        free = np.real(_decays(late, poles) * free_amplitude)
        # A mode with a frequency from theory only soon has an unknown phase: its expectation over the phase decays.
        phase_sd = _FREQUENCY_UNCERTAINTY * np.abs(weak) * late[:, None]
        free[:, poles.size - weak.size :] *= np.exp(-0.5 * np.minimum(phase_sd, 30.0) ** 2)
        columns = [_slow(since, trend=trend), np.where(after[:, None], free, np.real(wave[:, None] * steady))]
        if unseen:
            columns.append(np.where(after, 0.0, base)[:, None])
        return Columns(np.column_stack(columns), base)

    return model


def _decays(time_s: FloatArray, poles: ComplexArray) -> ComplexArray:
    """``exp(lambda t)``, with growth bounded so that a diverging pole gives a large misfit instead of an overflow."""
    growth = np.minimum(time_s[:, None] * poles.real, 50.0)
    return np.asarray(np.exp(growth + 1j * time_s[:, None] * poles.imag))


def _slow(since: FloatArray, *, trend: bool) -> FloatArray:
    columns = [np.ones(since.size), since / max(float(np.ptp(since)), 1e-300)]
    return np.column_stack(columns[: 1 + trend])


@dataclass(frozen=True)
class MechanicalModel:
    """A mechanical model that the data do not reject."""

    problem: PiecewiseProblem
    solution: PiecewiseFit
    base_stops: bool


def moved_to(nonlinear: FloatArray, instant_s: float) -> FloatArray:
    """Parameters of a mechanical model for the same drive, stopped at another instant."""
    amplitude = complex(nonlinear[2], nonlinear[3]) * np.exp(1j * nonlinear[1] * (instant_s - nonlinear[0]))
    return np.concatenate([[instant_s, nonlinear[1], amplitude.real, amplitude.imag], nonlinear[4:]])


def mechanical_models(
    loose: PiecewiseProblem,
    best: PiecewiseFit,
    base: BoolArray,
    reach_s: float,
    weak: ComplexArray,
    *,
    trend: bool,
) -> list[MechanicalModel]:
    """Mechanical models (base stopped, force ended) that a likelihood-ratio test does not reject, best first."""
    noise = max(best.chi_square / np.count_nonzero(loose.data.weights), 1.0)
    if noise > MISFIT:
        # Where even free amplitudes and phases do not fit, the test against them says nothing about a stricter model.
        return []
    for unseen in (False, True):
        allowed = []
        for base_stops, gains in ((True, _gains(base)), (False, [np.zeros(base.size)])):
            model = mechanical_model(
                loose.data.time_s, weak, base_stops=base_stops, trend=trend, unseen=unseen
            )
            found = _mechanical(replace(loose, model=model), best, gains, reach_s, trend=trend)
            if found is None:
                continue
            fewer = best.coefficients.size - found[1].coefficients.size - 2
            worse = (found[1].chi_square - best.chi_square) / noise
            if worse < float(chi2.isf(FALSE_ALARM, max(fewer, 1))):
                allowed.append(MechanicalModel(*found, base_stops))
        if allowed:
            return sorted(allowed, key=lambda one: one.solution.chi_square)
    return []


def _gains(base: BoolArray) -> list[FloatArray]:
    """Possible shares of the base's motion in the channels: its tracked marker may itself be the reference."""
    if np.any(base):
        return [np.where(base, 1.0, 0.0), np.where(base, 0.0, 1.0)]
    return [np.ones(base.size)]


def _mechanical(
    model: PiecewiseProblem, best: PiecewiseFit, gains: list[FloatArray], reach_s: float, *, trend: bool
) -> tuple[PiecewiseProblem, PiecewiseFit] | None:
    found = []
    for gain in gains:
        for amplitude in _amplitudes(model, best, gain, trend=trend):
            size = abs(amplitude)
            scale = np.concatenate([model.scale[:2], [size, size], model.scale[2:]])
            problem = replace(model, gain=gain, scale=scale)
            pair = np.array([amplitude.real, amplitude.imag])
            first = solve(problem, np.concatenate([best.nonlinear[:2], pair, best.nonlinear[2:]]))
            if first is not None:
                found.append((problem, descend(problem, first, FIRST_STEPS)))
    if not found:
        return None
    problem, solution = min(found, key=lambda pair: pair[1].chi_square)
    # The same drive, stopped earlier or later: this model distinguishes neighbouring cycles where the joined one
    # cannot.
    starts = [moved_to(solution.nonlinear, t) for t in instants_within(problem, solution.nonlinear, reach_s)]
    near = [
        one for one in scan(problem, starts, MINIMA) if one.chi_square < solution.chi_square + LARGEST_GAIN
    ]
    others = [descend(problem, one, FIRST_STEPS) for one in near]
    best_near = lowest([solution, *others])
    return None if best_near is None else (problem, descend(problem, best_near))


def _amplitudes(
    loose: PiecewiseProblem, best: PiecewiseFit, gain: FloatArray, *, trend: bool
) -> list[complex]:
    """Starting values of the base's complex amplitude at the stop."""
    coefficients = best.coefficients
    driven = coefficients[1 + trend] - 1j * coefficients[2 + trend]
    if np.any(gain == 0.0) and np.any(gain == 1.0):
        return [complex(np.mean(driven[gain == 1.0]))]
    drive, pole = float(best.nonlinear[1]), complex(unpacked_poles(best.nonlinear[2:4])[0])
    response = drive**2 / (abs(pole) ** 2 - drive**2 - 2j * pole.real * drive)
    strongest = int(np.argmax(np.abs(driven) ** 2 / loose.variance))
    return [
        complex(driven[strongest] / (1.0 + sign * share * response))
        for share in _PARTICIPATION
        for sign in (1, -1)
    ]

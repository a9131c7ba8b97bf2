"""Modes that decay within a few cycles: too broad for a line of the spectrum.

Waves ``exp(lambda t)`` on a grid of frequencies and decay rates, fitted to the beginning of the record together with an
offset and a trend, provide starting values. The fit is judged by the power that it removes.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from modal_id.data import OUTLIER_SD, FitData, bandwidth_hz, baseline_splines, rough_variance
from modal_id.fit.spectrum import LEAST_WINDOW, Candidate, nyquist_hz, power_spectrum, residual_spectrum
from modal_id.solve import (
    LinearSolution,
    ModeColumns,
    PoleFit,
    Problem,
    damping_ratio,
    fit_poles,
    frequency_hz,
    no_columns,
    objective,
    rough_poles,
    solve_linear,
    thinning,
)
from tracker import ComplexArray, FloatArray

MAX_DAMPING = 0.7


@dataclass(frozen=True)
class Tuning:
    """Strongly damped modes."""

    #: [1] score from which a strongly damped wave counts
    #: measurement: Random walks, creep and coloured noise reach 3; a mode of zeta 0.2 at 40 dB reaches thousands.
    least_score: float = 4.0
    #: [cycles] record of the fitted mode from which the score needs no allowance
    #: measurement: With fewer, such records reach up to 75 over the square of their number.
    many_cycles: float = 5.0
    #: [1] damping ratio from which a higher score is required
    #: measurement: Fits near critical damping reach several times more in random walks.
    nearly_critical: float = 0.4
    #: [1] factor on the score required there
    #: measurement: As above.
    nearly_critical_factor: float = 5.0
    #: [1] ratio of successive decay rates of the search
    rate_step: float = 1.7
    #: [half-widths] distance of successive frequencies of the search, in half-power half-widths
    frequency_step: float = 0.6
    #: [decay times] length of the part that is searched for a wave
    #: physics: exp(-10) of its energy is left.
    decay_times: float = 5.0
    #: [samples] fewest samples of a part to which a wave is fitted
    least_samples: int = 8


TUNING = Tuning()
LEAST_SAMPLES = TUNING.least_samples


_ZETA_RANGE = (0.02, 0.8)


@dataclass(frozen=True)
class DampedFit:
    """A fitted mode, its problem, and the bandwidth of the baseline in Hz."""

    problem: Problem
    fit: PoleFit
    bandwidth_hz: float


def fit_damped(data: FitData, residual: FloatArray, lowest_hz: float) -> DampedFit | None:
    """The strongly damped mode that explains the record best; None where none is significant.

    `residual`, shape (n, k), is the record less its offset and trend.
    """
    best: tuple[float, DampedFit] | None = None
    for start in _rough_poles(data, damped_candidates(data, residual, lowest_hz)):
        found = _fitted(data, start, lowest_hz)
        if found is None:
            continue
        parameters = data.values.shape[1] * (2.0 + found.problem.baseline.shape[1])
        criterion = objective(data, found.fit.linear) + 0.5 * parameters * np.log(data.time_s.size)
        if best is None or criterion < best[0]:
            best = criterion, found
    return None if best is None else best[1]


def damped_starts(problem: Problem, linear: LinearSolution, lowest_hz: float) -> list[complex]:
    """Poles of strongly damped modes that the residual of other modes may contain, the best first.

    Empty where no beginning of the data leaves more power than noise does.
    """
    data, residual = problem.data, linear.residual
    if not _exceeds_noise(data, linear):
        return []
    motion = replace(data, values=residual)
    found: list[tuple[float, complex]] = []
    for pole in _rough_poles(motion, damped_candidates(data, residual, lowest_hz)):
        wave = ModeColumns(data.time_s, np.array([pole]))
        found.append((objective(motion, solve_linear(Problem(motion, problem.baseline), wave)), pole))
    return [pole for _, pole in sorted(found, key=lambda one: one[0])]


def _exceeds_noise(data: FitData, linear: LinearSolution) -> bool:
    """Whether the first samples, of any number, leave more power than noise of the level of the later half."""
    power = data.weights * linear.residual**2
    half = data.time_s.size // 2
    level = np.sum(power[half:], axis=0) / np.maximum(np.count_nonzero(data.weights[half:], axis=0), 1)
    total = np.cumsum(np.sum(power / np.maximum(level, 1e-300), axis=1))
    count = np.cumsum(np.count_nonzero(data.weights, axis=1))
    return bool(np.any(total > count + OUTLIER_SD * np.sqrt(2.0 * count)))


def _rough_poles(data: FitData, candidates: Iterable[Candidate]) -> Iterator[complex]:
    """Rough poles of the candidates, each once."""
    found: list[complex] = []
    for candidate in candidates:
        pole = _rough(data, candidate)
        if pole is not None and all(abs(pole - other) >= 0.02 * abs(pole) for other in found):
            found.append(pole)
            yield pole


def _rough(data: FitData, candidate: Candidate) -> complex | None:
    part = beginning(data, candidate.decay_per_s)
    start: ComplexArray = np.array([-candidate.decay_per_s + 2j * np.pi * candidate.frequency_hz])
    centred = (part.time_s - 0.5 * part.span_s) / part.span_s
    pole = complex(rough_poles(Problem(part, np.stack([np.ones_like(centred), centred], axis=1)), start)[0])
    return pole if _is_damped(pole, data) else None


def _fitted(data: FitData, start: complex, lowest_hz: float) -> DampedFit | None:
    bandwidth = bandwidth_hz(abs(start) / (2.0 * np.pi))
    problem = Problem(data, baseline_splines(data.time_s, bandwidth))
    fit = fit_poles(problem, np.array([start]))
    pole = complex(fit.poles[0])
    if not fit.converged or not _is_damped(pole, data) or frequency_hz(pole) < lowest_hz:
        return None
    still = solve_linear(problem, no_columns(data.time_s))
    stands_out = is_above_noise(data, still.residual, fit.linear, pole)
    return DampedFit(problem, fit, bandwidth) if stands_out else None


def is_above_noise(data: FitData, before: FloatArray, linear: LinearSolution, pole: complex) -> bool:
    """Whether a strongly damped mode explains more of the residual without it, shape (n, k), than noise lets it."""
    score = damped_score(data, before, linear.residual, linear.noise_variance, pole)
    return score >= _least_score(pole, data.span_s)


def _least_score(pole: complex, span_s: float) -> float:
    few = max(1.0, TUNING.many_cycles / (float(frequency_hz(pole)) * span_s)) ** 2
    critical = float(damping_ratio(pole)) > TUNING.nearly_critical
    return TUNING.least_score * few * (TUNING.nearly_critical_factor if critical else 1.0)


def _is_damped(pole: complex, data: FitData) -> bool:
    below = frequency_hz(pole) < nyquist_hz(data.time_s)
    return bool(np.isfinite(pole) and 0.0 < float(damping_ratio(pole)) < MAX_DAMPING and below)


def damped_score(
    data: FitData, before: FloatArray, after: FloatArray, variance: FloatArray, pole: complex
) -> float:
    """Power that a fitted mode removes from the spectrum at its frequency, in units of the noise that remains there.

    Scaled like ``Candidate.score``: significant above 1.
    """
    last = data.time_s[0] - 3.0 / pole.real
    count = max(int(np.searchsorted(data.time_s, last, side="right")), min(LEAST_WINDOW, data.time_s.size))
    data, k, line_hz = data.rows(slice(0, count)), before.shape[1], pole.imag / (2.0 * np.pi)
    frequency, taken = power_spectrum(data.time_s, (before - after)[:count], data.weights, variance)
    left = residual_spectrum(data, after[:count], variance)
    power = float(taken[np.argmin(np.abs(frequency - line_hz))])
    return float(power / max(left.level(line_hz), 1e-300) * k / left.threshold)


def damped_candidates(data: FitData, residual: FloatArray, lowest_hz: float) -> list[Candidate]:
    """The wave that explains most, for each decay rate.

    `residual` has shape (n, k). Their score is 0: whether there is a mode is decided after its fit.
    """
    motion = replace(data, values=residual)
    nyquist = nyquist_hz(data.time_s)
    found = []
    rate = 4.0 / data.span_s
    while beginning(data, rate).time_s.size >= LEAST_SAMPLES:
        best = _best_wave(motion, rate, max(lowest_hz, 0.5 * rate / (2.0 * np.pi)), nyquist)
        if best is not None:
            found.append(best)
        rate *= TUNING.rate_step
    return found


def beginning(data: FitData, rate_per_s: float) -> FitData:
    """Samples that contain the energy of a wave of this decay rate."""
    return data.rows(slice(0, int(np.searchsorted(data.time_s, TUNING.decay_times / rate_per_s)) + 1))


def _best_wave(data: FitData, rate: float, lowest_hz: float, nyquist: float) -> Candidate | None:
    half_width = rate / (2.0 * np.pi)
    first = max(lowest_hz, half_width * float(np.sqrt(_ZETA_RANGE[1] ** -2 - 1.0)))
    grid = np.arange(first, min(nyquist, half_width / _ZETA_RANGE[0]), TUNING.frequency_step * half_width)
    if grid.size == 0:
        return None
    part, waves = beginning(data, rate), np.asarray(-rate + 2j * np.pi * grid, dtype=np.complex128)
    factor = thinning(part.time_s, waves)
    explained = _explained(part.averaged(factor) if factor > 1 else part, waves)
    return Candidate(float(grid[np.argmax(explained)]), rate, 0.0)


def _explained(data: FitData, poles: ComplexArray) -> FloatArray:
    """Sum of squares that each wave explains beyond offset and trend, in units of the channels' variances."""
    time = data.time_s
    waves = np.exp(time[:, None] * poles)
    variance = rough_variance(data)
    total = np.zeros(poles.size)
    for channel in range(data.values.shape[1]):
        root = np.sqrt(data.weights[:, channel])
        slow = np.linalg.qr(root[:, None] * np.stack([np.ones_like(time), time - np.mean(time)], axis=1))[0]
        real, imag = (root[:, None] * part for part in (waves.real, waves.imag))
        real, imag = (part - slow @ (slow.T @ part) for part in (real, imag))
        target = root * data.values[:, channel]
        target = target - slow @ (slow.T @ target)
        rr, ii, ri = np.sum(real**2, axis=0), np.sum(imag**2, axis=0), np.sum(real * imag, axis=0)
        u, v = real.T @ target, imag.T @ target
        determinant = rr * ii - ri**2
        usable = determinant > 1e-9 * rr * ii
        gain = (ii * u**2 - 2.0 * ri * u * v + rr * v**2) / np.where(usable, determinant, 1.0)
        total += np.where(usable, gain, 0.0) / variance[channel]
    return total

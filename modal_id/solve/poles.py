"""Poles of decaying modes: their frequency and damping ratio (Eq. 1), and their fit by variable projection (Eq. 2).

Yoo, Lee & Kim, "Tracking for high-order damping of thin beam oscillation": a mode moves as ``Re(c exp(lambda t))`` with
``lambda = -zeta w_n + i w_n sqrt(1 - zeta^2)``. The poles lambda are shared by all channels.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from modal_id.data import FitData
from modal_id.solve.cholesky import pseudo_inverse
from modal_id.solve.linear import LinearSolution, Problem, projected_grams, solve_linear
from modal_id.solve.maximum import MAX_ITERATIONS, shortened
from modal_id.solve.waves import ModeColumns, TimesTime, motion
from modal_id.solve.weighting import LongArray
from tracker import ComplexArray, FloatArray


def slope_weights(amplitudes: ComplexArray, slope: NDArray[np.intp], factor: ComplexArray) -> FloatArray:
    """Weights that combine real and imaginary parts of slopes into the derivatives of each channel.

    Parameter i changes channel k by ``Re(amplitudes[i, k] factor[i] s)``, where s is the function with index
    ``slope[i]``; `amplitudes` has shape (q, k), the result (k, 2 slopes, q).
    """
    result = np.zeros((amplitudes.shape[1], 2 * int(np.max(slope, initial=-1) + 1), slope.size))
    place = np.arange(slope.size)
    value = (amplitudes * factor[:, None]).T
    result[:, 2 * slope, place] = value.real
    result[:, 2 * slope + 1, place] = -value.imag
    return result


def normal_equations(
    problem: Problem, linear: LinearSolution, columns: LongArray, weights: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Fisher information of the parameters, shape (q, q), and gradient of the log likelihood, shape (q,).

    `columns`, shape (n, c), are the real and imaginary parts of the slopes; `weights`, shape (k, c, q), are from
    `slope_weights`.
    """
    q = weights.shape[2]
    information, gradient = np.zeros((q, q)), np.zeros(q)
    grams = projected_grams(problem, linear, columns)
    for (channels, _), (gram, score) in zip(problem.data.groups, grams, strict=True):
        own = weights[channels]
        weighted = own / linear.noise_variance[channels, None, None]
        information += np.tensordot(weighted, gram @ own, axes=((0, 1), (0, 1)))
        gradient += np.tensordot(weighted, score.T, axes=((0, 1), (0, 1)))
    return information, gradient


@dataclass(frozen=True)
class Tuning:
    """Convergence of the poles."""

    #: [sd] step that is negligible in a result
    #: statistics: Far below the sd that is printed.
    step_tolerance: float = 2e-3
    #: [sd] step that is negligible where a fit is refined later
    rough_tolerance: float = 0.05


TUNING = Tuning()
_STEP_TOLERANCE = TUNING.step_tolerance

# Largest logarithm of the growth over the record: products of four such waves do not overflow.
MOST_GROWTH = 0.25 * float(np.log(np.finfo(float).max))
# Largest decay rate per sample, that of critical damping at half the sampling rate: a motion that decays faster leaves
# one sample.
MOST_RATE_PER_SAMPLE = np.pi


@dataclass(frozen=True)
class PoleFit:
    """Fitted poles with the best amplitudes and baselines.

    Attributes
    ----------
    poles : complex array, shape (m,)
    linear : LinearSolution
    covariance : array, shape (2 m, 2 m)
        Of (Re, Im) of each pole in turn, for white noise.
    converged : bool
    """

    poles: ComplexArray
    linear: LinearSolution
    covariance: FloatArray
    converged: bool

    @property
    def pole_sd(self) -> FloatArray:
        """Standard deviations of Re and Im of each pole for white noise; shape (m, 2)."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0)).reshape(-1, 2)


def pole(omega_n_rad_s: float | FloatArray, zeta: float | FloatArray) -> ComplexArray:
    """Pole ``-zeta w_n + i w_n sqrt(1 - zeta^2)`` in 1/s."""
    omega, ratio = np.asarray(omega_n_rad_s), np.asarray(zeta)
    return np.asarray(-ratio * omega + 1j * omega * np.sqrt(1.0 - ratio**2))


def frequency_hz(poles: ComplexArray | complex) -> FloatArray:
    """Undamped natural frequency of each pole in Hz."""
    return np.asarray(np.abs(poles) / (2.0 * np.pi))


def damping_ratio(poles: ComplexArray | complex) -> FloatArray:
    """Damping ratio of each pole; negative for a growing motion."""
    values = np.asarray(poles, dtype=complex)
    return np.asarray(-values.real / np.abs(values))


def modal_slopes(pole: complex) -> FloatArray:
    """Derivatives of the frequency in Hz and the damping ratio with respect to (Re, Im) of a pole; shape (2, 2)."""
    re, im, size = pole.real, pole.imag, abs(pole)
    of_frequency = [re / size / (2.0 * np.pi), im / size / (2.0 * np.pi)]
    return np.array([of_frequency, [-(im**2) / size**3, re * im / size**3]])


def own_problem(problem: Problem, fit: PoleFit, modes: NDArray[np.intp]) -> Problem:
    """The problem with the motion of all modes but these subtracted, and the baseline."""
    data = problem.data
    own = motion(data.time_s, fit.poles[modes], fit.linear.amplitudes[modes])
    own += fit.linear.residual
    return Problem(replace(data, values=own), problem.baseline)


def fit_poles(problem: Problem, start: ComplexArray, *, search: bool = False) -> PoleFit:
    """Maximum-likelihood poles: first on averages of neighbouring samples, then on every sample.

    `start` must lie within about ``1 / span`` of the right minimum. With `search`, while modes are still being added,
    the averages suffice: their poles differ from the final ones by a sixth of a standard deviation. ``converged``
    states whether the iteration converged.
    """
    factor = thinning(problem.data.time_s, start)
    if factor < 2 and search:
        return gauss_newton(problem, start, tolerance=TUNING.rough_tolerance)
    if factor < 2:
        return gauss_newton(problem, start)
    coarse = gauss_newton(problem.thinned(factor), start, tolerance=TUNING.rough_tolerance)
    good = bool(np.all(np.isfinite(coarse.poles)))
    if search and good:
        linear = solve_linear(problem, ModeColumns(problem.data.time_s, coarse.poles))
        return replace(coarse, linear=linear)
    return gauss_newton(problem, coarse.poles if good else start)


def rough_poles(problem: Problem, start: ComplexArray) -> ComplexArray:
    """Poles from averages of neighbouring samples only: starting values for a joint fit with other modes."""
    factor = thinning(problem.data.time_s, start)
    coarse = problem if factor < 2 else problem.thinned(factor)
    return gauss_newton(coarse, start, tolerance=TUNING.rough_tolerance).poles


def thinning(time_s: FloatArray, poles: ComplexArray) -> int:
    """Number of neighbouring samples to average: twelve averages per cycle of the fastest mode, at least 200 in all."""
    step = float(np.median(np.diff(time_s))) if time_s.size > 1 else 1.0
    fastest = float(np.max(np.abs(poles), initial=0.0)) / (2.0 * np.pi)
    if fastest <= 0.0 or not np.isfinite(fastest):
        return 1
    return int(min(1.0 / (12.0 * fastest * step), time_s.size / 200.0))


def gauss_newton(
    problem: Problem,
    start: ComplexArray,
    max_iterations: int = MAX_ITERATIONS,
    tolerance: float = _STEP_TOLERANCE,
) -> PoleFit:
    """Maximum-likelihood poles, each channel with its own noise level, amplitudes and baseline.

    Until a step would be shorter than `tolerance` standard deviations.

    Notes
    -----
    Golub & Pereyra (1973), doi:10.1137/0710036, with Kaufman's (1975) Jacobian: the derivative of
    ``Re(c exp(lambda t))`` is ``Re(c t exp(lambda t) d lambda)``, with the linear columns projected out.
    """
    poles = np.array(start, dtype=complex)
    data = problem.data
    linear = solve_linear(problem, ModeColumns(data.time_s, poles))
    converged = poles.size == 0
    covariance: FloatArray = np.zeros((2 * poles.size, 2 * poles.size))
    for _ in range(max_iterations if poles.size else 0):
        information, gradient = normal_equations(problem, linear, *pole_slopes(data.time_s, linear))
        covariance = pseudo_inverse(information)
        step = covariance @ gradient
        size = np.abs(step) / np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        if np.max(size) < tolerance:
            converged = True
            break
        moved = _line_search(problem, poles, linear, step)
        if moved is None:
            converged = bool(np.max(size) < TUNING.rough_tolerance)
            break
        poles, linear = moved
    return PoleFit(poles, linear, covariance, converged)


def objective(data: FitData, linear: LinearSolution) -> float:
    """Negative log likelihood up to a constant, each channel's noise level at its maximum-likelihood value."""
    floor = linear.noise_variance * np.maximum(data.counts, 1.0) * 1e-3
    return float(0.5 * np.sum(data.counts * np.log(np.maximum(linear.rss, floor) + 1e-300)))


def _line_search(
    problem: Problem, poles: ComplexArray, linear: LinearSolution, step: FloatArray
) -> tuple[ComplexArray, LinearSolution] | None:
    data = problem.data
    change: ComplexArray = np.asarray(step[0::2] + 1j * step[1::2])
    # The linearisation does not hold for a phase change of more than a radian over the record.
    limit = 1.0 / max(data.span_s, 1e-300) + 0.2 * np.abs(poles.real)
    change *= np.min(np.minimum(1.0, limit / np.maximum(np.abs(change), 1e-300)))
    least, most = -MOST_RATE_PER_SAMPLE / data.step_s, MOST_GROWTH / max(data.span_s, 1e-300)
    now = objective(data, linear)

    def trial(shorter: ComplexArray) -> tuple[ComplexArray, LinearSolution] | None:
        moved = poles + shorter
        # A pole and its conjugate describe the same motion; a long step of a strongly damped mode may reach the latter.
        moved.imag = np.abs(moved.imag)
        if np.all((moved.real > least) & (moved.real < most)):
            solved = solve_linear(problem, ModeColumns(data.time_s, moved))
            if objective(data, solved) < now:
                return moved, solved
        return None

    return shortened(change, trial)


def pole_slopes(time_s: FloatArray, linear: LinearSolution) -> tuple[LongArray, FloatArray]:
    """Columns and weights, as `normal_equations` takes them, of (Re, Im) of each pole in turn."""
    m = linear.amplitudes.shape[0]
    twice = np.repeat(np.arange(m), 2)
    weights = slope_weights(linear.amplitudes[twice], twice, np.tile([1.0 + 0j, 1j], m))
    return TimesTime(time_s, linear.columns), weights

"""Poles of decaying modes: their frequency and damping ratio (Eq. 1), and their fit by variable projection (Eq. 2).

Yoo, Lee & Kim, "Tracking for high-order damping of thin beam oscillation": a mode moves as ``Re(c exp(lambda t))`` with
``lambda = -zeta w_n + i w_n sqrt(1 - zeta^2)``. The poles lambda are shared by all channels. Columns are made
for the rows that are needed: held for every sample, those of a few modes are most of the memory of an identification.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from modal_id.data import FEW_VALUES, FitData, row_blocks
from modal_id.solve.linear import LinearSolution, Problem, projected_grams, solve_linear
from modal_id.solve.weighting import BLOCK_ROWS, LongArray, pseudo_inverse
from tracker import ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Even times, steps and convergence."""

    #: [rad] error of phase up to which times count as even
    #: physics: Far below the noise of a sample.
    even: float = 1e-9
    #: [sd] step that is negligible in a result
    #: statistics: Far below the sd that is printed.
    step_tolerance: float = 2e-3
    #: [sd] step that is negligible where a fit is refined later
    rough_tolerance: float = 0.05
    #: [1] largest number of iterations of a fit
    max_iterations: int = 40
    #: [1] largest number of times that a step is shortened
    shortened: int = 10
    #: [1] factor by which a step is shortened
    shorter: float = 0.4
    #: [1] twice the gain in log likelihood of a further step, below which the fit has converged
    #: statistics: A step of a thirtieth of a standard deviation.
    converged: float = 1e-3
    #: [1] the same where rounding or a quadrature lets no step succeed
    #: statistics: A step of a fifth of a standard deviation.
    converged_to_rounding: float = 0.05
    #: [1] condition number above which the record does not determine the parameters
    #: physics: Rounding of 1e-16 leaves three digits.
    max_condition: float = 1e13


TUNING = Tuning()
MAX_ITERATIONS, MAX_CONDITION = TUNING.max_iterations, TUNING.max_condition

# Samples of a block whose times are multiples of the step.
_BLOCK = 512

Rows = slice | NDArray[np.intp]


def real_columns(functions: ComplexArray) -> FloatArray:
    """Real and imaginary part of each function as neighbouring columns, shape (n, 2 m); not a copy where possible."""
    return np.ascontiguousarray(functions).view(np.float64)


def mode_functions(time_s: FloatArray, poles: ComplexArray) -> ComplexArray:
    """``exp(lambda t)``, shape (n, m)."""
    return ModeColumns(time_s, poles).functions(slice(None))


@dataclass(frozen=True)
class ModeColumns:
    """Real and imaginary parts of ``exp(lambda t)`` of some poles as neighbouring columns, shape (n, 2 m)."""

    time_s: FloatArray
    poles: ComplexArray

    @property
    def shape(self) -> tuple[int, int]:
        """Of all columns."""
        return self.time_s.size, 2 * self.poles.size

    def __getitem__(self, rows: Rows) -> FloatArray:
        """Some rows of the columns."""
        few = self.time_s.size * self.poles.size <= FEW_VALUES
        return real_columns(self._all[rows] if few else self.functions(rows))

    def functions(self, rows: Rows) -> ComplexArray:
        """Some rows of ``exp(lambda t)``, shape (rows, m)."""
        if not self._is_even:
            return np.asarray(np.exp(self.time_s[rows, None] * self.poles))
        # Even times: the blocks are multiples of the first one.
        starts, within = self._blocks
        if not isinstance(rows, slice):
            return np.asarray(starts[rows // _BLOCK] * within[rows % _BLOCK])
        first, last, _ = rows.indices(self.time_s.size)
        block = first // _BLOCK
        whole = starts[block : -(-last // _BLOCK), None, :] * within
        return whole.reshape(-1, self.poles.size)[first - block * _BLOCK : last - block * _BLOCK]

    @cached_property
    def _all(self) -> ComplexArray:
        """All functions, where they are few enough to be held."""
        return self.functions(slice(None))

    @cached_property
    def _is_even(self) -> bool:
        time_s = self.time_s
        if time_s.size < 4 * _BLOCK or self.poles.size == 0:
            return False
        within, largest = time_s[:_BLOCK] - time_s[0], 0.0
        for first in range(0, time_s.size, _BLOCK):
            own = time_s[first : first + _BLOCK]
            largest = max(largest, float(np.max(np.abs(own[0] + within[: own.size] - own))))
        return largest * float(np.max(np.abs(self.poles))) <= TUNING.even

    @cached_property
    def _blocks(self) -> tuple[ComplexArray, ComplexArray]:
        """Functions of the time from the first sample to each block's, and of those of the first block."""
        starts = self.time_s[::_BLOCK] - self.time_s[0]
        return np.exp(starts[:, None] * self.poles), np.exp(self.time_s[:_BLOCK, None] * self.poles)


def motion(time_s: FloatArray, poles: ComplexArray, amplitudes: ComplexArray) -> FloatArray:
    """Real part of modes with these amplitudes, shape (m, k), in each channel; shape (n, k)."""
    columns, total = ModeColumns(time_s, poles), np.empty((time_s.size, amplitudes.shape[1]))
    for rows in row_blocks(time_s.size, BLOCK_ROWS):
        total[rows] = np.real(columns.functions(rows) @ amplitudes)
    return total


def no_columns(time_s: FloatArray) -> ModeColumns:
    """Columns of no mode, shape (n, 0)."""
    return ModeColumns(time_s, np.empty(0, dtype=complex))


@dataclass(frozen=True)
class Beside:
    """Columns of several arrays beside each other."""

    parts: tuple[LongArray, ...]

    @property
    def shape(self) -> tuple[int, int]:
        """Of all columns."""
        return self.parts[0].shape[0], sum(part.shape[1] for part in self.parts)

    def __getitem__(self, rows: Rows) -> FloatArray:
        """Some rows of the columns."""
        return np.concatenate([part[rows] for part in self.parts], axis=1)


@dataclass(frozen=True)
class TimesTime:
    """Columns times time: the slopes of decays."""

    time_s: FloatArray
    columns: LongArray

    @property
    def shape(self) -> tuple[int, ...]:
        """That of the columns."""
        return self.columns.shape

    def __getitem__(self, rows: Rows) -> FloatArray:
        """Some rows of the columns."""
        return np.asarray(self.time_s[rows, None] * self.columns[rows])


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


# Largest logarithm of the growth over the record: the square of such a wave does not overflow in single precision, in
# which the noise beside a mode is averaged.
MOST_GROWTH = 0.5 * float(np.log(np.finfo(np.float32).max))
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
    """Derivatives of (omega_n, zeta) with respect to (Re, Im) of a pole; shape (2, 2)."""
    re, im, size = pole.real, pole.imag, abs(pole)
    return np.array([[re / size, im / size], [-(im**2) / size**3, re * im / size**3]])


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


def gauss_newton(problem: Problem, start: ComplexArray, tolerance: float = TUNING.step_tolerance) -> PoleFit:
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
    for _ in range(MAX_ITERATIONS if poles.size else 0):
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


T = TypeVar("T")
Step = TypeVar("Step", FloatArray, ComplexArray)


def maximum(
    start: T | None,
    equations: Callable[[T], tuple[FloatArray, FloatArray]],
    moved: Callable[[T, FloatArray], T | None],
) -> tuple[T, FloatArray] | None:
    """The maximum and the covariance there; None where it is not reached or the parameters are not determined.

    Parameters
    ----------
    start : T or None
    equations : callable
        Information, shape (q, q), and gradient, shape (q,), of the log likelihood.
    moved : callable
        A better point in the direction of a step, as from `shortened`, or None.
    """
    now = start
    for _ in range(MAX_ITERATIONS):
        if now is None:
            return None
        information, gradient = equations(now)
        scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
        scaled = information * np.outer(scale, scale)
        if not np.all(np.isfinite(scaled)):
            return None
        values, vectors = np.linalg.eigh(scaled)
        if values[0] <= values[-1] / MAX_CONDITION:
            return None
        vectors *= scale[:, None]
        covariance = np.asarray((vectors / values) @ vectors.T)
        step = covariance @ gradient
        gain = float(gradient @ step)
        better = None if gain < TUNING.converged else moved(now, step)
        if better is None:
            return (now, covariance) if gain <= TUNING.converged_to_rounding else None
        now = better
    return None


def shortened(step: Step, trial: Callable[[Step], T | None]) -> T | None:
    """What `trial` returns for the longest of ever shorter steps that succeeds; None where none does."""
    for _ in range(TUNING.shortened):
        found = trial(step)
        if found is not None:
            return found
        step = TUNING.shorter * step
    return None

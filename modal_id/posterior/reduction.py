"""Reduction of the samples to moments about a pole, from which the likelihood of poles near it follows exactly."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from modal_id.data import row_blocks
from modal_id.solve import (
    RIDGE,
    BandedFactor,
    PoleFit,
    Problem,
    mode_functions,
    own_problem,
    real_columns,
)
from tracker import ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Waves that have decayed."""

    #: [decay times] blocks that begin later are not added to the moments of a wave
    #: physics: The wave is then exp(-30) of its start.
    decay_times: float = 30.0


TUNING = Tuning()


@njit(cache=True, nogil=True, error_model="numpy")
def chi_square_of(
    change: ComplexArray,
    data: ComplexArray,
    fixed_squares: ComplexArray,
    fixed_moduli: ComplexArray,
    square: ComplexArray,
    modulus: FloatArray,
    products: FloatArray,
    group: NDArray[np.intp],
    variance: FloatArray,
) -> FloatArray:
    """Residual sum of squares over the noise variance for each change, shape (w,); NaN where it is undefined.

    The arrays are those of `modal_id.posterior.sampler.ReducedLikelihood`.
    """
    terms, k, v = data.shape
    groups = square.shape[1]
    result = np.empty(change.size)
    powers = np.empty(terms, dtype=np.complex128)
    gram = np.empty((groups, 3))
    moment = np.empty(v, dtype=np.complex128)
    total = np.empty((v, v))
    for w in range(change.size):
        powers[0] = 1.0
        for p in range(1, terms):
            powers[p] = powers[p - 1] * change[w]
        for g in range(groups):
            _wave_gram(
                change[w], powers, square[:, g], modulus[:, g], fixed_squares[g], fixed_moduli[g], gram[g]
            )
        total[:] = 0.0
        for c in range(k):
            rr, ii, ri = gram[group[c]]
            scale = 1.0 / (variance[c] * (rr * ii - ri * ri))
            for a in range(v):
                value = 0.0j
                for p in range(terms):
                    value += powers[p] * data[p, c, a]
                moment[a] = value
            for a in range(v):
                left = scale * (ii * moment[a].real - ri * moment[a].imag)
                right = scale * (rr * moment[a].imag - ri * moment[a].real)
                for b in range(v):
                    explained = left * moment[b].real + right * moment[b].imag
                    total[a, b] += products[c, a, b] / variance[c] - explained
        result[w] = _less_shared(total)
    return result


@njit(cache=True, nogil=True, error_model="numpy")
def _wave_gram(
    change: complex,
    powers: ComplexArray,
    square: ComplexArray,
    modulus: FloatArray,
    fixed_squares: ComplexArray,
    fixed_moduli: ComplexArray,
    gram: FloatArray,
) -> None:
    """Inner products of the wave's real and imaginary part (rr, ii, ri), all other columns projected out."""
    both, absolute, both_power, absolute_power = 0.0j, 0.0, 1.0 + 0.0j, 1.0
    for p in range(powers.size):
        both += both_power * square[p]
        absolute += absolute_power * modulus[p]
        both_power *= 2.0 * change
        absolute_power *= 2.0 * change.real
        row, mixed = 0.0j, 0.0j
        for q in range(powers.size):
            row += powers[q] * fixed_squares[p, q]
            mixed += powers[q].conjugate() * fixed_moduli[p, q]
        both -= powers[p] * row
        absolute -= (powers[p] * mixed).real
    gram[0], gram[1], gram[2] = 0.5 * (absolute + both.real), 0.5 * (absolute - both.real), 0.5 * both.imag


@njit(cache=True, nogil=True, error_model="numpy")
def _less_shared(total: FloatArray) -> float:
    """``total[0, 0]`` less what the other rows explain (Schur complement); NaN where they are not positive definite."""
    v = total.shape[0]
    for pivot in range(v - 1, 0, -1):
        if not total[pivot, pivot] > 0.0:
            return np.nan
        for a in range(pivot):
            ratio = total[a, pivot] / total[pivot, pivot]
            for b in range(pivot):
                total[a, b] -= ratio * total[pivot, b]
    return float(total[0, 0])


# Rows whose powers are held at one time.
_BLOCK = 4096


@dataclass
class WaveSums:
    """Weighted inner products of ``exp(lambda_0 t) t^p / p!``, for p below `terms`.

    ``powers`` with [baseline, other modes, slopes of close modes, data], shape (terms, c); ``square`` and ``modulus``
    with the wave and its conjugate, shape (terms,).
    """

    powers: ComplexArray
    square: ComplexArray
    modulus: FloatArray

    def copy(self) -> WaveSums:
        """Copy with arrays of its own."""
        return WaveSums(self.powers.copy(), self.square.copy(), self.modulus.copy())


@dataclass(frozen=True)
class Columns:
    """Columns [baseline, other modes, slopes of close modes, data] of a mode's problem; the baseline is sparse."""

    problem: Problem
    fit: PoleFit
    mode: int
    close: NDArray[np.intp]

    @property
    def count(self) -> int:
        """Number of columns without the baseline and the data."""
        return 2 * (self.fit.poles.size - 1) + 2 * self.close.size

    def products(self, values: FloatArray, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Inner products over all samples: of the baseline with the c others, (b, c), and of these, (c, c)."""
        c = self.count + values.shape[1]
        found = np.zeros((self.problem.sparse.shape[1], c)), np.zeros((c, c))
        for rows in self._blocks():
            self.add_products(found, values, rows, weights[rows])
        return found

    def add_products(
        self,
        found: tuple[FloatArray, FloatArray],
        values: FloatArray,
        rows: slice | NDArray[np.intp],
        weights: FloatArray,
    ) -> None:
        """Add these rows to inner products of the columns."""
        cross, gram = found
        dense = self._dense(values, rows)
        weighted = dense * weights[:, None]
        cross += self.problem.sparse[rows].T @ weighted
        gram += weighted.T @ dense

    def waves(self, values: FloatArray, weights: FloatArray, centre: complex, terms: int) -> WaveSums:
        """Inner products of the wave with the columns over all samples in which it is not negligible."""
        shape = (terms, self.problem.sparse.shape[1] + self.count + values.shape[1])
        sums = WaveSums(np.zeros(shape, dtype=complex), np.zeros(terms, complex), np.zeros(terms))
        for rows in self._blocks():
            if self.problem.data.time_s[rows.start] * -centre.real > TUNING.decay_times:
                break
            self.add_waves(sums, values, rows, weights[rows], centre)
        return sums

    def add_waves(
        self,
        sums: WaveSums,
        values: FloatArray,
        rows: slice | NDArray[np.intp],
        weights: FloatArray,
        centre: complex,
    ) -> None:
        """Add these rows to inner products of the wave."""
        time, slow, dense = (
            self.problem.data.time_s[rows],
            self.problem.sparse[rows],
            self._dense(values, rows),
        )
        terms = sums.square.size
        powers = np.empty((terms, time.size), dtype=complex)
        powers[0] = np.exp(centre * time)
        for power in range(1, terms):
            np.multiply(powers[power - 1], time / power, out=powers[power])
        heavy = powers * weights
        parts = np.concatenate([heavy.real, heavy.imag])
        products = np.concatenate([(slow.T @ parts.T).T, parts @ dense], axis=1)
        sums.powers += products[:terms] + 1j * products[terms:]
        sums.square += heavy @ powers[0]
        sums.modulus += np.real(heavy @ np.conj(powers[0]))

    def _dense(self, values: FloatArray, rows: slice | NDArray[np.intp]) -> FloatArray:
        time = self.problem.data.time_s[rows]
        slopes = time[:, None] * mode_functions(time, self.fit.poles[self.close])
        others = mode_functions(time, np.delete(self.fit.poles, self.mode))
        return np.column_stack([real_columns(others), real_columns(slopes), values[rows]])

    def _blocks(self) -> Iterator[slice]:
        return row_blocks(self.problem.data.time_s.size, _BLOCK)


@dataclass(frozen=True)
class ReducedLikelihood:
    """Weighted residual sum of squares of one mode's pole, all other parameters eliminated, from a few moments.

    For a pole ``lambda_0 + d`` each inner product with ``exp(lambda t)`` is a power series in d. Amplitudes and
    baseline are projected out exactly; changes of the poles of close modes are projected out through their derivatives.

    Attributes
    ----------
    centre_per_s : complex
        lambda_0.
    data_moments : complex array, shape (terms, k, v)
        Of the channels' data and the close modes' derivatives, projected.
    fixed_squares, fixed_moduli : complex array, shape (g, terms, terms)
        Products of the moments with an orthonormal basis of baseline and other modes, without and with conjugation of
        the second factor, summed over the basis, for each group of weights.
    square_moments, modulus_moments : complex and real array, shape (terms, g)
        Of ``exp(2 lambda t)`` and ``|exp(lambda t)|^2``.
    products : array, shape (k, v, v)
        Inner products among data and derivatives.
    group : int array, shape (k,)
    variance : array, shape (k,)
    """

    centre_per_s: complex
    data_moments: ComplexArray
    fixed_squares: ComplexArray
    fixed_moduli: ComplexArray
    square_moments: ComplexArray
    modulus_moments: FloatArray
    products: FloatArray
    group: NDArray[np.intp]
    variance: FloatArray

    def chi_square(self, change_per_s: ComplexArray) -> FloatArray:
        """As in `Likelihood`."""
        return np.asarray(
            chi_square_of(
                change_per_s,
                self.data_moments,
                self.fixed_squares,
                self.fixed_moduli,
                self.square_moments,
                self.modulus_moments,
                self.products,
                self.group,
                self.variance,
            )
        )


@dataclass(frozen=True)
class _Group:
    """What channels of equal weights have for any pole.

    ``kept`` are their columns. The Cholesky factor of the inner products of baseline and other modes is made of blocks:
    ``slow`` of the baseline, banded, because dense it would take more memory than the record; ``mixed`` of both; and
    ``fast`` of the other modes. ``basis`` are the products of that basis with slopes and data, ``mix`` the weights of
    slopes and data in the vectors of each channel.
    """

    channels: NDArray[np.intp]
    kept: NDArray[np.intp]
    slow: BandedFactor
    mixed: FloatArray
    fast: FloatArray
    basis: FloatArray
    mix: FloatArray

    def whitened(self, powers: ComplexArray) -> ComplexArray:
        """Inverse of the Cholesky factor times the wave's products with baseline and other modes; (b + o, terms)."""
        b, terms = self.mixed.shape[0], powers.shape[0]
        parts = np.concatenate([powers.real, powers.imag]).T
        slow = self.slow.whiten(parts[:b])
        fast = solve_triangular(self.fast, parts[b:] - self.mixed.T @ slow, lower=True, check_finite=False)
        both = np.concatenate([slow, fast])
        return np.asarray(both[:, :terms] + 1j * both[:, terms:])


@dataclass(frozen=True)
class Reduction:
    """Samples of a mode's problem with everything projected that does not depend on the mode's pole."""

    columns: Columns
    values: FloatArray
    groups: tuple[_Group, ...]
    products: FloatArray
    variance: FloatArray

    def about(self, centre_per_s: complex, terms: int) -> ReducedLikelihood:
        """Likelihood of poles near `centre_per_s`, from this number of moments."""
        weighting = self.columns.problem.weighting
        channels, vectors = self.products.shape[:2]
        group = np.zeros(channels, dtype=np.intp)
        data_moments = np.empty((terms, channels, vectors), dtype=complex)
        squares, moduli, square_moments, modulus_moments = [], [], [], []
        shared = [
            self.columns.waves(self.values[:, base.channels], base.weights, centre_per_s, terms)
            for base in weighting.bases
        ]
        for index, (part, own) in enumerate(zip(weighting.groups, self.groups, strict=True)):
            sums = shared[part.base].copy()
            if part.rows.size:
                values = self.values[:, weighting.bases[part.base].channels]
                self.columns.add_waves(sums, values, part.rows, part.delta, centre_per_s)
            powers, fixed = sums.powers[:, own.kept], own.basis.shape[0]
            whitened = own.whitened(powers[:, :fixed])
            moments = powers[:, fixed:] - whitened.T @ own.basis
            squares.append(whitened.T @ whitened)
            moduli.append(whitened.T @ np.conj(whitened))
            square_moments.append(sums.square)
            modulus_moments.append(sums.modulus)
            group[own.channels] = index
            data_moments[:, own.channels] = np.moveaxis(moments @ own.mix, 0, 1)
        return ReducedLikelihood(
            centre_per_s,
            data_moments,
            np.stack(squares),
            np.stack(moduli),
            np.stack(square_moments, axis=1),
            np.stack(modulus_moments, axis=1),
            self.products,
            group,
            self.variance,
        )


def reduction(problem: Problem, fit: PoleFit, mode: int, close: NDArray[np.intp]) -> Reduction:
    """Reduction for the pole with index `mode`; `close` as in `modal_id.posterior.sampler.reduce_mode`."""
    # Baseline and other modes are subtracted first: large offsets would cost digits in the projection.
    values = own_problem(problem, fit, np.array([mode])).data.values
    columns = Columns(problem, fit, mode, close)
    o, vectors = columns.count - 2 * close.size, 1 + 2 * close.size
    products = np.empty((values.shape[1], vectors, vectors))
    bases, groups = problem.weighting.bases, []
    shared = [columns.products(values[:, base.channels], base.weights) for base in bases]
    for part, baseline in zip(problem.weighting.groups, problem.slow, strict=True):
        of_base = bases[part.base].channels
        cross, gram = (one.copy() for one in shared[part.base])
        if part.rows.size:
            columns.add_products((cross, gram), values[:, of_base], part.rows, part.delta)
        kept = np.append(np.ones(columns.count, dtype=bool), np.isin(of_base, part.channels))
        cross, gram = cross[:, kept], gram[np.ix_(kept, kept)]
        slow = baseline.factor.whiten(cross)
        mixed = slow[:, :o]
        left = gram[:o, :o] - mixed.T @ mixed
        left[np.diag_indices_from(left)] += RIDGE * float(np.max(np.diag(gram)[:o], initial=0.0))
        fast = np.linalg.cholesky(left)
        own = gram[:o, o:] - mixed.T @ slow[:, o:]
        basis = np.concatenate([slow[:, o:], solve_triangular(fast, own, lower=True, check_finite=False)])
        inner = gram[o:, o:] - basis.T @ basis
        channels = np.sort(part.channels)
        amplitudes = fit.linear.amplitudes[close][:, channels].T
        mix = np.stack([_of_channel(a, place, inner.shape[0]) for place, a in enumerate(amplitudes)])
        products[channels] = np.swapaxes(mix, 1, 2) @ inner @ mix
        of_powers = np.append(np.arange(cross.shape[0]), cross.shape[0] + np.flatnonzero(kept))
        groups.append(_Group(channels, of_powers, baseline.factor, mixed, fast, basis, mix))
    return Reduction(columns, values, tuple(groups), products, fit.linear.noise_variance)


def _of_channel(amplitudes: ComplexArray, place: int, columns: int) -> FloatArray:
    """Weights of [slopes, data] in the vectors of a channel: data, then slopes of the close modes."""
    s = 2 * amplitudes.size
    mix = np.zeros((columns, 1 + s))
    mix[s + place, 0] = 1.0
    for re in range(0, s, 2):
        amplitude, im = amplitudes[re // 2], re + 1
        mix[[re, im], 1 + re] = amplitude.real, -amplitude.imag
        mix[[re, im], 1 + im] = amplitude.imag, amplitude.real
    return mix

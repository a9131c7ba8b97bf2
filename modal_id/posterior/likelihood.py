"""Likelihood of one mode's pole from moments about the fitted pole, which replace the samples exactly."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from modal_id.fit.banded import BandedFactor
from modal_id.fit.linear import Problem
from modal_id.fit.poles import PoleFit, own_problem, thinning
from modal_id.posterior.kernels import chi_square_of
from modal_id.posterior.moments import MomentColumns, Sums
from tracker.arrays import ComplexArray, FloatArray

# Relative size of the first neglected term of the series.
_REMAINDER = 1e-9
_MAX_TERMS = 60
# Diagonal of a tile times the time in which the wave loses its energy: 20 terms would leave the same remainder.
_TILE = 2.5
_MAX_TILE_SAMPLES = 4_000_000


class Likelihood(Protocol):
    """Weighted residual sum of squares of one mode's pole, all other parameters eliminated."""

    @property
    def centre_per_s(self) -> complex:
        """The fitted pole."""

    def chi_square(self, change_per_s: ComplexArray) -> FloatArray:
        """Residual sum of squares over the noise variance for poles ``centre + change``; shape (w,) in and out."""


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
class TiledLikelihood:
    """Likelihood of a pole that is too uncertain for one series: a series for each square tile of the complex plane.

    Tiles are computed when a pole first lies in them; their values do not depend on the order.
    """

    problem: Problem
    fit: PoleFit
    mode: int
    close: NDArray[np.intp]
    side_per_s: float
    tiles: dict[complex, ReducedLikelihood] = field(default_factory=dict)

    @property
    def centre_per_s(self) -> complex:
        """The fitted pole."""
        return complex(self.fit.poles[self.mode])

    def chi_square(self, change_per_s: ComplexArray) -> FloatArray:
        """As in `Likelihood`."""
        scaled = change_per_s / self.side_per_s
        centre = np.round(scaled.real) + 1j * np.round(scaled.imag)
        result = np.empty(change_per_s.size)
        for tile in np.unique(centre):
            here = centre == tile
            offset = complex(tile) * self.side_per_s
            if tile not in self.tiles:
                self.tiles[tile] = _reduced(
                    self.problem, self.fit, self.mode, self.close, self.centre_per_s + offset, _MAX_TERMS
                )
            result[here] = self.tiles[tile].chi_square(change_per_s[here] - offset)
        return result


def reduce_mode(
    problem: Problem, fit: PoleFit, mode: int, close: NDArray[np.intp], reach_per_s: float
) -> Likelihood | None:
    """Likelihood of the pole with index `mode`.

    `close` are the indices of the poles whose uncertainty contributes to that of this one, `reach_per_s` is the largest
    change of the pole for which the likelihood must hold. Where one series would need more than 60 terms, because the
    pole is hardly determined, the plane is divided into tiles, and neighbouring samples are averaged to 24 per cycle,
    which costs 0.3 % of the information. None when even that takes too long.
    """
    centre = complex(fit.poles[mode])
    terms = _terms_needed(problem.data.time_s, np.exp(centre * problem.data.time_s), reach_per_s)
    if terms is not None:
        return _reduced(problem, fit, mode, close, centre, terms)
    factor = thinning(problem.data.time_s, 2.0 * fit.poles)
    problem = problem.thinned(factor) if factor > 1 else problem
    time = problem.data.time_s
    slowest = min(centre.real + reach_per_s, 0.0) + 1j * centre.imag
    side = 2.0 * _TILE / (2.0 * np.sqrt(2.0) * _last_s(time, np.exp(slowest * time)))
    if (2.0 * reach_per_s / side + 1.0) ** 2 * time.size > _MAX_TILE_SAMPLES:
        return None
    return TiledLikelihood(problem, fit, mode, close, side)


def _reduced(
    problem: Problem, fit: PoleFit, mode: int, close: NDArray[np.intp], centre: complex, terms: int
) -> ReducedLikelihood:
    # Baseline and other modes are subtracted first: large offsets would cost digits in the projection.
    data = own_problem(problem, fit, mode).data
    b, o, s, k = problem.sparse.shape[1], 2 * (fit.poles.size - 1), 2 * close.size, data.values.shape[1]
    v = 1 + s
    group = np.zeros(k, dtype=np.intp)
    data_moments, products = np.empty((terms, k, v), dtype=complex), np.empty((k, v, v))
    squares, moduli, square_moments, modulus_moments = [], [], [], []
    columns = MomentColumns(problem, fit, mode, close, centre, terms)
    shared = [columns.sums(data.values[:, base.channels], base.weights) for base in problem.weighting.bases]
    for index, part in enumerate(problem.weighting.groups):
        own = data.values[:, problem.weighting.bases[part.base].channels]
        sums = shared[part.base].copy()
        if part.rows.size:
            columns.add(sums, own, part.rows, part.delta)
        sums = sums.of_channels(
            np.isin(problem.weighting.bases[part.base].channels, part.channels), own.shape[1]
        )
        channels = np.sort(part.channels)
        whitened, basis = _whitened(sums, problem.slow[index].factor, o)
        moments = sums.powers[:, b + o :] - whitened.T @ basis
        inner = sums.gram[o:, o:] - basis.T @ basis
        squares.append(whitened.T @ whitened)
        moduli.append(whitened.T @ np.conj(whitened))
        square_moments.append(sums.square)
        modulus_moments.append(sums.modulus)
        for place, channel in enumerate(channels):
            group[channel] = index
            mix = _of_channel(fit.linear.amplitudes[close, channel], place, inner.shape[0])
            products[channel] = mix.T @ inner @ mix
            data_moments[:, channel] = moments @ mix
    return ReducedLikelihood(
        centre,
        data_moments,
        np.stack(squares),
        np.stack(moduli),
        np.stack(square_moments, axis=1),
        np.stack(modulus_moments, axis=1),
        products,
        group,
        fit.linear.noise_variance,
    )


def _whitened(sums: Sums, baseline: BandedFactor, others: int) -> tuple[ComplexArray, FloatArray]:
    """Powers and free columns, each times the inverse of the Cholesky factor of baseline and other modes.

    The factor is made of blocks: that of the baseline is banded, and dense it would take more memory than the record.
    """
    b, terms = sums.cross.shape[0], sums.powers.shape[0]
    powers = np.column_stack([sums.powers.real.T, sums.powers.imag.T])
    slow = baseline.whiten(np.column_stack([sums.cross, powers[:b]]))
    mixed = slow[:, :others]
    left = sums.gram[:others, :others] - mixed.T @ mixed
    left[np.diag_indices_from(left)] += 1e-13 * float(np.max(np.diag(sums.gram)[:others], initial=0.0))
    own = np.column_stack([sums.gram[:others, others:], powers[b : b + others]]) - mixed.T @ slow[:, others:]
    fast = solve_triangular(np.linalg.cholesky(left), own, lower=True, check_finite=False)
    both = np.concatenate([slow[:, others:], fast])
    free = both.shape[1] - 2 * terms
    return both[:, free : free + terms] + 1j * both[:, free + terms :], both[:, :free]


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


def _terms_needed(time_s: FloatArray, wave: ComplexArray, reach_per_s: float) -> int | None:
    # The radius is set by the time at which the wave has lost its energy; doubled for exp(2 lambda t).
    radius, size = 2.0 * reach_per_s * _last_s(time_s, wave), 1.0
    for power in range(1, _MAX_TERMS):
        size *= radius / power
        if size < _REMAINDER and power >= 6:
            return power + 1
    return None


def _last_s(time_s: FloatArray, wave: ComplexArray) -> float:
    """Time after which a millionth of the wave's energy is left."""
    energy = np.cumsum(np.abs(wave) ** 2 * np.gradient(time_s))
    return float(time_s[min(int(np.searchsorted(energy, (1.0 - 1e-6) * energy[-1])), time_s.size - 1)])

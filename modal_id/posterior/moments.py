"""Moments of the data and of the fit's other columns about one pole, summed in blocks of samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modal_id.solve import PoleFit, Problem, mode_functions, real_columns
from tracker import ComplexArray, FloatArray

# Rows whose powers are held at one time.
_BLOCK = 4096


@dataclass(frozen=True)
class Tuning:
    """Waves that have decayed."""

    #: [decay times] blocks that begin later are not added to the moments of a wave
    #: physics: It has fallen by exp(-30).
    decay_times: float = 30.0


TUNING = Tuning()


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

    def _blocks(self) -> list[slice]:
        n = self.problem.data.time_s.size
        return [slice(begin, min(begin + _BLOCK, n)) for begin in range(0, n, _BLOCK)]

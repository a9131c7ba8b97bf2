"""Moments of the data and of the fit's other columns about one pole, summed in blocks of samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from modal_id.fit.linear import Problem, real_columns
from modal_id.fit.poles import PoleFit, mode_functions
from tracker.arrays import BoolArray, ComplexArray, FloatArray

# Rows whose powers are held at one time.
_BLOCK = 4096
# Later rows are not added to the moments of the wave, which has fallen by exp(-30).
_DECAY_TIMES = 30.0


@dataclass
class Sums:
    """Weighted inner products of the baseline and of the c columns [other modes, slopes of close modes, data].

    ``cross`` of the b columns of the baseline with the others, shape (b, c); ``gram`` of the others among each other,
    shape (c, c); ``powers`` of all of them, baseline first, with ``exp(lambda_0 t) t^p / p!``, shape (terms, b + c);
    ``square`` and ``modulus`` of these powers with the wave and its conjugate, shape (terms,).
    """

    cross: FloatArray
    gram: FloatArray
    powers: ComplexArray
    square: ComplexArray
    modulus: FloatArray

    def copy(self) -> Sums:
        """Copy with arrays of its own."""
        return Sums(
            self.cross.copy(), self.gram.copy(), self.powers.copy(), self.square.copy(), self.modulus.copy()
        )

    def of_channels(self, mask: BoolArray, channels: int) -> Sums:
        """Sums with only these of the `channels` channels, whose columns are the last ones."""
        kept = np.concatenate([np.ones(self.gram.shape[0] - channels, dtype=bool), mask])
        of_powers = np.concatenate([np.ones(self.cross.shape[0], dtype=bool), kept])
        return Sums(
            self.cross[:, kept],
            self.gram[np.ix_(kept, kept)],
            self.powers[:, of_powers],
            self.square,
            self.modulus,
        )


@dataclass(frozen=True)
class MomentColumns:
    """Columns of the moments: baseline, other modes, slopes of close modes, data; and the powers of the wave."""

    problem: Problem
    fit: PoleFit
    mode: int
    close: NDArray[np.intp]
    centre: complex
    terms: int

    def sums(self, values: FloatArray, weights: FloatArray) -> Sums:
        """Sums over all samples, in blocks."""
        b, terms = self.problem.sparse.shape[1], self.terms
        c = 2 * (self.fit.poles.size - 1) + 2 * self.close.size + values.shape[1]
        sums = Sums(
            np.zeros((b, c)),
            np.zeros((c, c)),
            np.zeros((terms, b + c), dtype=complex),
            np.zeros(terms, complex),
            np.zeros(terms),
        )
        n = self.problem.data.time_s.size
        for begin in range(0, n, _BLOCK):
            rows = slice(begin, min(begin + _BLOCK, n))
            self.add(sums, values, rows, weights[rows])
        return sums

    def add(
        self, sums: Sums, values: FloatArray, rows: slice | NDArray[np.intp], weights: FloatArray
    ) -> None:
        """Add these rows."""
        time, slow = self.problem.data.time_s[rows], self.problem.sparse[rows]
        terms = self.terms
        slopes = time[:, None] * mode_functions(time, self.fit.poles[self.close])
        others = mode_functions(time, np.delete(self.fit.poles, self.mode))
        dense = np.column_stack([real_columns(others), real_columns(slopes), values[rows]])
        weighted = dense * weights[:, None]
        sums.cross += slow.T @ weighted
        sums.gram += weighted.T @ dense
        if time[0] * -self.centre.real > _DECAY_TIMES:
            return
        powers = np.empty((terms, time.size), dtype=complex)
        powers[0] = np.exp(self.centre * time)
        for power in range(1, terms):
            np.multiply(powers[power - 1], time / power, out=powers[power])
        heavy = powers * weights
        parts = np.concatenate([heavy.real, heavy.imag])
        products = np.concatenate([(slow.T @ parts.T).T, parts @ dense], axis=1)
        sums.powers += products[:terms] + 1j * products[terms:]
        sums.square += heavy @ powers[0]
        sums.modulus += np.real(heavy @ np.conj(powers[0]))

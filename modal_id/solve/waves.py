"""Functions of time that a fit is linear in, as columns of which any rows are made when they are needed.

Held for every sample, those of a few modes are most of the memory of an identification.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from modal_id.data import FEW_VALUES
from modal_id.solve.weighting import BLOCK_ROWS, LongArray
from tracker import ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Even times."""

    #: [rad] error of phase up to which times count as even
    #: physics: Far below the noise of a sample.
    even: float = 1e-9


TUNING = Tuning()

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
    for first in range(0, time_s.size, BLOCK_ROWS):
        rows = slice(first, first + BLOCK_ROWS)
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

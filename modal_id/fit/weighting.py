"""Weighted inner products of columns for each group of channels; groups that differ in few samples share them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array, csr_array

from modal_id.data.samples import FitData
from modal_id.fit.banded import normal_band
from tracker.arrays import FloatArray

# Groups whose weights differ in at most this share of the samples (rejected outliers) share their products.
_MAX_DIFFERENT = 0.1
# Samples at a time: SciPy copies both factors of a sparse product.
_BLOCK = 65_536


class LongArray(Protocol):
    """An array of shape (n, c), or one of which any rows are made when they are needed."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Of the array."""

    def __getitem__(self, rows: Any, /) -> FloatArray:
        """Some of its rows."""


@dataclass(frozen=True)
class Base:
    """Weights that groups share up to a few samples.

    ``channels`` are those of all groups of the base; ``is_one`` where all weights are 1.
    """

    weights: FloatArray
    channels: NDArray[np.intp]
    is_one: bool

    def times(self, columns: LongArray, rows: slice) -> FloatArray:
        """Some rows of columns, times weights."""
        return columns[rows] if self.is_one else columns[rows] * self.weights[rows, None]


@dataclass(frozen=True)
class Group:
    """Channels of equal weights: those of a base plus ``delta`` at ``rows``; ``splines``: the baseline there."""

    channels: NDArray[np.intp]
    base: int
    rows: NDArray[np.intp]
    delta: FloatArray
    splines: csr_array

    @cached_property
    def transposed(self) -> csc_array:
        """The baseline there, transposed once: to SciPy that costs more than a product."""
        return self.splines.T


@dataclass(frozen=True)
class Weighting:
    """Weights of some data as bases and groups, and the columns of the baseline, shape (n, b)."""

    splines: csr_array
    bases: tuple[Base, ...]
    groups: tuple[Group, ...]

    @cached_property
    def _transposed(self) -> tuple[csc_array, ...]:
        """``B^T`` of the baseline's columns B, some samples at a time."""
        return tuple(
            self.splines[first : first + _BLOCK].T for first in range(0, self.splines.shape[0], _BLOCK)
        )

    def inner(self, left: LongArray, right: LongArray) -> list[FloatArray]:
        """``left^T W right`` for the weights W of each group."""
        full = [self._product(base, left, right) for base in self.bases]
        return [
            full[g.base] + left[g.rows].T @ (g.delta[:, None] * right[g.rows])
            if g.rows.size
            else full[g.base]
            for g in self.groups
        ]

    def inner_own(self, left: LongArray, values: FloatArray) -> list[FloatArray]:
        """``left^T W values`` with the values, shape (n, k), of the group's own channels only."""
        full = [np.empty((left.shape[1], values.shape[1])) for _ in self.bases]
        for base, product in zip(self.bases, full, strict=True):
            product[:, base.channels] = self._product(base, left, _columns(values, base.channels))
        return [
            full[g.base][:, g.channels]
            + left[g.rows].T @ (g.delta[:, None] * values[np.ix_(g.rows, g.channels)])
            for g in self.groups
        ]

    def baseline(self, right: LongArray) -> list[FloatArray]:
        """``B^T W right`` for the baseline's columns B."""
        full = [self._spline_product(base, right) for base in self.bases]
        return [
            full[g.base] + g.transposed @ (g.delta[:, None] * right[g.rows]) if g.rows.size else full[g.base]
            for g in self.groups
        ]

    def baseline_own(self, values: FloatArray) -> list[FloatArray]:
        """``B^T W values`` with the values, shape (n, k), of the group's own channels only."""
        full = [self._spline_product(base, values) for base in self.bases]
        return [
            full[g.base][:, g.channels]
            + g.transposed @ (g.delta[:, None] * values[np.ix_(g.rows, g.channels)])
            for g in self.groups
        ]

    def _spline_product(self, base: Base, right: LongArray) -> FloatArray:
        """``B^T W right``, summed like `_product`."""
        total = np.zeros((self.splines.shape[1], right.shape[1]))
        for block, transposed in enumerate(self._transposed):
            total += transposed @ base.times(right, slice(block * _BLOCK, (block + 1) * _BLOCK))
        return total

    def _product(self, base: Base, left: LongArray, right: LongArray) -> FloatArray:
        """``left^T W right``, summed over some samples at a time: no factor is held for all of them."""
        total = np.zeros((left.shape[1], right.shape[1]))
        for first in range(0, base.weights.size, _BLOCK):
            rows = slice(first, first + _BLOCK)
            total += left[rows].T @ base.times(right, rows)
        return total

    def baseline_normal(self) -> list[FloatArray]:
        """``B^T W B``, which is banded: each as by `normal_band`."""
        full = [normal_band(self.splines, base.weights) for base in self.bases]
        result = []
        for group in self.groups:
            band = full[group.base].copy()
            changed = normal_band(group.splines, group.delta)
            band[: len(changed)] += changed
            result.append(band)
        return result


def weighting(data: FitData, splines: csr_array) -> Weighting:
    """Bases and groups of the data's weights, with the baseline's columns, shape (n, b)."""
    top = np.max(data.weights, axis=1)
    usual = np.count_nonzero(top != 1.0) <= _MAX_DIFFERENT * top.size
    chosen: list[FloatArray] = [np.broadcast_to(1.0, top.shape) if usual else top]
    members: list[list[int]] = [[]]
    groups = []
    for channels, weights in data.groups:
        differs = [np.flatnonzero(weights != base) for base in chosen]
        near = [place for place, rows in enumerate(differs) if rows.size <= _MAX_DIFFERENT * weights.size]
        if not near:
            near = [len(chosen)]
            chosen.append(weights)
            members.append([])
            differs.append(np.empty(0, dtype=np.intp))
        place, rows = near[0], differs[near[0]]
        members[place].extend(channels)
        groups.append((channels, place, rows, weights[rows] - chosen[place][rows]))
    # The first base has no group where the weights of every channel are its own.
    unused = 0 if members[0] else 1
    bases = []
    for weights, own in zip(chosen[unused:], members[unused:], strict=True):
        is_one = bool(np.all(weights == 1.0))
        bases.append(Base(weights, np.array(own, dtype=np.intp), is_one))
    parts = (Group(c, place - unused, rows, delta, splines[rows]) for c, place, rows, delta in groups)
    return Weighting(splines, tuple(bases), tuple(parts))


def scaled_rows(matrix: csr_array, factor: FloatArray) -> csr_array:
    """The matrix with each row times its factor."""
    entries = matrix.data * np.repeat(factor, np.diff(matrix.indptr))
    return csr_array((entries, matrix.indices, matrix.indptr), shape=matrix.shape)


def _columns(values: FloatArray, channels: NDArray[np.intp]) -> FloatArray:
    return (
        values if channels.size == values.shape[1] and np.all(np.diff(channels) == 1) else values[:, channels]
    )

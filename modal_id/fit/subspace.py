"""Independent check of the model order: stable poles of covariance-driven stochastic subspace identification."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft
from scipy.linalg import qr, svd

from modal_id.data import FitData
from modal_id.fit.damped import MAX_DAMPING
from modal_id.fit.spectrum import SAME_LINE
from modal_id.solve import damping_ratio, frequency_hz
from tracker import BoolArray, ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Stable poles of the subspace method."""

    #: [samples] samples per cycle of the highest frequency to which the record is thinned
    samples_per_cycle: float = 5.0
    #: [1] largest number of rows of the block Hankel matrix
    #: convention: Limits the computing time.
    max_rows: int = 240
    #: [1] largest number of reference channels
    #: convention: Limits the computing time.
    max_references: int = 3
    #: [1] largest number of channels used
    #: physics: More would shorten the block rows below a cycle of the lowest mode.
    max_channels: int = 8
    #: [1] largest number of components of several channels from whose values poles are taken
    #: convention: Limits the computing time.
    max_components: int = 2
    #: [1] largest number of columns of their Hankel matrix, up to a factor of two
    #: convention: Limits the computing time.
    max_columns: int = 1200
    #: [1] largest order of the state
    max_order: int = 40
    #: [1] successive orders, two states apart, in which a stable pole must occur
    least_run: int = 5
    #: [1] largest relative difference of the damping ratios of a stable pole in successive orders
    steady: float = 0.2
    #: [1] absolute difference of the damping ratios allowed in addition
    #: convention: For poles of little damping.
    steady_zeta: float = 2e-4


TUNING = Tuning()


@dataclass(frozen=True)
class StabilityDiagram:
    """Poles of each model order (number of states): in 1/s, upper half plane, decaying.

    ``span_s`` of the record: poles closer than half its inverse count as the same.
    """

    orders: tuple[int, ...]
    poles: tuple[ComplexArray, ...]
    span_s: float

    def run(self, frequency: float) -> int:
        """Largest number of successive orders with a stable pole within 1 % (or half a bin) of a frequency in Hz.

        A pole is stable when its damping ratio changes by less than 20 % from one order to the next.
        """
        near = max(SAME_LINE * frequency, 0.5 / self.span_s)
        longest = current = 0
        before = np.empty(0)
        for poles in self.poles:
            damping = damping_ratio(poles[np.abs(frequency_hz(poles) - frequency) < near])
            change = np.abs(damping[:, None] - before[None, :])
            steady = bool(np.any(change < TUNING.steady * np.abs(before[None, :]) + TUNING.steady_zeta))
            current = current + 1 if steady else min(damping.size, 1)
            longest, before = max(longest, current), damping
        return longest

    def stable(self, index: int) -> BoolArray:
        """Mask of the poles of one order which the order before has, too: frequency within 1 %, damping within 20 %."""
        poles, before = self.poles[index], self.poles[max(index - 1, 0)]
        hz, damping = frequency_hz(poles)[:, None], damping_ratio(poles)[:, None]
        near = np.abs(hz - frequency_hz(before)) < np.maximum(SAME_LINE * hz, 0.5 / self.span_s)
        own = damping_ratio(before)
        steady = np.abs(damping - own) < TUNING.steady * own + TUNING.steady_zeta
        return np.asarray(np.any(near & steady, axis=1) if index else np.zeros(poles.size, dtype=bool))

    def confirms(self, frequency: float) -> bool:
        """Whether a pole near the frequency (Hz) is stable over model orders."""
        return self.run(frequency) >= min(TUNING.least_run, len(self.orders))


def stability_diagram(data: FitData, baseline: FloatArray, highest_hz: float) -> StabilityDiagram | None:
    """Poles of the record for increasing model orders; None where it is too short for a Hankel matrix.

    Missing samples are left out of every product. Samples at uneven times are assigned to the nearest cell of an even
    grid, and neighbouring samples are averaged to five per cycle of `highest_hz`, the highest mode to be confirmed:
    accurate enough to confirm a frequency, not to estimate it. `baseline`, shape (n, k), is subtracted first. Of more
    than eight channels, those are used that together hold most of the motion.

    Notes
    -----
    Products ``R_i = sum_t y(t + i) y(t)^T`` of a free decay obey the same recursion as the decay, and independent noise
    enters only i = 0. Peeters & De Roeck (1999), doi:10.1006/mssp.1999.1249, sections 3 and 5.
    """
    step, values, mask = _even(data, baseline, highest_hz)
    if values.shape[1] > TUNING.max_channels:
        chosen = _independent_channels(values)
        values, mask = values[:, chosen], mask[:, chosen]
    n, k = values.shape
    rows = int(min(TUNING.max_rows // k, n // 4))
    if rows * k < 8 or rows < 4:
        return None
    strongest = np.argsort(-np.sum(values**2, axis=0))[: TUNING.max_references]
    lags = _products(values, mask, np.sort(strongest), 2 * rows)
    hankel = np.concatenate([np.concatenate(lags[i : i + rows], axis=1) for i in range(1, rows + 1)], axis=0)
    left, size, _ = svd(hankel, full_matrices=False, check_finite=False, lapack_driver="gesdd")
    most = int(min(TUNING.max_order, (rows - 1) * k, np.count_nonzero(size > 1e-12 * size[0])))
    orders = tuple(range(2, most + 1, 2))
    observed = left[:, :most] * np.sqrt(size[:most])
    poles = tuple(_poles(observed[:, :order], k, step) for order in orders)
    return StabilityDiagram(orders, poles, data.span_s) if orders else None


def close_poles(data: FitData, modes_hz: FloatArray, most: int) -> list[ComplexArray]:
    """Poles of sums of 1, 2, ... up to `most` waves in values without baseline: starting values near the first mode.

    From the values themselves: in records with little noise their subspace separates modes that do not beat, which
    their products do not. The rows of the Hankel matrix span half of the record, further apart than a cycle in a long
    one: of the frequencies that agree with them, a pole has the one next to that mode. Waves may grow. Of several
    channels the two strongest components are used. `modes_hz`, shape (m,), are the fitted modes; poles in 1/s.

    Notes
    -----
    ESPRIT: Roy & Kailath (1989), doi:10.1109/29.32276.
    """
    step, values, _ = _even(data, np.zeros_like(data.values), float(np.max(modes_hz)))
    if values.shape[1] > TUNING.max_components:
        values = values @ np.linalg.svd(values, full_matrices=False)[2][: TUNING.max_components].T
    n, k = values.shape
    rows = int(max(min(TUNING.max_rows // k, n // 2), 1))
    lag = max(n // (2 * rows), 1)
    begins = np.arange(0, n - (rows - 1) * lag, max(n // TUNING.max_columns, 1))
    hankel = np.concatenate([values[begins + i * lag].T for i in range(rows)], axis=0)
    waves = min(most, (min(hankel.shape) - k) // 2)
    left = np.linalg.eigh(hankel @ hankel.T)[1][:, ::-1]
    found = (_waves(left[:, : 2 * count], k, lag * step) for count in range(1, waves + 1))
    omega = 2.0 * np.pi * float(modes_hz[0])
    return [_next_to(poles[poles.imag >= 0.0], omega, lag * step) for poles in found]


def _next_to(poles: ComplexArray, omega: float, step: float) -> ComplexArray:
    """The poles or their conjugates, of the frequencies that agree at samples a step apart the one next to `omega`."""
    both = np.stack([poles, np.conj(poles)])
    both += 2j * np.pi / step * np.rint((omega - both.imag) * step / (2.0 * np.pi))
    nearer = np.argmin(np.abs(both.imag - omega), axis=0)
    return np.asarray(both[nearer, np.arange(poles.size)])


def _independent_channels(values: FloatArray) -> NDArray[np.intp]:
    """The channel that moves most, then each time the one that differs most from those already chosen."""
    order = qr(values, mode="r", pivoting=True, check_finite=False)[-1]
    return np.sort(np.asarray(order[: TUNING.max_channels], dtype=np.intp))


def _even(data: FitData, baseline: FloatArray, highest_hz: float) -> tuple[float, FloatArray, FloatArray]:
    """Time step, means of neighbouring samples on an even grid (0 where none), and a mask of the cells with samples."""
    own = data.step_s
    stride = max(1, int(1.0 / (TUNING.samples_per_cycle * highest_hz * own)))
    step = own * stride
    cell = np.floor((data.time_s - data.time_s[0] + 0.5 * own) / step).astype(np.intp)
    shape = (int(cell[-1]) + 1, data.values.shape[1])
    total, weight = np.zeros(shape), np.zeros(shape)
    np.add.at(total, cell, data.weights * (data.values - baseline))
    np.add.at(weight, cell, data.weights)
    mask = weight > 0.0
    return step, np.where(mask, total / np.where(mask, weight, 1.0), 0.0), mask.astype(float)


def _products(
    values: FloatArray, mask: FloatArray, references: NDArray[np.intp], count: int
) -> list[FloatArray]:
    """``R_i``, each of shape (k, references), for i below `count`, missing cells left out."""
    length = next_fast_len(values.shape[0] + count, real=True)
    spectrum, seen = rfft(values, length, axis=0), rfft(mask, length, axis=0)
    result = np.empty((count, values.shape[1], references.size))
    for column, reference in enumerate(references):
        product = irfft(spectrum * np.conj(spectrum[:, [reference]]), length, axis=0)[:count]
        pairs = irfft(seen * np.conj(seen[:, [reference]]), length, axis=0)[:count]
        # Unbiased in the number of pairs that gaps leave; the end effect of the sum stays, as the recursion needs it.
        all_pairs = values.shape[0] - np.arange(count)[:, None]
        result[:, :, column] = product * all_pairs / np.maximum(pairs, 1.0)
    return list(result)


def _poles(observed: FloatArray, channels: int, step: float) -> ComplexArray:
    found = _waves(observed, channels, step)
    found = found[(found.imag > 0.0) & (found.real < 0.0)]
    return np.asarray(found[damping_ratio(found) < MAX_DAMPING])


def _waves(observed: FloatArray, channels: int, step: float) -> ComplexArray:
    shift = np.linalg.lstsq(observed[:-channels], observed[channels:], rcond=None)[0]
    discrete = np.linalg.eigvals(shift)
    found = np.log(discrete[np.abs(discrete) > 1e-9].astype(complex)) / step
    return np.asarray(found)

"""Noise level at a mode's frequency relative to the white noise that the fit assumes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve
from scipy.sparse import csr_array

from modal_id.data import AT_ONCE, FitData, row_blocks
from modal_id.fit import AmplitudeFit, ModalFit, nonlinear_decay, nyquist_hz, own_decay
from modal_id.solve import (
    Beside,
    LinearSolution,
    LongArray,
    ModeColumns,
    Problem,
    SparseColumns,
    frequency_hz,
    normal_equations,
    pole_slopes,
    solve_linear,
)
from tracker import BoolArray, ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """The level of the noise beside a mode, and the accuracy of its spectrum."""

    #: [1] blocks per period of the largest distance from the centre
    #: physics: The phase changes by up to 0.2 rad within half a block.
    blocks_per_period: float = 16.0
    #: [1] number of moments of each block
    #: physics: 0.2^6 / 6! = 1e-7.
    moments: int = 6
    #: [1] relative difference up to which frequency steps count as equal
    #: physics: Above rounding.
    even: float = 1e-10
    #: [1] half-width of the band, over the mode's frequency
    relative_half_width: float = 0.06
    #: [bins] fewest bins on either side
    min_bins_aside: int = 12
    #: [half-widths] least half-width of the band in half-power half-widths of the mode
    #: physics: The fit absorbs about one.
    half_power_widths: float = 2.5
    #: [bins] distance from a mode below which bins are left out; its half-power half-width is added for the other
    #: modes
    own_bins: float = 1.25
    #: [bins] largest number of bins in the band
    max_bins: int = 150
    #: [1] share of white noise that the fit leaves in a bin, below which it is not used
    least_left: float = 0.5
    #: [1] largest number of channels whose levels are averaged
    #: statistics: Their standard deviation is then a few per cent.
    most_channels: int = 32
    #: [1] prior sd of the exponent of a local power law
    #: convention: White, pink and brown noise lie at 0, -1 and -2.
    exponent_sd: float = 1.0


TUNING = Tuning()


_SPLINES = 16
# Values of the rotations of the blocks that are held at a time.
_ROTATIONS = 4_000_000


class BandTransform:
    """``sum_t x(t) exp(-2 pi i f t)`` of columns x, shape (n, c), for the frequencies f of a narrow band.

    Samples are shifted by the band's centre and summed in blocks; the band is transformed from the blocks. The blocks'
    response, at least 0.994 in amplitude, is divided out. Up to a few percent leak in from far outside the band:
    accurate enough for columns of the fit, but not for a residual with strong noise elsewhere, for which `exact` sums
    six moments of each block (relative remainder 0.2^6 / 6! = 1e-7).
    """

    def __init__(self, time_s: FloatArray, frequencies_hz: FloatArray) -> None:
        middle = 0.5 * (float(frequencies_hz[0]) + float(frequencies_hz[-1]))
        half = max(float(np.max(np.abs(frequencies_hz - middle))), 1e-9)
        block = 1.0 / (TUNING.blocks_per_period * half)
        number = ((time_s - time_s[0]) / block).astype(np.intp)
        starts = np.flatnonzero(np.diff(number, prepend=-1))
        ends = np.append(starts[1:], time_s.size)
        mean = np.add.reduceat(time_s, starts) / (ends - starts)
        spread = np.add.reduceat((time_s - np.repeat(mean, ends - starts)) ** 2, starts) / (ends - starts)
        self._offset_rad_s = 2.0 * np.pi * (frequencies_hz - middle)
        self._mean_s, self._spread = mean, spread
        self._time_s, self._middle_hz = time_s, middle
        self._edges = np.append(starts, time_s.size).astype(np.int32)

    def __call__(self, *columns: LongArray | SparseColumns, weights: FloatArray) -> list[ComplexArray]:
        """Transform of each array of columns, their rows times weights; shape (frequencies, c) each."""
        total = [np.zeros((self.size, one.shape[1]), dtype=complex) for one in columns]
        for blocks in self._parts():
            rows, edges = self._samples(blocks)
            rotation, wave = self._rotation(blocks), self._wave(rows)
            # Two matrices, so that real columns are not copied as complex ones.
            place = np.arange(wave.size, dtype=np.int32), edges
            cos, sin = (csr_array((part * weights[rows], *place)) for part in (wave.real, wave.imag))
            for k, one in enumerate(columns):
                total[k] += _rotated(rotation, cos @ one[rows], sin @ one[rows])
        return total

    def _parts(self) -> Iterator[slice]:
        """The blocks, some at a time: their rotations and the waves of their samples take memory."""
        count = self._mean_s.size
        at_once = max(1, min(_ROTATIONS // self.size, AT_ONCE * count // self._time_s.size))
        return row_blocks(count, at_once)

    def _samples(self, blocks: slice) -> tuple[slice, NDArray[np.int32]]:
        """Rows of the samples of some blocks, and the edges of the blocks among them."""
        edges = self._edges[blocks.start : blocks.stop + 1]
        return slice(int(edges[0]), int(edges[-1])), edges - edges[0]

    def _wave(self, rows: slice) -> ComplexArray:
        return np.asarray(np.exp(-2j * np.pi * self._middle_hz * self._time_s[rows]))

    def _rotation(self, blocks: slice) -> NDArray[np.complex64]:
        # Single precision, and row by row, because this is the largest array for a long record.
        rotation = np.empty((self.size, self._mean_s[blocks].size), dtype=np.complex64)
        turns = self._turns(self._mean_s[blocks])
        for row, (offset, turn) in enumerate(zip(self._offset_rad_s, turns, strict=True)):
            rotation[row] = turn / (1.0 - 0.5 * offset**2 * self._spread[blocks])
        return rotation

    @property
    def size(self) -> int:
        """Number of frequencies."""
        return int(self._offset_rad_s.size)

    def exact(
        self, values: FloatArray, weights: FloatArray, share: ComplexArray | FloatArray
    ) -> ComplexArray:
        """Transform of one sum, with factors `share`, of the weighted columns of an array, without leakage."""
        moments = np.empty((TUNING.moments, self._mean_s.size), dtype=complex)
        for blocks in self._parts():
            rows, edges = self._samples(blocks)
            moving = self._wave(rows) * ((weights[rows] * values[rows]) @ share)
            from_mean = self._time_s[rows] - np.repeat(self._mean_s[blocks], np.diff(edges))
            for power in range(TUNING.moments):
                moments[power, blocks] = np.add.reduceat(moving, edges[:-1])
                moving *= from_mean / (power + 1.0)
        factors = (-1j * self._offset_rad_s[:, None]) ** np.arange(TUNING.moments)
        turns = self._turns(self._mean_s)
        return np.array([f @ (moments @ turn) for f, turn in zip(factors, turns, strict=True)])

    def _turns(self, time_s: FloatArray) -> Iterator[ComplexArray]:
        """``exp(-i w t)`` at some times for each frequency, by steps where these are even."""
        turn: ComplexArray = np.ones(time_s.size, dtype=complex)
        step, gap, last = turn, 0.0, 0.0
        for offset in self._offset_rad_s:
            if abs(offset - last - gap) > TUNING.even * abs(gap):
                gap = float(offset) - last
                step = np.exp(-1j * gap * time_s)
            turn, last = turn * step, float(offset)
            yield turn


def _rotated(
    rotation: NDArray[np.complex64], cos: FloatArray | csr_array, sin: FloatArray | csr_array
) -> ComplexArray:
    """Sum of the blocks, their cosine and sine parts with shape (blocks, c), each times its rotation."""
    if isinstance(cos, np.ndarray) or isinstance(sin, np.ndarray):
        return np.asarray(rotation @ (cos + 1j * sin).astype(np.complex64), dtype=complex)
    # A few splines at a time: dense, all of them take more memory than the record.
    cos, sin = cos.tocsc(), sin.tocsc()
    parts = row_blocks(cos.shape[1], _SPLINES)
    return np.hstack([_rotated(rotation, cos[:, part].toarray(), sin[:, part].toarray()) for part in parts])


@dataclass(frozen=True)
class NoiseLevel:
    """Factor on white-noise standard deviations near a mode, and degrees of freedom of the estimate of its square."""

    factor: float
    dof: float


def noise_level(model: ModalFit, amplitude_fit: AmplitudeFit | None, mode: int) -> NoiseLevel:
    """Spectral level of the residual near a mode, weighted as in the fit of the mode.

    The score of the poles is one complex series: the residuals summed over channels with the conjugate amplitudes of
    the mode and inverse variances. Its spectrum contains the cross-spectra of the channels, so that noise common to all
    of them (a shaking camera) is included in full.

    The residual is that of the amplitude fit where there is one, because amplitude dependence is not noise. Factor 1
    with three degrees of freedom when the record has too few bins.

    Notes
    -----
    Each bin is divided by the share of white noise that the fit leaves in it: the fit absorbs part of the bins near the
    mode and near the edge of the baseline. A power law ``S(f) = S_0 (f / f_0)^b`` is fitted by Whittle's likelihood, b
    with a prior; the degrees of freedom are those of a chi-square with the same relative variance, ``2 / var(ln S_0)``.
    """
    variance = model.fit.linear.noise_variance
    share = np.conj(model.fit.linear.amplitudes[mode]) / variance
    if amplitude_fit is None:
        own = own_decay(model, mode)
        problem, linear = own.problem, own.fit.linear
        columns, weights = pole_slopes(problem.data.time_s, linear)
        weights = weights[:, :, :2]
    else:
        problem, linear = amplitude_fit.problem, amplitude_fit.linear
        columns, weights = amplitude_fit.slopes, amplitude_fit.weights
    fitted = _Fitted(problem, replace(linear, noise_variance=variance), columns, weights)
    residual = _residual(model, amplitude_fit, mode)
    return _level(model, mode, fitted, model.data, residual, share[:, None])


def channel_noise_level(model: ModalFit, mode: int, channels: FitData, residual: FloatArray) -> NoiseLevel:
    """Spectral level of the residual near a mode in single channels that the components of a fit stand for.

    The factor on the standard deviations of their amplitudes. That of the score is not theirs: it holds noise that is
    common to all channels once for each of them, and it is one series, where each channel shows the level anew.

    Parameters
    ----------
    model : ModalFit
        Of the components.
    mode : int
    channels : FitData
        At the same instants.
    residual : array, shape (n, k)
        What the fit leaves in the channels.
    """
    chosen = np.unique(np.linspace(0, residual.shape[1] - 1, TUNING.most_channels).astype(int))
    problem = Problem(channels.channels(chosen), model.problem.baseline)
    linear = solve_linear(problem, ModeColumns(channels.time_s, model.fit.poles))
    columns, weights = np.zeros((residual.shape[0], 0)), np.zeros((chosen.size, 0, 0))
    fitted = _Fitted(problem, linear, columns, weights)
    share = np.diag(linear.noise_variance**-0.5)
    return _level(model, mode, fitted, problem.data, residual[:, chosen], share)


@dataclass(frozen=True)
class _Fitted:
    """Fit of samples or averages, and slopes (n, c) of further parameters of a mode with their weights (k, c, q)."""

    problem: Problem
    linear: LinearSolution
    columns: LongArray
    weights: FloatArray


def _level(
    model: ModalFit,
    mode: int,
    fitted: _Fitted,
    data: FitData,
    residual: FloatArray,
    share: ComplexArray | FloatArray,
) -> NoiseLevel:
    """Level of the sums of all samples' residuals, weighted by the columns of `share`, (k, s), all together."""
    centre, bins = _grid(model, mode)
    free = _free(model, mode, bins)
    total = float(np.sum(data.weights @ (np.abs(share) ** 2 * fitted.linear.noise_variance[:, None])))
    if np.count_nonzero(free) < 3 or total <= 0.0:
        return NoiseLevel(1.0, 3.0)
    power = _power(data, residual, share, bins[free])
    left = 1.0 - _absorbed(fitted, share, bins[free]) / total
    keep = left > TUNING.least_left
    if np.count_nonzero(keep) < 3:
        return NoiseLevel(1.0, 3.0)
    level, dof = _power_law(power[keep] / (total * left[keep]), np.log(bins[free][keep] / centre))
    return NoiseLevel(float(np.sqrt(max(level, 1e-12))), dof)


def _power(
    data: FitData, residual: FloatArray, share: ComplexArray | FloatArray, bins_hz: FloatArray
) -> FloatArray:
    """Power of the scores, all together, in each bin."""
    transform = BandTransform(data.time_s, bins_hz)
    scores = (transform.exact(residual, data.weights, one) for one in share.T)
    return np.asarray(np.sum([np.abs(score) ** 2 for score in scores], axis=0))


def _grid(model: ModalFit, mode: int) -> tuple[float, FloatArray]:
    """Frequency of the mode and frequencies of independent bins around it, in Hz."""
    span = model.data.span_s
    pole = complex(model.fit.poles[mode])
    centre = float(frequency_hz(pole))
    width = TUNING.half_power_widths * abs(pole.real) / (2.0 * np.pi)
    half = max(TUNING.min_bins_aside / span, TUNING.relative_half_width * centre, width)
    stride = max(1, int(np.ceil(2.0 * half * span / TUNING.max_bins)))
    aside = int(half * span / stride)
    below = min(aside, int(0.6 * centre * span / stride))
    return centre, np.asarray(centre + (0.5 + stride * np.arange(-below, aside + 1.0)) / span)


def _free(model: ModalFit, mode: int, bins: FloatArray) -> BoolArray:
    """Mask of the bins that belong neither to a mode nor to the baseline."""
    poles, span = model.fit.poles, model.data.span_s
    all_hz = frequency_hz(poles)
    free = (bins > max(model.lowest_line_hz, 1.0 / span)) & (bins < nyquist_hz(model.data.time_s))
    for other in range(poles.size):
        line = 0.0 if other == mode else abs(float(poles[other].real)) / (2.0 * np.pi)
        free &= np.abs(bins - all_hz[other]) > TUNING.own_bins / span + line
    return np.asarray(free)


def _residual(model: ModalFit, amplitude_fit: AmplitudeFit | None, mode: int) -> FloatArray:
    """Residual of all samples, of the mode with its dependence on the amplitude where there is a fit of it."""
    time_s = model.data.time_s
    decay = None if amplitude_fit is None else nonlinear_decay(time_s, amplitude_fit.parameters)
    if decay is None:
        return model.fit.linear.residual
    others = ModeColumns(time_s, np.delete(model.fit.poles, mode))
    return solve_linear(model.problem, Beside((decay[0], others))).residual


def _absorbed(fitted: _Fitted, share: ComplexArray | FloatArray, bins_hz: FloatArray) -> FloatArray:
    """Power of white noise that the fit absorbs from each bin of the scores.

    The fit of baseline and amplitudes, and of the further parameters (the mode's frequency and damping).
    """
    problem, linear, variance = fitted.problem, fitted.linear, fitted.linear.noise_variance
    transform = BandTransform(problem.data.time_s, bins_hz)
    columns, slope_weights = fitted.columns, fitted.weights
    absorbed = np.zeros(transform.size)
    cross = np.zeros((absorbed.size, slope_weights.shape[2], share.shape[1]), dtype=complex)
    weighting = problem.weighting
    groups = zip(
        problem.data.groups,
        problem.slow,
        linear.factors,
        weighting.baseline(columns),
        weighting.inner(linear.columns, columns),
        strict=True,
    )
    for (channels, weights), part, own, mixed, inner in groups:
        slow, fast, seen = transform(problem.sparse, linear.columns, columns, weights=weights)
        fast -= slow @ own.slow
        power = np.real(np.sum(np.conj(slow) * part.factor.solve(slow.T).T, axis=1))
        power += np.real(np.sum(np.conj(fast) * cho_solve(own.factor, fast.T).T, axis=1))
        absorbed += power * float(np.sum(np.abs(share[channels]) ** 2 * variance[channels, None]))
        both = inner - own.slow.T @ mixed
        seen = seen - slow @ part.factor.solve(mixed) - fast @ cho_solve(own.factor, both)
        effect = np.einsum("ks,kca->cas", share[channels], slope_weights[channels])
        cross += np.tensordot(seen, effect, axes=1)
    information, _ = normal_equations(problem, linear, columns, slope_weights)
    inverse = np.linalg.pinv(information, hermitian=True)
    return np.asarray(absorbed + np.real(np.einsum("fas,ab,fbs->f", np.conj(cross), inverse, cross)))


def _power_law(ratio: FloatArray, log_frequency: FloatArray) -> tuple[float, float]:
    """Level at log frequency 0 and its degrees of freedom."""
    design = np.stack([np.ones_like(log_frequency), log_frequency], axis=1)
    prior = np.diag([0.0, TUNING.exponent_sd**-2])
    guess = np.array([np.log(max(float(np.mean(ratio)), 1e-300)), 0.0])
    for _ in range(30):
        relative = ratio / np.exp(design @ guess)
        gradient = design.T @ (relative - 1.0) - prior @ guess
        # Fisher information in place of the Hessian, so that every step ascends.
        step = np.linalg.solve(design.T @ design + prior, gradient)
        guess = guess + np.clip(step, -1.0, 1.0)
        if np.max(np.abs(step)) < 1e-8:
            break
    covariance = np.linalg.inv(design.T @ design + prior)
    return float(np.exp(guess[0])), 2.0 / float(covariance[0, 0])

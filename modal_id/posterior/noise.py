"""Noise level at a mode's frequency relative to the white noise that the fit assumes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve
from scipy.sparse import csr_array

from modal_id.data.samples import FitData
from modal_id.fit.amplitude_dependence import AmplitudeFit
from modal_id.fit.linear import LinearSolution, Problem, solve_linear
from modal_id.fit.model_order import ModalFit
from modal_id.fit.normal_equations import normal_equations
from modal_id.fit.poles import frequency_hz, mode_functions, pole_slopes
from modal_id.fit.spectrum import nyquist_hz
from modal_id.fit.weighting import scaled_rows
from tracker.arrays import BoolArray, ComplexArray, FloatArray

_RELATIVE_HALF_WIDTH = 0.06
_MIN_BINS_ASIDE = 12
# Half-power half-widths of the mode on each side: the fit absorbs about one.
_HALF_POWER_WIDTHS = 2.5
_OWN_BINS = 1.25
_MAX_BINS = 150
# Blocks per period of the largest distance from the centre: the phase changes by up to 0.2 rad within half a block.
_BLOCKS_PER_PERIOD = 16.0
# Moments of each block in `exact`; splines transformed at a time; largest relative difference of even frequency steps.
_MOMENTS = 6
_SPLINES = 16
# Values of the rotations of the blocks that are held at a time.
_ROTATIONS = 4_000_000
_EVEN = 1e-10
# Bins in which the fit leaves less than this share of white noise are not used.
_LEAST_LEFT = 0.5
# Channels whose levels are averaged: their standard deviation is then a few percent.
_MOST_CHANNELS = 32
# Prior standard deviation of the exponent of a local power law: white, pink and brown noise lie at 0, -1 and -2.
_EXPONENT_SD = 1.0


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
    linear = model.fit.linear if amplitude_fit is None else amplitude_fit.linear
    share = np.conj(model.fit.linear.amplitudes[mode]) / model.fit.linear.noise_variance
    if amplitude_fit is None:
        columns, weights = pole_slopes(model.data.time_s, linear)
        weights = weights[:, :, 2 * mode : 2 * mode + 2]
    else:
        columns, weights = amplitude_fit.slopes, amplitude_fit.weights
    fitted = _Fitted(model.problem, linear, model.fit.linear.noise_variance, columns, weights)
    return _level(model, mode, fitted, share[:, None])


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
    chosen = np.unique(np.linspace(0, residual.shape[1] - 1, _MOST_CHANNELS).astype(int))
    problem = Problem(channels.channels(chosen), model.problem.baseline)
    linear = solve_linear(problem, mode_functions(channels.time_s, model.fit.poles))
    linear = replace(linear, residual=residual[:, chosen])
    columns, weights = np.zeros((residual.shape[0], 0)), np.zeros((chosen.size, 0, 0))
    fitted = _Fitted(problem, linear, linear.noise_variance, columns, weights)
    return _level(model, mode, fitted, np.diag(linear.noise_variance**-0.5))


@dataclass(frozen=True)
class _Fitted:
    """Fit, its noise variances, and the slopes (n, c) of further parameters of a mode, with their weights (k, c, q)."""

    problem: Problem
    linear: LinearSolution
    variance: FloatArray
    columns: FloatArray
    weights: FloatArray


def _level(model: ModalFit, mode: int, fitted: _Fitted, share: ComplexArray | FloatArray) -> NoiseLevel:
    """Level of the sums of the residuals, weighted by the columns of `share`, (k, s), all together."""
    data = fitted.problem.data
    centre, bins = _grid(model, mode)
    free = _free(model, mode, bins)
    total = float(np.sum(data.weights @ (np.abs(share) ** 2 * fitted.variance[:, None])))
    if np.count_nonzero(free) < 3 or total <= 0.0:
        return NoiseLevel(1.0, 3.0)
    score = (data.weights * fitted.linear.residual) @ share
    transform = _BandTransform(data.time_s, bins[free])
    power = np.sum([np.abs(transform.exact(one)) ** 2 for one in score.T], axis=0)
    left = 1.0 - _absorbed(fitted, share, transform) / total
    keep = left > _LEAST_LEFT
    if np.count_nonzero(keep) < 3:
        return NoiseLevel(1.0, 3.0)
    level, dof = _power_law(power[keep] / (total * left[keep]), np.log(bins[free][keep] / centre))
    return NoiseLevel(float(np.sqrt(max(level, 1e-12))), dof)


def _grid(model: ModalFit, mode: int) -> tuple[float, FloatArray]:
    """Frequency of the mode and frequencies of independent bins around it, in Hz."""
    span = model.data.span_s
    pole = complex(model.fit.poles[mode])
    centre = float(frequency_hz(pole))
    width = _HALF_POWER_WIDTHS * abs(pole.real) / (2.0 * np.pi)
    half = max(_MIN_BINS_ASIDE / span, _RELATIVE_HALF_WIDTH * centre, width)
    stride = max(1, int(np.ceil(2.0 * half * span / _MAX_BINS)))
    aside = int(half * span / stride)
    below = min(aside, int(0.6 * centre * span / stride))
    return centre, np.asarray(centre + (0.5 + stride * np.arange(-below, aside + 1.0)) / span)


def _free(model: ModalFit, mode: int, bins: FloatArray) -> BoolArray:
    """Mask of the bins that belong neither to a mode nor to the baseline."""
    poles, span = model.fit.poles, model.data.span_s
    all_hz = frequency_hz(poles)
    free = (bins > max(1.3 * model.bandwidth_hz, 1.0 / span)) & (bins < nyquist_hz(model.data.time_s))
    for other in range(poles.size):
        line = 0.0 if other == mode else abs(float(poles[other].real)) / (2.0 * np.pi)
        free &= np.abs(bins - all_hz[other]) > _OWN_BINS / span + line
    return np.asarray(free)


class _BandTransform:
    """``sum_t x(t) exp(-2 pi i f t)`` of columns x, shape (n, c), for the frequencies f of a narrow band.

    Samples are shifted by the band's centre and summed in blocks; the band is transformed from the blocks. The blocks'
    response, at least 0.994 in amplitude, is divided out. Up to a few percent leak in from far outside the band:
    accurate enough for columns of the fit, but not for a residual with strong noise elsewhere, for which `exact` sums
    six moments of each block (relative remainder 0.2^6 / 6! = 1e-7).
    """

    def __init__(self, time_s: FloatArray, frequencies_hz: FloatArray) -> None:
        middle = 0.5 * (float(frequencies_hz[0]) + float(frequencies_hz[-1]))
        half = max(float(np.max(np.abs(frequencies_hz - middle))), 1e-9)
        block = 1.0 / (_BLOCKS_PER_PERIOD * half)
        number = ((time_s - time_s[0]) / block).astype(np.intp)
        starts = np.flatnonzero(np.diff(number, prepend=-1))
        ends = np.append(starts[1:], time_s.size)
        mean = np.add.reduceat(time_s, starts) / (ends - starts)
        spread = np.add.reduceat((time_s - np.repeat(mean, ends - starts)) ** 2, starts) / (ends - starts)
        self._offset_rad_s = 2.0 * np.pi * (frequencies_hz - middle)
        self._mean_s, self._spread = mean, spread
        self._wave, self._starts = np.exp(-2j * np.pi * middle * time_s), starts
        self._from_mean = time_s - np.repeat(mean, ends - starts)
        rows = np.arange(time_s.size), np.append(starts, time_s.size)
        # Two matrices, so that real columns are not copied as complex ones.
        self._cos, self._sin = (csr_array((part, *rows)) for part in (self._wave.real, self._wave.imag))

    def __call__(self, *columns: FloatArray | csr_array) -> list[ComplexArray]:
        """Transform of each array of columns; shape (frequencies, c) each."""
        total = [np.zeros((self.size, one.shape[1]), dtype=complex) for one in columns]
        at_once = max(1, _ROTATIONS // self.size)
        for first in range(0, self._starts.size, at_once):
            blocks = slice(first, first + at_once)
            rotation = self._rotation(blocks)
            for k, one in enumerate(columns):
                total[k] += _rotated(rotation, self._cos[blocks] @ one, self._sin[blocks] @ one)
        return total

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

    def exact(self, series: ComplexArray) -> ComplexArray:
        """Transform of one series, without leakage."""
        moving = self._wave * series
        moments = np.empty((_MOMENTS, self._starts.size), dtype=complex)
        for power in range(_MOMENTS):
            moments[power] = np.add.reduceat(moving, self._starts)
            moving *= self._from_mean / (power + 1.0)
        factors = (-1j * self._offset_rad_s[:, None]) ** np.arange(_MOMENTS)
        turns = self._turns(self._mean_s)
        return np.array([f @ (moments @ turn) for f, turn in zip(factors, turns, strict=True)])

    def _turns(self, time_s: FloatArray) -> Iterator[ComplexArray]:
        """``exp(-i w t)`` at some times for each frequency, by steps where these are even."""
        turn: ComplexArray = np.ones(time_s.size, dtype=complex)
        step, gap, last = turn, 0.0, 0.0
        for offset in self._offset_rad_s:
            if abs(offset - last - gap) > _EVEN * abs(gap):
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
    parts = (slice(first, first + _SPLINES) for first in range(0, cos.shape[1], _SPLINES))
    return np.hstack([_rotated(rotation, cos[:, part].toarray(), sin[:, part].toarray()) for part in parts])


def _absorbed(fitted: _Fitted, share: ComplexArray | FloatArray, transform: _BandTransform) -> FloatArray:
    """Power of white noise that the fit absorbs from each bin of the scores.

    The fit of baseline and amplitudes, and of the further parameters (the mode's frequency and damping).
    """
    problem, linear, variance = fitted.problem, fitted.linear, fitted.variance
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
        used = (problem.sparse, linear.columns, columns)
        if np.any(weights != 1.0):
            used = scaled_rows(problem.sparse, weights), *(part * weights[:, None] for part in used[1:])
        slow, fast, seen = transform(*used)
        fast -= slow @ own.slow
        power = np.real(np.sum(np.conj(slow) * cho_solve(part.factor, slow.T).T, axis=1))
        power += np.real(np.sum(np.conj(fast) * cho_solve(own.factor, fast.T).T, axis=1))
        absorbed += power * float(np.sum(np.abs(share[channels]) ** 2 * variance[channels, None]))
        both = inner - own.slow.T @ mixed
        seen = seen - slow @ cho_solve(part.factor, mixed) - fast @ cho_solve(own.factor, both)
        effect = np.einsum("ks,kca->cas", share[channels], slope_weights[channels])
        cross += np.tensordot(seen, effect, axes=1)
    information, _ = normal_equations(problem, linear, columns, slope_weights)
    inverse = np.linalg.pinv(information, hermitian=True)
    return np.asarray(absorbed + np.real(np.einsum("fas,ab,fbs->f", np.conj(cross), inverse, cross)))


def _power_law(ratio: FloatArray, log_frequency: FloatArray) -> tuple[float, float]:
    """Level at log frequency 0 and its degrees of freedom."""
    design = np.stack([np.ones_like(log_frequency), log_frequency], axis=1)
    prior = np.diag([0.0, _EXPONENT_SD**-2])
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

"""Noise level at a mode's frequency relative to the white noise that the fit assumes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve

from modal_id.fit.amplitude_dependence import AmplitudeFit
from modal_id.fit.model_order import ModalFit
from modal_id.fit.normal_equations import normal_equations
from modal_id.fit.poles import frequency_hz, pole_slopes
from modal_id.posterior.band_transform import BandTransform, fourier_sums
from tracker.arrays import BoolArray, ComplexArray, FloatArray

_RELATIVE_HALF_WIDTH = 0.06
_MIN_BINS_ASIDE = 12
_OWN_BINS = 1.25
_MAX_BINS = 150
# Bins in which the fit leaves less than this share of white noise are not used.
_LEAST_LEFT = 0.5
# Prior standard deviation of the exponent of a local power law: white, pink and brown noise lie at 0, -1 and -2.
_EXPONENT_SD = 1.0


@dataclass(frozen=True)
class NoiseLevel:
    """Noise level near a mode.

    Attributes
    ----------
    factor : float
        Factor on white-noise standard deviations.
    dof : float
        Degrees of freedom of the estimate of ``factor**2``.
    """

    factor: float
    dof: float


def noise_level(model: ModalFit, amplitude_fit: AmplitudeFit | None, mode: int) -> NoiseLevel:
    """Spectral level of the residual near a mode, weighted as in the fit of the mode.

    The score of the poles is one complex series: the residuals summed over channels with the conjugate amplitudes of
    the mode and inverse variances. Its spectrum contains the cross-spectra of the channels, so that noise common to all
    of them (a shaking camera) is included in full.

    Parameters
    ----------
    model : ModalFit
    amplitude_fit : AmplitudeFit or None
        Its residual is used, because amplitude dependence is not noise.
    mode : int

    Returns
    -------
    NoiseLevel
        Factor 1 with three degrees of freedom when the record has too few bins.

    Notes
    -----
    Each bin is divided by the share of white noise that the fit leaves in it: the fit absorbs part of the bins near the
    mode and near the edge of the baseline. A power law ``S(f) = S_0 (f / f_0)^b`` is fitted by Whittle's likelihood, b
    with a prior; the degrees of freedom are those of a chi-square with the same relative variance, ``2 / var(ln S_0)``.
    """
    linear = model.fit.linear if amplitude_fit is None else amplitude_fit.linear
    variance = model.fit.linear.noise_variance
    centre, step, aside = _grid(model, mode)
    bins: FloatArray = centre + 0.5 / model.data.span_s + step * np.arange(-aside, aside + 1.0)
    free = _free(model, mode, bins)
    share = np.conj(model.fit.linear.amplitudes[mode]) / variance
    whole = float(np.sum(model.data.weights * (np.abs(share) ** 2 * variance)))
    if np.count_nonzero(free) < 3 or whole <= 0.0:
        return NoiseLevel(1.0, 3.0)
    score = (model.data.weights * linear.residual) @ share
    power = np.abs(fourier_sums(score, model.data.time_s, float(bins[0]), step, bins.size)[free]) ** 2
    transform = BandTransform.of(model.data.time_s, bins[free])
    left = 1.0 - _absorbed(model, amplitude_fit, mode, share, transform) / whole
    keep = left > _LEAST_LEFT
    if np.count_nonzero(keep) < 3:
        return NoiseLevel(1.0, 3.0)
    level, dof = _power_law(power[keep] / (whole * left[keep]), np.log(bins[free][keep] / centre))
    return NoiseLevel(float(np.sqrt(max(level, 1e-12))), dof)


def _grid(model: ModalFit, mode: int) -> tuple[float, float, int]:
    """Centre and step in Hz of independent bins around the mode, and their number on each side."""
    span = model.data.span_s
    centre = float(frequency_hz(model.fit.poles)[mode])
    half = min(max(_MIN_BINS_ASIDE / span, _RELATIVE_HALF_WIDTH * centre), 0.6 * centre)
    stride = max(1, int(np.ceil(2.0 * half * span / _MAX_BINS)))
    return centre, stride / span, int(half * span / stride)


def _free(model: ModalFit, mode: int, bins: FloatArray) -> BoolArray:
    """Mask of the bins that belong neither to a mode nor to the baseline."""
    time, poles, span = model.data.time_s, model.fit.poles, model.data.span_s
    all_hz = frequency_hz(poles)
    nyquist = 0.5 / float(np.median(np.diff(time)))
    free = (bins > max(1.3 * model.bandwidth_hz, 1.0 / span)) & (bins < nyquist)
    for other in range(poles.size):
        line = 0.0 if other == mode else abs(float(poles[other].real)) / (2.0 * np.pi)
        free &= np.abs(bins - all_hz[other]) > _OWN_BINS / span + line
    return np.asarray(free)


def _absorbed(
    model: ModalFit,
    amplitude_fit: AmplitudeFit | None,
    mode: int,
    share: ComplexArray,
    transform: BandTransform,
) -> FloatArray:
    """Power of white noise that the fit absorbs from each bin of the score.

    The fit of baseline and amplitudes, and of the mode's own frequency and damping with their amplitude dependence.
    """
    problem, linear, variance = model.problem, model.fit.linear, model.fit.linear.noise_variance
    if amplitude_fit is None:
        columns, slope_weights = pole_slopes(model.data.time_s, linear)
        slope_weights = slope_weights[:, :, 2 * mode : 2 * mode + 2]
    else:
        linear, columns, slope_weights = amplitude_fit.linear, amplitude_fit.slopes, amplitude_fit.weights
    absorbed = np.zeros(transform.frequencies_hz.size)
    cross = np.zeros((absorbed.size, slope_weights.shape[2]), dtype=complex)
    groups = zip(problem.data.groups, problem.slow, linear.factors, strict=True)
    for (channels, weights), part, own in groups:
        slow = transform(part.weighted_t.T.toarray())
        fast = transform(linear.columns * weights[:, None]) - slow @ own.slow
        power = np.real(np.sum(np.conj(slow) * cho_solve(part.factor, slow.T).T, axis=1))
        power += np.real(np.sum(np.conj(fast) * cho_solve(own.factor, fast.T).T, axis=1))
        absorbed += power * float(np.sum(np.abs(share[channels]) ** 2 * variance[channels]))
        weighted = columns * weights[:, None]
        mixed = part.weighted_t @ columns
        both = linear.columns.T @ weighted - own.slow.T @ mixed
        seen = transform(weighted) - slow @ cho_solve(part.factor, mixed) - fast @ cho_solve(own.factor, both)
        cross += seen @ np.einsum("k,kca->ca", share[channels], slope_weights[channels])
    information, _ = normal_equations(problem, linear, columns, slope_weights)
    inverse = np.linalg.pinv(information, hermitian=True)
    return np.asarray(absorbed + np.real(np.sum((np.conj(cross) @ inverse) * cross, axis=1)))


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

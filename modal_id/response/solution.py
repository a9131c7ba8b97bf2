"""Coefficients of the response at given poles, by instrumental variables, their covariance, and frequency responses."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.ndimage import uniform_filter1d
from scipy.stats import chi2

from modal_id.fit import FALSE_ALARM
from modal_id.response.columns import FIXED, PER_MODE, Samples, amplitudes, spline_gain, transfer
from modal_id.response.noise import TUNING as NOISE
from modal_id.response.noise import Noise
from tracker import INTERVAL_ENDS, BoolArray, ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """What the fit may leave at a mode, bins and draws of frequency responses."""

    #: [1] half-widths of a mode within which the residual is compared with the noise
    #: physics: Four fifths of the power of a resonance.
    half_widths: float = 3.0
    #: [bins] at least on both sides
    least_bins: int = 4
    #: [bins] half width of the window of a local polynomial
    #: statistics: 13 bins for 6 unknowns leave 7 complex degrees of freedom for the variance.
    half_window: int = 6
    #: [1] degree of the local polynomials of response and transient
    degree: int = 2
    #: [1] draws of the fit from which bands are made
    #: statistics: The 5 % and 95 % quantiles scatter by a seventh of the standard deviation.
    draws: int = 200
    #: [1] largest number of frequencies of a spectrum or response that is kept for a figure
    #: convention: Wider than a screen; each mode has its own beside them.
    frequencies: int = 1500
    #: [1] power of the input in a window, over its median power, below which there is no local estimate
    least_power: float = 1e-6


TUNING = Tuning()
MOST_FREQUENCIES = TUNING.frequencies


@dataclass(frozen=True)
class ResponseFit:
    """Poles and coefficients that fit the outputs to the measured input.

    Attributes
    ----------
    samples : Samples
    likely : Samples
        With the most likely input, given outputs and measured input.
    poles : complex array, shape (m,)
    coefficients : array, shape (FIXED + PER_MODE m, k)
    residual : array, shape (2 b, k)
        As `Samples.rows`.
    weights : array, shape (b, k)
        Inverse variance of the residual.
    leverage : array, shape (b, k)
        Share of the noise of each bin that the parameters absorb.
    noise : Noise
    covariance : array, shape (q, q)
        Of (Re, Im) of each pole in turn, q = 2 m, and of the lag of the input where it is estimated, q = 2 m + 1.
    coefficient_covariance : array, shape (k, p, p)
        Of the coefficients of each output, uncertainty of the poles included.
    coefficient_slopes : array, shape (k, p, q)
        Change of the best coefficients with (Re, Im) of the poles, and with the lag.
    step : array, shape (q,)
        Change of (Re, Im) of the poles, and of the lag, that the score asks for.
    """

    samples: Samples
    likely: Samples
    poles: ComplexArray
    coefficients: FloatArray
    residual: FloatArray
    weights: FloatArray
    leverage: FloatArray
    noise: Noise
    covariance: FloatArray
    coefficient_covariance: FloatArray
    coefficient_slopes: FloatArray
    step: FloatArray

    @property
    def driven(self) -> ComplexArray:
        """Factors of the responses to a band-limited input, larger than that to its spline; shape (m, k)."""
        loss = spline_gain(np.abs(self.poles) / (2.0 * np.pi), self.samples.step_s)
        return np.asarray(amplitudes(self.coefficients)[0] * loss[:, None])

    @property
    def lag_sd_s(self) -> float:
        """Standard deviation of the lag of the input, NaN where it is not estimated."""
        if self.samples.channel is None:
            return float("nan")
        return float(np.sqrt(max(self.covariance[-1, -1], 0.0)))

    @property
    def residual_bins(self) -> ComplexArray:
        """The residual as complex bins; shape (b, k)."""
        half = self.residual.shape[0] // 2
        return np.asarray(self.residual[:half] + 1j * self.residual[half:])

    def transfer(self, frequency_hz: FloatArray) -> ComplexArray:
        """Frequency response of each output; shape (frequencies, k)."""
        return transfer(frequency_hz, self.poles, self.coefficients[:2], self.driven)


@dataclass(frozen=True)
class _Output:
    """One output at given poles: coefficients of the scaled columns, and what the poles can change beyond them.

    Attributes
    ----------
    coefficients : array, shape (p,)
    inverse : array, shape (p, p)
        Of the normal equations.
    residual : array, shape (2 b,)
    carried : array, shape (p, q)
        Less the change of the coefficients with the poles, and with the lag.
    rest : array, shape (2 b, q)
        Change of the motion with the poles and the lag that the coefficients cannot follow.
    information : array, shape (q, q)
    gradient : array, shape (q,)
    absorbed : array, shape (2 b,)
        Share of the noise that the coefficients absorb.
    """

    coefficients: FloatArray
    inverse: FloatArray
    residual: FloatArray
    carried: FloatArray
    rest: FloatArray
    information: FloatArray
    gradient: FloatArray
    absorbed: FloatArray


def solve_at(
    samples: Samples, likely: Samples, poles: ComplexArray, noise: Noise, weights: FloatArray
) -> ResponseFit:
    """Coefficients at given poles: the instruments are the columns of `likely`, whose input is the most likely one."""
    columns, scale = scaled(samples.columns(poles))
    instruments = columns if likely is samples else likely.columns(poles) / scale
    slopes = likely.slopes(poles)
    both = np.concatenate([weights, weights])
    outputs = [
        _output(columns, instruments, samples.outputs[:, out], likely, poles, slopes, scale, both[:, out])
        for out in range(both.shape[1])
    ]
    coefficients = np.column_stack([one.coefficients for one in outputs]) / scale[:, None]
    response = transfer(samples.frequency_hz, poles, coefficients[:2], amplitudes(coefficients)[0])
    share = samples.share_given
    information = sum(s * one.information for s, one in zip(share, outputs, strict=True))
    gradient = sum(s * one.gradient for s, one in zip(share, outputs, strict=True))
    inverted = np.linalg.pinv(np.asarray(information))
    covariance = inverted @ _scatter(outputs, noise, weights, response, share) @ inverted.T
    covariance = 0.5 * (covariance + covariance.T)
    leverage = np.empty(weights.shape)
    of_coefficients = np.empty((len(outputs), scale.size, scale.size))
    for out, one in enumerate(outputs):
        hat = one.absorbed + np.sum(one.rest @ covariance * one.rest, axis=1) * both[:, out]
        leverage[:, out] = 0.5 * (hat[: hat.size // 2] + hat[hat.size // 2 :])
        variance = noise.output[:, out] + noise.input * np.abs(response[:, out]) ** 2
        factor = np.concatenate([weights[:, out] ** 2 * variance] * 2)
        middle = (instruments * factor[:, None]).T @ instruments / share[out]
        own = one.inverse @ middle @ one.inverse.T + one.carried @ covariance @ one.carried.T
        of_coefficients[out] = own / scale[:, None] / scale
    return ResponseFit(
        samples=samples,
        likely=likely,
        poles=poles,
        coefficients=coefficients,
        residual=np.column_stack([one.residual for one in outputs]),
        weights=weights,
        leverage=np.clip(leverage, 0.0, 0.95),
        noise=noise,
        covariance=covariance,
        coefficient_covariance=of_coefficients,
        coefficient_slopes=-np.array([one.carried for one in outputs]) / scale[:, None],
        step=inverted @ gradient,
    )


def with_lag_variance(found: ResponseFit, variance: float) -> ResponseFit:
    """The fit with another variance of the lag of its input; what poles and coefficients owe to the lag grows alike."""
    own = found.covariance[-1]
    more = np.outer(own, own) / own[-1] ** 2 * (variance - own[-1])
    slopes = found.coefficient_slopes
    return replace(
        found,
        covariance=found.covariance + more,
        coefficient_covariance=found.coefficient_covariance + slopes @ more @ np.swapaxes(slopes, 1, 2),
    )


def _output(
    columns: FloatArray,
    instruments: FloatArray,
    values: FloatArray,
    likely: Samples,
    poles: ComplexArray,
    slopes: FloatArray,
    scale: FloatArray,
    weights: FloatArray,
) -> _Output:
    left = instruments * weights[:, None]
    inverse = np.asarray(np.linalg.pinv(left.T @ columns, rcond=1e-13), dtype=np.float64)
    coefficients = inverse @ (left.T @ values)
    residual = values - columns @ coefficients
    unscaled = (coefficients / scale)[:, None]
    of_poles = pole_slopes(slopes, unscaled)[:, :, 0]
    if likely.channel is not None:
        of_poles = np.column_stack([of_poles, likely.of_lag(poles, unscaled)])
    weighted = of_poles * weights[:, None]
    # Without the part that the coefficients explain: orthogonal to the measured columns.
    rest = of_poles - instruments @ (inverse.T @ (columns.T @ weighted))
    return _Output(
        coefficients=coefficients,
        inverse=inverse,
        residual=residual,
        carried=inverse @ (instruments.T @ weighted),
        rest=rest,
        information=rest.T @ weighted,
        gradient=rest.T @ (residual * weights),
        absorbed=np.sum((columns @ inverse) * left, axis=1),
    )


def _scatter(
    outputs: list[_Output], noise: Noise, weights: FloatArray, response: ComplexArray, share: FloatArray
) -> FloatArray:
    """Covariance of the gradient: the noise of each output, and that of the input, which they have in common."""
    half, m = weights.shape[0], outputs[0].rest.shape[1]
    found, common = np.zeros((m, m)), np.zeros((half, m), dtype=complex)
    for out, one in enumerate(outputs):
        factor = np.concatenate([weights[:, out] ** 2 * noise.output[:, out]] * 2)
        found += share[out] * (one.rest * factor[:, None]).T @ one.rest
        as_complex = one.rest[:half] + 1j * one.rest[half:]
        common += share[out] * (weights[:, out] * np.conj(response[:, out]))[:, None] * as_complex
    return found + noise.input * np.real(np.conj(common).T @ common)


def scaled(columns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Columns of unit norm, and their norms."""
    scale = np.sqrt(np.sum(columns**2, axis=0)) + 1e-300
    return columns / scale, scale


def pole_slopes(slopes: FloatArray, coefficients: FloatArray) -> FloatArray:
    """Derivatives of the fitted motion with respect to (Re, Im) of each pole; shape (2 b, 2 m, k).

    `slopes` are those of `Samples.slopes`, `coefficients`, shape (p, k), those of the unscaled columns.
    """
    driven, free = amplitudes(coefficients)
    m, k = driven.shape
    found = np.empty((slopes.shape[0], 2 * m, k))
    for index in range(m):
        real, imag, free_real, free_imag = slopes[:, PER_MODE * index : PER_MODE * (index + 1)].T
        for place, turn in enumerate((1.0, 1j)):
            c, d = turn * driven[index], turn * free[index]
            found[:, 2 * index + place] = (
                np.outer(real, c.real)
                - np.outer(imag, c.imag)
                + np.outer(free_real, d.real)
                - np.outer(free_imag, d.imag)
            )
    return found


def significant(found: ResponseFit, penalty: float) -> BoolArray:
    """Modes without which chi-square would be larger by more than the criterion asks for; shape (m,)."""
    kept = np.ones(found.poles.size, dtype=bool)
    for index in range(kept.size):
        own = slice(FIXED + PER_MODE * index, FIXED + PER_MODE * (index + 1))
        total = 0.0
        for out in range(found.coefficients.shape[1]):
            values = found.coefficients[own, out]
            total += float(values @ np.linalg.pinv(found.coefficient_covariance[out, own, own]) @ values)
        kept[index] = 0.5 * total > penalty
    return kept


def left_at_mode(found: ResponseFit, index: int) -> tuple[float, float, float]:
    """Power of the residual about the resonance of a mode over two expectations.

    Returns
    -------
    over_weights : float
        Over the variance that its weights stand for; 1 where noise alone exceeds it with a probability above
        1 %. The variances of the mode are to be multiplied by it.
    over_beside : float
        Over the noise of the outputs on both sides, beyond the average that contains the mode, with the response to the
        noise of the input added.
    freedom : float
        Degrees of freedom of the residual there. If it is no noise but a response that is missing in the fit, of the
        same power, it moves the mode by up to the square root of this number, in sd (Cauchy-Schwarz inequality).
    """
    samples, pole = found.samples, found.poles[index]
    size = samples.frequency_hz.size
    step_hz = float(samples.frequency_hz[1] - samples.frequency_hz[0])
    hz = abs(pole) / (2.0 * np.pi)
    at = int(np.clip(np.round(hz / step_hz), 0, size - 1))
    reach = max(TUNING.least_bins, int(np.ceil(TUNING.half_widths * -pole.real / (2.0 * np.pi * step_hz))))
    own = slice(max(0, at - reach), at + reach + 1)
    square = np.abs(found.residual_bins[own]) ** 2
    free = 2.0 * (1.0 - found.leverage[own]) * samples.share_given
    power = float(np.sum(square * found.weights[own]) / np.sum(free))
    away = reach + NOISE.half_window
    sides = [found.noise.output[i] for i in (at - away, at + away) if 0 <= i < size]
    beside = np.exp(np.mean(np.log(sides), axis=0)) if sides else found.noise.output[at]
    gain = np.abs(found.transfer(samples.frequency_hz[own])) ** 2
    over_beside = float(np.sum(square / (beside + found.noise.input * gain)) / np.sum(free))
    # Outputs may have their noise in common: as many degrees of freedom as one of them has.
    freedom = float(np.sum(np.mean(free, axis=1)))
    is_noise = power < chi2.isf(FALSE_ALARM, freedom) / freedom
    return 1.0 if is_noise else power, over_beside, freedom


def model_bands(
    found: ResponseFit, frequency_hz: FloatArray, seed: list[int]
) -> tuple[FloatArray, FloatArray]:
    """5 % and 95 % quantiles of the modulus of the fitted response; shape (f, k) each."""
    generator = np.random.default_rng(seed)
    k = found.coefficients.shape[1]
    moves = _normal(generator, found.covariance)
    sizes = np.empty((TUNING.draws, frequency_hz.size, k))
    coefficients = np.zeros((TUNING.draws, *found.coefficients.shape))
    # Coefficients of the drift do not matter, and their variance would hide that of the others by rounding.
    used = np.r_[0, 1, FIXED : len(found.coefficients)]
    for out in range(k):
        slope = found.coefficient_slopes[out][used]
        own = found.coefficient_covariance[out][np.ix_(used, used)] - slope @ found.covariance @ slope.T
        scale = np.sqrt(np.maximum(np.diag(own), 1e-300))
        noise = scale * _normal(generator, own / np.outer(scale, scale))
        coefficients[:, used, out] = found.coefficients[used, out] + noise + moves @ slope.T
    loss = spline_gain(np.abs(found.poles) / (2.0 * np.pi), found.samples.step_s)
    for draw, move in enumerate(moves):
        own_move = move[: 2 * found.poles.size]
        poles = found.poles + own_move[0::2] + 1j * own_move[1::2]
        own = coefficients[draw]
        sizes[draw] = np.abs(transfer(frequency_hz, poles, own[:2], amplitudes(own)[0] * loss[:, None]))
    low, high = np.quantile(sizes, INTERVAL_ENDS, axis=0)
    return low, high


def _normal(generator: np.random.Generator, covariance: FloatArray) -> FloatArray:
    """Draws, shape (draws, p); directions whose variance is negative by rounding stay at 0."""
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    return np.asarray(generator.standard_normal((TUNING.draws, len(values))) @ root.T)


def local_polynomial(samples: Samples) -> tuple[ComplexArray, FloatArray]:
    """Frequency response at each bin and the sd of its real and imaginary part; shape (b, k) each.

    Around each bin, response and transient are polynomials of the bin's distance; NaN where the input has no power.

    Notes
    -----
    Pintelon & Schoukens, *System Identification*, 2nd ed. (2012), section 7.2, doi:10.1002/9781118287422. Biased where
    a resonance is narrower than the window (13 bins), and towards zero by noise in the input.
    """
    half, degree = TUNING.half_window, TUNING.degree
    offset = np.arange(-half, half + 1) / half
    powers = offset[:, None] ** np.arange(degree + 1)
    given, outputs = samples.input_bins, samples.bins(samples.values)
    b = len(outputs)
    starts = np.clip(np.arange(b) - half, 0, b - 2 * half - 1)
    u = sliding_window_view(given, 2 * half + 1)[starts]
    y = np.moveaxis(sliding_window_view(outputs, 2 * half + 1, axis=0)[starts], 1, 2)
    columns = np.concatenate([u[:, :, None] * powers, np.broadcast_to(powers, (b, *powers.shape))], axis=2)
    scale = np.sqrt(np.sum(np.abs(columns) ** 2, axis=1, keepdims=True)) + 1e-300
    inverse = np.linalg.pinv(columns / scale) / np.swapaxes(scale, 1, 2)
    solved = inverse @ y
    rest = y - columns @ solved
    dof = 2 * half + 1 - columns.shape[2]
    variance = np.sum(np.abs(rest) ** 2, axis=1) / (2.0 * dof)
    # At the bin itself, which is not the middle of the first and last windows.
    at = ((np.arange(b) - starts - half) / half)[:, None] ** np.arange(degree + 1)
    row = np.einsum("bd,bdw->bw", at, inverse[:, : degree + 1])
    value = np.einsum("bd,bdk->bk", at, solved[:, : degree + 1])
    sd = np.sqrt(variance * np.sum(np.abs(row) ** 2, axis=1)[:, None])
    power = np.mean(np.abs(u) ** 2, axis=1)
    weak = power < TUNING.least_power * np.median(power)
    return np.where(weak[:, None], np.nan, value), np.where(weak[:, None], np.nan, sd)


def coherence(samples: Samples) -> FloatArray:
    """Squared coherence of each output with the input over the windows of `local_polynomial`; shape (b, k)."""
    given, outputs = samples.input_bins[:, None], samples.bins(samples.values)

    def mean(values: FloatArray) -> FloatArray:
        return np.asarray(uniform_filter1d(values, 2 * TUNING.half_window + 1, axis=0))

    cross = outputs * np.conj(given)
    size = mean(np.abs(outputs) ** 2) * mean(np.abs(given) ** 2)
    return np.clip((mean(cross.real) ** 2 + mean(cross.imag) ** 2) / np.maximum(size, 1e-300), 0.0, 1.0)

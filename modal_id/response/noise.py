"""Noise of the outputs and of the input: from what a fit leaves, and from the spectrum of the input."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import rfft
from scipy.ndimage import uniform_filter1d
from scipy.signal.windows import blackmanharris

from modal_id.data import BEYOND_SD
from modal_id.response.columns import Samples
from modal_id.sentences import Note
from tracker import BoolArray, ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Averages of spectra, and when the spectrum of the input shows its noise."""

    #: [bins] half width of the average of the noise spectrum
    #: statistics: Standard deviation of the noise level 7 % (about 200 squares in a window).
    half_window: int = 48
    #: [1] share of a window that must be free of the input's noise to tell the outputs' noise from it
    least_free: float = 0.1
    #: [1] smallest noise variance over the mean square of the output
    #: physics: Data without noise, of rounding errors only.
    least_noise: float = 1e-16
    #: [1] bins of a spectrum with the four-term window that are independent of each other, per bin
    #: physics: Its noise bandwidth is two bins.
    independent: float = 0.5
    #: [1] power up to which a window of the input's spectrum belongs to its floor, over the least one
    #: statistics: Averages of 97 bins scatter by 14 %; the least and the largest of 25 differ by a factor of 1.8.
    floor: float = 2.0
    #: [1] share of the frequencies up to the Nyquist frequency that a floor must cover to be noise
    #: convention: chosen; effect not measured
    least_cover: float = 0.1
    #: [1] power that the input must have somewhere over its floor for the floor to be noise and not the input
    #: physics: An input below it would have no more than three times the amplitude of its noise.
    least_contrast: float = 10.0
    #: [1] amplitudes of the noise of the input whose probability is compared with what the fit leaves
    #: convention: A step of 2 % of the largest one.
    amplitudes: int = 51


TUNING = Tuning()


@dataclass(frozen=True)
class Noise:
    """Variances of real and imaginary parts of the transform.

    Attributes
    ----------
    output : array, shape (b, k)
        Of each output.
    input : float
        Of the input, which is white.
    """

    output: FloatArray
    input: float

    def weights(self, response: ComplexArray) -> FloatArray:
        """Inverse variance of the outputs less the response to the measured input; shape (b, k)."""
        return np.asarray(1.0 / (self.output + self.input * np.abs(response) ** 2))


@dataclass(frozen=True)
class InputNoise:
    """What is known of the noise of the input before a fit.

    Attributes
    ----------
    variance : float
        Its variance; an upper bound where it is not `known`.
    known : bool
    text : str
        Where it is from, for the report.
    """

    variance: float
    known: bool
    text: str

    @classmethod
    def of(cls, samples: Samples, stated_sd: float) -> InputNoise:
        """As stated; from a flat floor of the input's spectrum where that is NaN; else the floor is an upper bound.

        The spectrum is that with the four-term Blackman-Harris window, whose side lobes are 92 dB below the peak
        (doi:10.1109/PROC.1978.10837): the ends of a record leak less than that into the floor.
        """
        if np.isfinite(stated_sd):
            return cls(stated_sd**2, known=True, text=Note.STATED())
        values = samples.drive.at_samples()
        n = values.size
        window = blackmanharris(n, sym=False)
        power = np.abs(rfft((values - np.mean(values)) * window)) ** 2 / np.sum(window**2)
        # The lowest bins hold the main lobe of the mean, and a window of the average is to lie inside the spectrum.
        used = power[4:-1]
        size = min(2 * TUNING.half_window + 1, used.size)
        inside = slice(size // 2, used.size - size // 2)
        level = uniform_filter1d(used, size)[inside]
        # The running mean is rounded relative to the sum of its largest values.
        level = np.maximum(level, TUNING.least_noise * size * np.max(level) + 1e-300)
        floor = level < TUNING.floor * np.min(level)
        own, value = used[inside][floor], float(np.mean(level[floor]))
        half = own.size // 2
        # Content that falls with a power of the frequency passes if it is not told from a constant.
        scatter = BEYOND_SD * np.sqrt(2.0 / max(1.0, TUNING.independent * half))
        flat = abs(float(np.mean(own[:half])) - float(np.mean(own[half:]))) < scatter * value
        contrast = float(np.max(level)) > TUNING.least_contrast * value
        if not (flat and contrast and own.size > TUNING.least_cover * used.size):
            return cls(value, known=False, text="unknown")
        hz = (np.flatnonzero(floor)[[0, -1]] + 4 + size // 2) * (n - 1) / (n * samples.span_s)
        return cls(value, known=True, text=Note.FLOOR(low_hz=hz[0], high_hz=hz[1]))


def noise_after(
    samples: Samples,
    residual: ComplexArray,
    leverage: FloatArray,
    response: ComplexArray,
    given: InputNoise,
) -> Noise:
    """Noise spectra of the outputs, averaged over neighbouring bins, and the noise of the input.

    `residual`, `leverage` and `response` of the fit, shape (b, k). Where the noise of the input is not known, it is its
    mean over the probability of its amplitude, given the residual at the resonances and the upper bound.
    """
    square = np.abs(residual) ** 2
    free = 2.0 * (1.0 - leverage) * samples.share_given
    floor = TUNING.least_noise * np.mean(samples.outputs**2, axis=0) + 1e-300
    plain = np.maximum(average(square) / average(free), floor)
    gain = np.abs(response) ** 2
    variance = given.variance
    if variance == 0.0:
        return Noise(plain, 0.0)
    output = _of_outputs(plain, square, free, gain, variance, floor)
    if not given.known:
        variance = _likely_variance(residual, free, response, output, variance)
        output = _of_outputs(plain, square, free, gain, variance, floor)
    return Noise(output, variance)


def _of_outputs(
    plain: FloatArray,
    square: FloatArray,
    free: FloatArray,
    gain: FloatArray,
    variance: float,
    floor: FloatArray,
) -> FloatArray:
    """Noise of the outputs from the bins in which that of the input is smaller; shape (b, k)."""
    output = plain
    for _ in range(2):
        clear = (variance * gain < output).astype(float)
        known = average(clear) > TUNING.least_free
        below = np.maximum(average(free * clear), 1e-300)
        own = (average(square * clear) - variance * average(gain * free * clear)) / below
        # At least a tenth: the difference of two estimates scatters.
        own = np.maximum(own, 0.1 * plain * known + floor)
        output = np.column_stack([_across(own[:, out], known[:, out]) for out in range(own.shape[1])])
        output = np.maximum(output, floor)
    return output


def _likely_variance(
    residual: ComplexArray, free: FloatArray, response: ComplexArray, output: FloatArray, most: float
) -> float:
    """Variance of the noise of the input between 0 and `most`, all amplitudes being equally likely before.

    The residual of a bin has the covariance ``2 (diag(output) + v G G^H)``: its likelihood has a closed form in v.
    """
    weighted = response / output
    size = np.sum(np.abs(response) ** 2 / output, axis=1)
    along = np.abs(np.sum(np.conj(weighted) * residual, axis=1)) ** 2
    share = 0.5 * np.sum(np.abs(response) ** 2 / output * free, axis=1) / np.maximum(size, 1e-300)
    values = most * np.linspace(0.0, 1.0, TUNING.amplitudes) ** 2
    grown = 1.0 + values[:, None] * size
    log_odds = np.sum(0.5 * values[:, None] * along / grown - share * np.log(grown), axis=1)
    odds = np.exp(log_odds - np.max(log_odds))
    return float(np.sum(odds * values) / np.sum(odds))


def average(values: FloatArray) -> FloatArray:
    """Mean over neighbouring bins, in the first axis."""
    width = min(2 * TUNING.half_window + 1, values.shape[0])
    return np.asarray(uniform_filter1d(values, width, axis=0, mode="reflect"))


def _across(values: FloatArray, known: BoolArray) -> FloatArray:
    """The values, interpolated where they are not known; as they are where none is."""
    if not known.any():
        return values
    index = np.arange(values.size)
    return np.asarray(np.interp(index, index[known], values[known]))

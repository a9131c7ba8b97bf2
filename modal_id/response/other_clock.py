"""An input that was recorded at other times than the outputs: its values at theirs, in the band of the fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import kaiser_beta

from modal_id.sentences import Reason, Refusal
from tracker import FloatArray


@dataclass(frozen=True)
class Tuning:
    """Low-pass filter between two rates."""

    #: [dB] attenuation of the filter
    #: physics: The pass band is then unchanged to 2e-4.
    attenuation: float = 80.0
    #: [1] end of its pass band over the outputs' Nyquist frequency, that of the fit
    #: physics: Above it the spline through the input loses more than 4 % of it. What the outputs' rate folds lies above
    #: where the stop band begins as far above the Nyquist frequency.
    highest: float = 0.6
    #: [1] rate of the input over that of the outputs below which it is refused
    #: physics: An input that was recorded slower does not hold the whole band; 1 % for clocks that differ.
    least_rate: float = 0.99
    #: [1] change of a constant by missing samples under the filter from which the value is missing
    #: statistics: Of an impact, that share of its momentum; the noise of forces is about as large.
    most_lost: float = 0.01


TUNING = Tuning()
HIGHEST = TUNING.highest

# Parameter of Kaiser's window, and half length of the filter in steps of the outputs, by his formulas.
_BETA = float(kaiser_beta(TUNING.attenuation))
_HALF_LENGTH = 0.5 * (TUNING.attenuation - 7.95) / (2.285 * 2.0 * np.pi * (1.0 - HIGHEST))


def at_other_times(given_s: FloatArray, values: FloatArray, time_s: FloatArray) -> FloatArray | Refusal:
    """Values of an input, low-passed to the rate of the outputs; a reason where it was recorded slower.

    Parameters
    ----------
    given_s, values : array, shape (n,)
        The input, from which NaN are left out; steps may be uneven.
    time_s : array, shape (k,)
        Times of the outputs on the same clock.

    Returns
    -------
    array, shape (k,), or Refusal
        NaN where the input was not recorded. Frequencies up to 0.6 of the outputs' Nyquist frequency are unchanged to
        2e-4; an impact that is shorter than a step keeps its momentum.

    Notes
    -----
    The integral of the input and a sinc with Kaiser's window (IEEE Int. Symp. on Circuits and Systems 1974, pp. 20-23),
    by the trapezoidal rule over the input's samples. The response to what is left out lies above the band of the fit.
    """
    known = np.isfinite(values)
    given_s, values = given_s[known], values[known]
    steps_s = np.diff(given_s)
    weights = 0.5 * (np.append(steps_s, steps_s[-1]) + np.append(steps_s[0], steps_s))
    weights = np.minimum(weights, 2.0 * np.median(steps_s))
    step_s = float(np.median(np.diff(time_s)))
    rate, own_rate = 1.0 / float(np.median(steps_s)), 1.0 / step_s
    if rate < TUNING.least_rate * own_rate:
        return Reason.INPUT_SLOWER(rate_hz=rate, own_hz=own_rate)
    reach_s = _HALF_LENGTH * step_s
    first, last = np.searchsorted(given_s, time_s - reach_s), np.searchsorted(given_s, time_s + reach_s)
    found = np.full(time_s.size, np.nan)
    for k, at_s in enumerate(time_s):
        near = slice(int(first[k]), int(last[k]))
        x = (given_s[near] - at_s) / step_s
        window = np.i0(_BETA * np.sqrt(np.maximum(1.0 - (x / _HALF_LENGTH) ** 2, 0.0)))
        kernel = np.sinc(x) * window * weights[near]
        total = float(np.sum(kernel)) / (step_s * float(np.i0(_BETA)))
        if abs(total - 1.0) < TUNING.most_lost:
            found[k] = float(kernel @ values[near]) / float(np.sum(kernel))
    return found

"""The stretch of a record that is sampled at one rate, where the rate changes within the record."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import median_filter, uniform_filter1d

from modal_id.data.samples import runs
from tracker import FloatArray

# The rate at a sample is the median over `_STEPS` means, of `_AVERAGED` steps each: the means even out rounded time
# stamps, and gaps do not count in the median.
_STEPS, _AVERAGED = 33, 4
# Rates that differ by less than this factor are one rate with jitter or samples missing, and so are stretches of less
# than this share of samples and duration.
_SAME_RATE = 1.9
_LEAST_SHARE = 0.05
_LISTED = 4


def longest_at_one_rate(time_s: FloatArray) -> tuple[int, int, str] | None:
    """First row and end of the longest stretch at the rate of most samples, and a sentence; None where one rate is all.

    A motion above the Nyquist frequency of a slower stretch is an alias there and itself elsewhere: no one mode fits
    both.
    """
    if time_s.size < 2 * _STEPS:
        return None
    mean_s = uniform_filter1d(np.diff(time_s), _AVERAGED, mode="nearest")
    step_s = np.maximum(median_filter(mean_s, _STEPS, mode="nearest"), 1e-300)
    alike = np.abs(np.log(step_s / np.median(step_s))) < np.log(_SAME_RATE)
    for begin, end in runs(~alike):
        share = max((end - begin) / step_s.size, (time_s[end] - time_s[begin]) / (time_s[-1] - time_s[0]))
        alike[begin:end] = share < _LEAST_SHARE
    if np.all(alike):
        return None
    stretches = sorted([*runs(alike), *runs(~alike)], key=lambda run: int(run[0]))
    first, last = max(runs(alike), key=lambda run: int(run[1] - run[0]))
    listed = ", ".join(
        f"{1.0 / float(np.median(step_s[begin:end])):.4g} Hz from {time_s[begin]:.4g} s"
        for begin, end in stretches[:_LISTED]
    )
    note = (
        f"The sampling rate changes within the record ({listed}{', …' if len(stretches) > _LISTED else ''}): only the "
        f"stretch from {time_s[first]:.4g} s to {time_s[last]:.4g} s was used. Give the others as files of their own."
    )
    # A step lies between two rows.
    return int(first), int(last) + 1, note

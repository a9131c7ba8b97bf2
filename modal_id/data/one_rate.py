"""The stretch of a record that is sampled at one rate, where the rate changes within the record."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter, uniform_filter1d

from modal_id.data.samples import runs
from tracker import FloatArray


@dataclass(frozen=True)
class Tuning:
    """One sampling rate."""

    #: [1] number of mean steps whose median gives the sampling rate at a sample
    #: convention: Gaps do not count in the median.
    steps: int = 33
    #: [steps] number of steps in each mean
    #: convention: They even out rounded time stamps.
    averaged: int = 4
    #: [1] ratio of two rates below which they count as one rate with jitter or missing samples
    #: physics: A missing sample doubles a step.
    same_rate: float = 1.9
    #: [1] share of steps or duration, the larger of both, below which a stretch does not count as another rate
    least_share: float = 0.05
    #: [1] largest number of rates listed in a message
    listed: int = 4


TUNING = Tuning()


def longest_at_one_rate(time_s: FloatArray) -> tuple[int, int, str] | None:
    """First row and end of the longest stretch at the rate of most samples, and a sentence; None where one rate is all.

    A motion above the Nyquist frequency of a slower stretch is an alias there and itself elsewhere: no one mode fits
    both.
    """
    if time_s.size < 2 * TUNING.steps:
        return None
    mean_s = uniform_filter1d(np.diff(time_s), TUNING.averaged, mode="nearest")
    step_s = np.maximum(median_filter(mean_s, TUNING.steps, mode="nearest"), 1e-300)
    alike = np.abs(np.log(step_s / np.median(step_s))) < np.log(TUNING.same_rate)
    for begin, end in runs(~alike):
        share = max((end - begin) / step_s.size, (time_s[end] - time_s[begin]) / (time_s[-1] - time_s[0]))
        alike[begin:end] = share < TUNING.least_share
    if np.all(alike):
        return None
    stretches = sorted([*runs(alike), *runs(~alike)], key=lambda run: int(run[0]))
    first, last = max(runs(alike), key=lambda run: int(run[1] - run[0]))
    listed = ", ".join(
        f"{1.0 / float(np.median(step_s[begin:end])):.4g} Hz from {time_s[begin]:.4g} s"
        for begin, end in stretches[: TUNING.listed]
    )
    note = (
        f"The sampling rate changes within the record ({listed}{', …' if len(stretches) > TUNING.listed else ''}): "
        f"only the stretch from {time_s[first]:.4g} s to {time_s[last]:.4g} s was used. "
        "Give the others as files of their own."
    )
    # A step lies between two rows.
    return int(first), int(last) + 1, note

"""What a measured input and the outputs beside it must be to be fitted together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modal_id.data import runs
from tracker import BoolArray, DisplacementSeries, FloatArray, KnownInput


@dataclass(frozen=True)
class Tuning:
    """Inputs that are refused."""

    #: [samples] shortest run at an extreme value that is clipped
    least_run: int = 3
    #: [1] resolutions between a clipped value and those beside the run
    #: physics: A parabola that is constant to one resolution over three samples falls by less than five to the next.
    steps: float = 5.0
    #: [1] share of missing input samples above which the record is refused
    most_missing: float = 0.1
    #: [1] share of the rows with an output, between the first and the last, below which the rates differ
    #: convention: Every second row; lost frames are fewer.
    least_outputs: float = 0.55
    #: [1] least number of changes of an input that is held between them
    #: statistics: Of values that are free to change, as many would not all be apart by two samples and more.
    least_changes: int = 20


TUNING = Tuning()


def sparse_outputs(series: DisplacementSeries, known: KnownInput) -> str | None:
    """Why the outputs do not belong to the rows of the input; None where they do, or where there are none at all."""
    recorded = np.any(np.isfinite(series.values), axis=1)
    rows = np.flatnonzero(recorded)
    if not rows.size:
        return None
    share = float(np.mean(recorded[rows[0] : rows[-1] + 1]))
    if share >= TUNING.least_outputs:
        return None
    return (
        f"the outputs have a value in {100.0 * share:.0f} % of the rows of the input {known.name}: they were recorded "
        "at a lower rate; low-pass the input, and give it at the times of the outputs"
    )


def unusable(values: FloatArray, recorded: BoolArray, known: KnownInput) -> str | None:
    """Why an input cannot be used; None where it can.

    Parameters
    ----------
    values : array, shape (n,)
        The input at the rows of the fit; NaN where missing.
    recorded : bool array, shape (n,)
        Rows with an output.
    known : KnownInput
    """
    seen = np.isfinite(values)
    missing = float(np.mean(~seen[recorded]))
    if missing > TUNING.most_missing:
        return (
            f"the input {known.name} is missing in {100.0 * missing:.0f} % of the samples, more than "
            f"{100.0 * TUNING.most_missing:.0f} %: record it throughout and at the rate of the outputs, cut the record "
            "by onset_s and end_s to where it is given, or identify the outputs alone"
        )
    values = values[seen]
    spread = float(np.std(values))
    if np.ptp(values) == 0.0 or spread < 2.0 * known.sd:
        return (
            f"the input {known.name} does not move (standard deviation {spread:.3g} {known.unit}, noise "
            f"{known.sd:.3g}): identify the outputs alone, as a free decay"
        )
    apart = np.diff(np.flatnonzero(np.diff(values)))
    if apart.size >= TUNING.least_changes and np.min(apart) > 1:
        return (
            f"the input {known.name} keeps each value for {np.median(apart):.0f} samples: it was recorded at a "
            "lower rate than the outputs; record it at their rate, or give both at the times at which it was recorded"
        )
    if _is_clipped(values):
        return (
            f"the input {known.name} is clipped: many samples share its extreme value, so that the true input is not "
            "known; reduce the amplitude or use a larger range"
        )
    return None


def _is_clipped(values: FloatArray) -> bool:
    """Whether the input stays at an extreme value to which it came in larger steps than its resolution.

    A slow or coarsely quantised peak also repeats its extreme value, but leaves it by one or two steps.
    """
    steps = np.diff(np.unique(values))
    for turned in (values, -values):
        top = float(np.max(turned))
        for start, end in runs(turned == top):
            beside = np.append(turned[max(start - 1, 0) : start], turned[end : end + 1])
            if (
                end - start >= TUNING.least_run
                and beside.size
                and np.all(top - beside > TUNING.steps * np.min(steps))
            ):
                return True
    return False

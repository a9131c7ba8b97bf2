"""The stretch of a record that is sampled at one rate, where the rate changes within the record."""

from __future__ import annotations

import numpy as np

from tracker.arrays import FloatArray
from tracker.geometry.stamps import MIXED, RateSegment, most_frames, rate_segments

_TICKS_PER_STEP = 1e4
_LISTED = 4


def longest_at_one_rate(time_s: FloatArray) -> tuple[int, int, str] | None:
    """First row and end of the longest stretch at the rate of most samples, and a sentence; None where one rate is all.

    A motion above the Nyquist frequency of a slower stretch is an alias there and itself elsewhere: no one mode fits
    both.
    """
    steps_s = np.diff(time_s)
    tick_s = float(np.median(steps_s)) / _TICKS_PER_STEP if steps_s.size else 0.0
    if not tick_s > 0.0 or not float(np.max(steps_s)) < 1e9 * tick_s:
        return None
    segments = rate_segments(np.rint(steps_s / tick_s).astype(np.int64))
    rates = [1.0 / (s.step * tick_s) for s in segments]
    if not segments or max(rates) < MIXED * min(rates):
        return None
    chosen = max(most_frames(segments), key=lambda s: s.frames)
    # Samples between two segments, such as at gaps, belong to both if these have the same rate.
    first, last = _joined(segments, segments.index(chosen))
    seen = ", ".join(
        f"{rate:.4g} Hz from {time_s[s.first]:.4g} s"
        for s, rate in zip(segments[:_LISTED], rates, strict=False)
    )
    note = (
        f"The sampling rate changes within the record ({seen}{' and so on' if len(segments) > _LISTED else ''}): only "
        f"the stretch from {time_s[first]:.4g} s to {time_s[last]:.4g} s was used. Give the stretches as files of "
        "their own to use all."
    )
    return first, last + 1, note


def _joined(segments: tuple[RateSegment, ...], index: int) -> tuple[int, int]:
    """First and last row of the segments around one that have about its rate."""
    step = segments[index].step
    alike = [max(s.step, step) < MIXED * min(s.step, step) for s in segments]
    first = last = index
    while first > 0 and alike[first - 1]:
        first -= 1
    while last < len(segments) - 1 and alike[last + 1]:
        last += 1
    return segments[first].first, segments[last].last

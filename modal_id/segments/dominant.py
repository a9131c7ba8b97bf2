"""Frequency of the dominant motion of a record."""

from __future__ import annotations

import numpy as np

from modal_id.data import FitData
from modal_id.fit import Candidate, candidates
from modal_id.segments.find_onset import detrended
from modal_id.segments.swing import FEW_CYCLES
from tracker import FloatArray

# Shares of the record in which the dominant motion is looked for, each at every half of its length.
_WINDOWS = (1.0, 0.25, 0.0625)
_LEAST_WINDOW = 32
# Windows show one line within this logarithm of its frequency.
_SAME_LINE = 0.2
_LEAST_WINDOW_CYCLES = 6.0


def dominant_hz(
    data: FitData, variance: FloatArray, lowest_hz: float, wanted_hz: float | None
) -> float | None:
    """Frequency of the strongest line of any window, or of the line nearest to the wanted frequency."""
    found: list[Candidate] = []
    for share in _WINDOWS:
        length = int(share * data.time_s.size)
        if length < min(_LEAST_WINDOW, data.time_s.size):
            continue
        for first in range(0, data.time_s.size - length + 1, max(length // 2, 1)):
            part = data.rows(slice(first, first + length))
            # In part of the record, the curvature of a swing may appear as a line of a few cycles.
            least_hz = lowest_hz if share == 1.0 else max(lowest_hz, _LEAST_WINDOW_CYCLES / part.span_s)
            found += candidates(part, detrended(part), variance, least_hz, ())
    if not found:
        return None
    if wanted_hz is not None:
        nearest = min((c.frequency_hz for c in found), key=lambda f: abs(np.log(f / wanted_hz)))
        found = [c for c in found if abs(np.log(c.frequency_hz / nearest)) < _SAME_LINE]
    # A swing of few cycles is a motion of the support, if there is anything faster.
    many = [c for c in found if c.frequency_hz * data.span_s > FEW_CYCLES]
    return max(many or found, key=lambda c: c.score).frequency_hz

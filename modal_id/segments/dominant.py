"""Frequencies of the strongest lines of a record, and the slow swing of the supports below them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from modal_id.data import FitData, baseline_splines, detrended
from modal_id.fit import Candidate, candidates
from modal_id.solve import Problem, no_columns, solve_linear
from tracker import FloatArray


@dataclass(frozen=True)
class Tuning:
    """The dominant motion, and swings of the whole set-up."""

    #: [1] largest frequency of a swing over that of the motion
    slow: float = 0.25
    #: [1] bandwidth of the splines over the frequency of the swing
    #: physics: They follow a sine within 1e-3 of its amplitude.
    followed: float = 6.0
    #: [samples] shortest window
    least_window: int = 32
    #: [1] logarithm of the ratio of frequencies within which windows show one line
    same_line: float = 0.2
    #: [cycles] shortest window
    least_window_cycles: float = 6.0
    #: [1] largest number of lines in which changes of the motion are looked for
    #: convention: Limits the computing time.
    most_tones: int = 3
    #: [1] least distance of these lines over the dominant frequency
    #: physics: A block of two cycles fitted with both lines separates them.
    resolved: float = 0.75


TUNING = Tuning()


# A swing has fewer cycles than this, and less than this share of the frequency of the motion.
FEW_CYCLES = 12.0


def without_swing(data: FitData, variance: FloatArray, frequency_hz: float, detrended: FloatArray) -> FitData:
    """The data less its slow motion, where that has a line of few cycles far below `frequency_hz`.

    `variance`, shape (k,), is the noise variance of each channel, `detrended`, shape (n, k), the data less offset and
    trend. In windows of two cycles of the motion, the curvature of a swing many times as large looks like a change of
    the motion.
    """
    lines = [c.frequency_hz for c in candidates(data, detrended, variance, 0.0, ())]
    slow = [f for f in lines if f < TUNING.slow * frequency_hz and f * data.span_s < FEW_CYCLES]
    if not slow:
        return data
    bandwidth = min(TUNING.followed * max(slow), TUNING.slow * frequency_hz)
    problem = Problem(data, baseline_splines(data.time_s, bandwidth))
    moving = solve_linear(problem, no_columns(data.time_s)).residual
    return replace(data, values=np.where(data.weights > 0.0, moving, 0.0))


# Shares of the record in which the dominant motion is looked for, each at every half of its length.
_WINDOWS = (1.0, 0.25, 0.0625)


@dataclass(frozen=True)
class Tones:
    """Frequencies of the strongest lines, the dominant one first, and of that nearest to the wanted frequency."""

    strongest_hz: tuple[float, ...]
    wanted_hz: float

    @property
    def dominant_hz(self) -> float:
        """That of the strongest line."""
        return self.strongest_hz[0]


def find_tones(
    data: FitData, variance: FloatArray, lowest_hz: float, wanted_hz: float | None
) -> Tones | None:
    """The strongest lines of any window; None without any.

    Beside the dominant one, those that blocks of two of its cycles resolve.
    """
    found = sorted(_lines(data, variance, lowest_hz), key=lambda c: -c.score)
    if not found:
        return None
    # A swing of few cycles is a motion of the support, if there is anything faster.
    many = [c.frequency_hz for c in found if c.frequency_hz * data.span_s > FEW_CYCLES]
    hz = many or [c.frequency_hz for c in found]
    wanted = tones = hz[:1]
    if wanted_hz is not None:
        nearest = min((c.frequency_hz for c in found), key=lambda f: abs(np.log(f / wanted_hz)))
        wanted = [f for f in hz if abs(np.log(f / nearest)) < TUNING.same_line] or [nearest]
    for one in hz:
        if all(abs(one - tone) > TUNING.resolved * hz[0] for tone in tones):
            tones = [*tones, one]
    return Tones(tuple(tones[: TUNING.most_tones]), wanted[0])


def _lines(data: FitData, variance: FloatArray, lowest_hz: float) -> list[Candidate]:
    """Lines of the record, and of its quarters and sixteenths."""
    found: list[Candidate] = []
    for share in _WINDOWS:
        length = int(share * data.time_s.size)
        if length < min(TUNING.least_window, data.time_s.size):
            continue
        for first in range(0, data.time_s.size - length + 1, max(length // 2, 1)):
            part = data.rows(slice(first, first + length))
            # In part of the record, the curvature of a swing may appear as a line of a few cycles.
            least_hz = lowest_hz if share == 1.0 else max(lowest_hz, TUNING.least_window_cycles / part.span_s)
            found += candidates(part, detrended(part), variance, least_hz, ())
    return found

"""Which axis of an array without names is time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Tuning:
    """Axes of an array."""

    #: [channels] number below which the shorter axis is that of the channels
    #: convention: Records with fewer samples than this hold few cycles.
    few: int = 64
    #: [lines] lines along an axis that are examined
    lines: int = 64
    #: [cycles] fewest in a line of samples that oscillates
    #: physics: A mode shape has at most half as many as its number.
    cycles: int = 5
    #: [1] least share of the power of such a line within two bins of its maximum
    #: statistics: Channels in any order, as noise, have 5 bins of at least 32.
    share: float = 0.3
    #: [samples] of a column without the name of a time, from which on it is time where it always increases
    #: physics: No vibration increases with every one of so many.
    least_times: int = 16


TUNING = Tuning()


def samples_by_channels(array: NDArray[np.float64]) -> tuple[NDArray[np.float64], str]:
    """An array of two axes with time along the first, and a sentence on what was taken for time.

    The longer axis is time where the shorter one has few lines. Otherwise it is the axis whose first line increases in
    even steps; or the one along which the values oscillate. ValueError where that is neither or both.
    """
    rows, columns = array.shape
    if min(rows, columns) < TUNING.few:
        return (array if rows >= columns else array.T), "the longer axis is time."
    down, across = _is_even(array[:, 0]), _is_even(array[0])
    if down == across:
        down, across = _oscillates(array), _oscillates(array.T)
    if down == across:
        msg = (
            f"an array of {rows} by {columns} values, where either axis may be time; add the times as the "
            "first column, with a column for each channel"
        )
        raise ValueError(msg)
    return (array, "the first axis is time.") if down else (array.T, "the second axis is time.")


def _is_even(line: NDArray[np.float64]) -> bool:
    steps = np.diff(line)
    return bool(np.all(np.isfinite(steps)) and np.min(steps) > 0.0 and np.ptp(steps) < 0.5 * np.mean(steps))


def _oscillates(array: NDArray[np.float64]) -> bool:
    """Whether lines along the first axis oscillate at one frequency, for several cycles."""
    chosen = np.unique(np.linspace(0, array.shape[1] - 1, TUNING.lines).astype(int))
    lines = np.nan_to_num(array[:, chosen] - np.nanmean(array[:, chosen], axis=0))
    power = np.sum(np.abs(np.fft.rfft(lines * np.hanning(lines.shape[0])[:, None], axis=0)) ** 2, axis=1)
    most = int(np.argmax(power))
    share = float(np.sum(power[max(most - 2, 0) : most + 3])) / max(float(np.sum(power)), 1e-300)
    return most >= TUNING.cycles and share > TUNING.share

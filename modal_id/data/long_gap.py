"""The longest stretch of a record without a pause that is much longer than everything recorded."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tracker import FloatArray


@dataclass(frozen=True)
class Tuning:
    """Pauses."""

    #: [1] length of a pause in steps over the number of samples from which it is an error of the time stamps
    long: float = 10.0


TUNING = Tuning()


def longest_without_pause(time_s: FloatArray) -> tuple[int, int, str] | None:
    """First row and end of the stretch of most rows, and a sentence; None where there is no such pause.

    A pause of ten times as many steps as there are samples leaves the phases on its sides unrelated, and memory for
    baseline and spectrum would grow with the pause.
    """
    if time_s.size < 2:
        return None
    step_s = np.diff(time_s)
    pauses = np.flatnonzero(step_s > TUNING.long * time_s.size * np.median(step_s))
    if not pauses.size:
        return None
    edges = np.concatenate([[0], pauses + 1, [time_s.size]])
    longest = int(np.argmax(np.diff(edges)))
    first, end = int(edges[longest]), int(edges[longest + 1])
    note = (
        f"The record pauses for {np.max(step_s):.4g} s: only the {end - first} samples from {time_s[first]:.4g} s to "
        f"{time_s[end - 1]:.4g} s were used. Give the others as files of their own."
    )
    return first, end, note

"""What the whole record shows, in words: for the report and for the message of a refusal."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from modal_id.record import Segment
from tracker.arrays import BoolArray, FloatArray

# Of runs of repeated samples, only those of at least this length are segments of their own.
_LEAST_RUN = 3
_MOST_RUNS = 8


def whole_record(
    time_s: FloatArray, first_row: int, repeated: BoolArray, segments: tuple[Segment, ...]
) -> tuple[Segment, ...]:
    """Segments of the whole record in order of time.

    `segments` are those of the rows from `first_row` on for which the mask `repeated` is given; the rest of the record
    was not used.
    """
    last_row = first_row + repeated.size - 1
    complete = list(segments)
    trailing = int(np.argmin(repeated[::-1]))
    if trailing >= _LEAST_RUN:
        until = float(time_s[last_row - trailing])
        complete = [replace(s, end_s=min(s.end_s, until)) for s in segments if s.start_s < until]
    if first_row > 0:
        complete.append(Segment("not used", float(time_s[0]), float(time_s[first_row])))
    if last_row < time_s.size - 1:
        complete.append(Segment("not used", float(time_s[last_row]), float(time_s[-1])))
    edges = np.flatnonzero(np.diff(np.concatenate([[0], repeated.astype(np.int8), [0]]))).reshape(-1, 2)
    runs = sorted((run for run in edges if run[1] - run[0] >= _LEAST_RUN), key=lambda run: run[0] - run[1])
    for start, end in runs[:_MOST_RUNS]:
        note = f"{end - start} samples repeat the one before and were left out."
        begin, until = float(time_s[first_row + start]), float(time_s[first_row + end - 1])
        complete.append(Segment("repeated", begin, until, note))
    return in_order(complete)


def in_order(segments: Iterable[Segment]) -> tuple[Segment, ...]:
    """The segments in order of time."""
    return tuple(sorted(segments, key=lambda s: (s.start_s, s.end_s)))


def seen(segments: tuple[Segment, ...]) -> str:
    """One sentence that lists the segments."""
    return f"The record shows: {'; '.join(str(s) for s in segments)}." if segments else ""

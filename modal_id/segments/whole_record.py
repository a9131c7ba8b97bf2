"""Segments of the whole record, with what was not used, and what a stretch without a fit shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from modal_id.data import FitData, detrended, rough_variance, runs
from modal_id.fit import MAX_DAMPING, power_spectrum
from modal_id.record import Segment
from modal_id.sentences import Note, Reason, Refusal
from tracker import BoolArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """What the notes mention."""

    #: [samples] shortest run of repeated samples that is a segment of its own
    least_run: int = 3
    #: [1] largest number of such segments that are named
    most_runs: int = 8
    #: [sd] half the range between the 1 % and 99 % quantiles from which a channel moves
    #: physics: Of white noise it is 2.3.
    moves: float = 4.0
    #: [sd] power of a band above its mean that is no white noise
    #: statistics: No band of white noise reaches it.
    beyond_noise: float = 8.0


TUNING = Tuning()


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
    if trailing >= TUNING.least_run:
        until = float(time_s[last_row - trailing])
        complete = [replace(s, end_s=min(s.end_s, until)) for s in segments if s.start_s < until]
    if first_row > 0:
        complete.append(Segment("not used", float(time_s[0]), float(time_s[first_row])))
    if last_row < time_s.size - 1:
        complete.append(Segment("not used", float(time_s[last_row]), float(time_s[-1])))
    long = [run for run in runs(repeated) if run[1] - run[0] >= TUNING.least_run]
    for start, end in sorted(long, key=lambda run: run[0] - run[1])[: TUNING.most_runs]:
        begin, until = float(time_s[first_row + start]), float(time_s[first_row + end - 1])
        complete.append(Segment("repeated", begin, until, Note.REPEATED_RUN(count=end - start)))
    return tuple(sorted((s for s in complete if s.end_s > s.start_s), key=lambda s: (s.start_s, s.end_s)))


def no_line(data: FitData, channels: Sequence[str], unit: str, within_s: tuple[float, float]) -> Refusal:
    """Reason why a stretch has no fit: the motion of the channel that moves most, compared with its noise."""
    noise = np.sqrt(rough_variance(data))
    moves = np.zeros(len(channels))
    for k in range(moves.size):
        values = data.values[data.weights[:, k] > 0.0, k]
        moves[k] = 0.5 * float(np.subtract(*np.quantile(values, [0.99, 0.01]))) if values.size else 0.0
    most = int(np.argmax(moves / noise))
    (start_s, end_s), channel, half, sd = within_s, channels[most], moves[most], noise[most]
    motion = Note.MOVES_MOST(start_s=start_s, end_s=end_s, channel=channel, half=half, unit=unit, noise=sd)
    hz, share, of_noise = _fullest_band(data, most)
    if share < of_noise and moves[most] < TUNING.moves * noise[most]:
        return Reason.NO_VIBRATION(motion=motion, most_zeta=MAX_DAMPING)
    if share > of_noise:
        motion += Note.FULLEST_BAND(percent=100.0 * share, hz=hz)
    return Reason.NO_STEADY_FREQUENCY(motion=motion, most_zeta=MAX_DAMPING)


def _fullest_band(data: FitData, channel: int) -> tuple[float, float, float]:
    """Centre in Hz of the band, 5 % to either side, that holds most of the power of a channel beyond the average.

    Also its share of the power, and a share that no band of white noise exceeds.
    """
    own = data.channels(np.array([channel]))
    hz, power = power_spectrum(own.time_s, detrended(own), own.weights, rough_variance(own))
    total = np.append(0.0, np.cumsum(power))
    lower, upper = np.searchsorted(hz, 0.95 * hz), np.searchsorted(hz, 1.05 * hz, side="right")
    share = (total[upper] - total[lower]) / max(float(total[-1]), 1e-300)
    # There are two bins to a degree of freedom, and each has a relative standard deviation of 1.
    expected = (upper - lower) / hz.size
    spread = expected / np.sqrt(np.maximum(0.5 * (upper - lower), 1.0))
    best = int(np.argmax((share - expected) / np.maximum(spread, 1e-300)))
    return float(hz[best]), float(share[best]), float((expected + TUNING.beyond_noise * spread)[best])

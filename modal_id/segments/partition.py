"""Where a motion changes: the exact optimum over all divisions of a record into damped waves and noise.

In each block of a record, its strongest lines have a complex amplitude. Over a stretch without a change, that of a
line is noise, or ``c exp(l b + q b^2)`` in block b with q = 0 or not, or the sum of two such waves with q = 0. With the
costs of all stretches, dynamic programming finds the best division (Jackson et al. 2005,
doi:10.1109/LSP.2001.838216).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modal_id.data import FitData
from modal_id.segments.line_blocks import LineBlocks, line_blocks, shortest_block_s
from modal_id.segments.stop import ChangeSearch
from modal_id.segments.stretch_costs import stretch_costs
from tracker import BoolArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Division of a record."""

    #: [1] error of the amplitude of a block over that amplitude
    #: convention: Damping that depends on the amplitude, modes nearby.
    relative_error: float = 0.02
    #: [cycles] least length of a motion between two changes
    #: convention: Of less, no damping can be known.
    apart_cycles: float = 1.5
    #: [blocks] longest stretch of noise that belongs to a change
    #: convention: A click without duration disturbs two.
    click_blocks: int = 3
    #: [1] power of a longer one, over the geometric mean of those beside it, from which it does
    #: convention: Rest is quieter.
    loud: float = 0.1
    #: [1] mean square residual of a block over the median from which it holds a burst
    #: statistics: Three standard deviations.
    burst: float = 9.0


TUNING = Tuning()


@dataclass(frozen=True)
class Change:
    """A change of the motion between two times, relative to the data; what lies between them may be unknown."""

    low_s: float
    high_s: float
    unknown: bool = False

    @property
    def place(self) -> ChangeSearch:
        """Where it is looked for."""
        width_s = self.high_s - self.low_s
        return ChangeSearch(0.5 * (self.low_s + self.high_s), width_s / float(np.sqrt(12.0)), width_s)

    def later(self, by_s: float) -> Change:
        """The same, later by `by_s`."""
        return Change(self.low_s + by_s, self.high_s + by_s, self.unknown)


def find_changes(data: FitData, tones_hz: tuple[float, ...], begin_s: float) -> list[Change]:
    """Changes of the motion after a time, in order, each to about two blocks of the fewest cycles.

    `tones_hz` are the strongest lines, the dominant one first. Neighbours with too little between them are one.
    """
    blocks = line_blocks(data.between(begin_s, float(data.time_s[-1])), tones_hz)
    least_s = TUNING.apart_cycles / tones_hz[0]
    found: list[Change] = []
    for change in _divided(blocks):
        one = change.later(begin_s)
        one = one if one.unknown else _refined(data, tones_hz, begin_s, one)
        if found and one.low_s - found[-1].high_s < least_s:
            last = found.pop()
            one = Change(last.low_s, max(one.high_s, last.high_s), unknown=True)
        found.append(one)
    return found


def _divided(blocks: LineBlocks) -> list[Change]:
    """Changes between the stretches of the best division."""
    edges, seen = blocks.edges_s, _seen(blocks)
    if edges.size < 4:
        return []
    cost, noise = _total_costs(blocks)
    stretches = best_division(cost)
    power = np.nansum(np.abs(blocks.amplitude) ** 2, axis=(1, 2))
    mean = [float(np.mean(power[first:last])) for first, last in stretches]
    found: list[Change] = []
    low_s = -1.0
    for k, (first, last) in enumerate(stretches[1:], 1):
        noisy, gap = low_s >= 0.0, not (seen[first - 1] and seen[first])
        low_s = low_s if noisy else _reach(edges, seen, first)[0]
        inner = k + 1 < len(stretches) and noise[first, last] and not noise[stretches[k + 1]]
        loud = inner and mean[k] > TUNING.loud * np.sqrt(mean[k - 1] * mean[k + 1])
        if inner and (loud or last - first <= TUNING.click_blocks):
            continue
        at = first
        # The last blocks of a burst may have been taken for motion; a motion far above the noise is loud to its end.
        while noisy and at + 1 < last and blocks.excess[at + 1] > TUNING.burst:
            at += 1
        at = first if at + 1 == last else at
        found.append(Change(low_s, _reach(edges, seen, at)[1], noisy or gap))
        low_s = -1.0
    return sorted(found + _bursts(blocks, found), key=lambda one: one.low_s)


def _seen(blocks: LineBlocks) -> BoolArray:
    """Whether a block has samples; shape (b,)."""
    return np.asarray(np.any(np.isfinite(blocks.amplitude), axis=(1, 2)))


def _reach(edges: FloatArray, seen: BoolArray, at: int) -> tuple[float, float]:
    """Limits a block to either side of an edge; in a gap, the change may be anywhere."""
    before = int(np.max(np.flatnonzero(seen[:at]), initial=0))
    return float(edges[before]), float(edges[at + 1 + int(np.argmax(seen[at:]))])


def _bursts(blocks: LineBlocks, known: list[Change]) -> list[Change]:
    """Runs of blocks that the lines explain far worse than most, apart from known changes and the first block."""
    loud = np.flatnonzero(np.nan_to_num(blocks.excess) > TUNING.burst)
    groups = np.split(loud, np.flatnonzero(np.diff(loud) > 1) + 1) if loud.size else []
    found = []
    for group in groups:
        low_s, high_s = float(blocks.edges_s[group[0]]), float(blocks.edges_s[group[-1] + 1])
        if group[0] > 0 and all(high_s < other.low_s or low_s > other.high_s for other in known):
            found.append(Change(low_s, high_s, unknown=True))
    return found


def _refined(data: FitData, tones_hz: tuple[float, ...], begin_s: float, change: Change) -> Change:
    """A change between blocks of many cycles, to those of fewer."""
    shortest_s = shortest_block_s(data, tones_hz)
    while (width_s := change.high_s - change.low_s) > 3.0 * shortest_s:
        low_s = max(begin_s, change.low_s - width_s)
        blocks = line_blocks(data.between(low_s, change.high_s + width_s), tones_hz)
        if blocks.edges_s.size < 4:
            break
        closer = _of_two(blocks)
        if closer.high_s - closer.low_s >= width_s:
            break
        change = closer.later(low_s)
    return change


def likeliest_change(data: FitData, tones_hz: tuple[float, ...]) -> Change | None:
    """Where a motion that changes once does so most likely; None where there are too few blocks."""
    blocks = line_blocks(data, tones_hz)
    return _refined(data, tones_hz, 0.0, _of_two(blocks)) if blocks.edges_s.size >= 4 else None


def _of_two(blocks: LineBlocks) -> Change:
    """The change between the two stretches of the best division into two."""
    cost, _ = _total_costs(blocks)
    at = int(np.argmin(cost[0, 1:-1] + cost[1:-1, -1])) + 1
    return Change(*_reach(blocks.edges_s, _seen(blocks), at))


def _total_costs(blocks: LineBlocks) -> tuple[FloatArray, BoolArray]:
    """Cost of every stretch from one edge to another, shape (b + 1, b + 1), and whether all of it is noise."""
    penalty = float(np.log(max(2.0 * blocks.amplitude[:, 0].size, 2.0)))
    count = blocks.edges_s.size
    total, noise = np.full((count, count), penalty), np.ones((count, count), dtype=bool)
    for tone in range(blocks.amplitude.shape[1]):
        own = np.ascontiguousarray(blocks.amplitude[:, tone])
        cost, waves = stretch_costs(own, TUNING.relative_error, penalty)
        total += cost
        noise &= waves == 0.0
    return total, noise


def best_division(cost: FloatArray) -> list[tuple[int, int]]:
    """Stretches, as edges, whose costs have the least sum."""
    count = cost.shape[0]
    least, source = np.zeros(count), np.zeros(count, dtype=int)
    for end in range(1, count):
        total = least[:end] + cost[:end, end]
        source[end] = int(np.argmin(total))
        least[end] = total[source[end]]
    found, end = [], count - 1
    while end > 0:
        found.append((int(source[end]), end))
        end = int(source[end])
    return found[::-1]

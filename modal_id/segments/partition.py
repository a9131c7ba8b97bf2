"""Where a motion changes: the exact optimum over all divisions of a record into damped waves and noise.

In each block of a record, its strongest lines have a complex amplitude. Over a stretch without a change, that of a
line is noise, or ``c exp(l b + q b^2)`` in block b with q = 0 or not, or the sum of two such waves with q = 0. With the
costs of all stretches, dynamic programming finds the best division (Jackson et al. 2005,
doi:10.1109/LSP.2001.838216).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numba import njit

from modal_id.data import FitData
from modal_id.segments.change_point import ChangeSearch
from modal_id.segments.lines import LineBlocks, block_count, line_blocks, shortest_block_s
from tracker import BoolArray, ComplexArray, FloatArray

# Gauss-Newton steps of each wave; the pole of a stretch is nearly known from one block less.
_STEPS = 3
# Largest exponent of a wave from the middle of its stretch, largest growth of a pole in a block, and of each of two.
_MOST_GROWTH, _GROWS, _BOTH_GROW = 40.0, 0.05, 1.3
# Share of the largest possible determinant below which two columns are one.
_SINGULAR = 1e-12


@njit(cache=True, nogil=True, error_model="numpy")
def stretch_costs(
    amplitude: ComplexArray, relative: float, penalty: float, inner: int | np.int64
) -> FloatArray:
    """-2 ln likelihood and penalty of the stretch from each edge to each later one.

    Parameters
    ----------
    amplitude : complex array, shape (b, k)
        In b blocks, with noise of variance 1; NaN where unknown.
    relative : float
        Error of a wave over its amplitude.
    penalty : float
        Cost of each real parameter.
    inner : int
        0 for only the stretches from the first edge or to the last one: those of a division into two.

    Returns
    -------
    array, shape (b + 1, b + 1)
        Infinite where there is no stretch.
    """
    n, k = amplitude.shape
    cost = np.full((n + 1, n + 1), np.inf)
    a, power, weight = _weighted(amplitude, relative)
    for i in range(n):
        log_variance, energy, count, lag, before = 0.0, 0.0, 0, 0j, 0.0
        for j in range(i + 1, n + 1):
            b = j - 1
            if weight[b] > 0.0:
                log_variance -= 2.0 * k * np.log(weight[b])
                energy += power[b]
                count += 1
                if b > i and weight[b - 1] > 0.0:
                    for c in range(k):
                        lag += np.conj(a[b - 1, c]) * a[b, c] * weight[b - 1]
                    before += (power[b - 1] - k) * weight[b - 1]
            if inner == 0 and i > 0 and j < n:
                continue
            variance = max(energy / max(k * count, 1), 1.0)
            cost[i, j] = 2.0 * k * count * np.log(variance) + 2.0 * energy / variance + penalty
            if count >= 3:
                start = lag / max(before, 0.8 * abs(lag) + 1e-300)
                found = _of_waves(a[i:j], weight[i:j], start, count, penalty)
                cost[i, j] = min(found + log_variance, cost[i, j])
    return cost


@njit(cache=True, nogil=True, error_model="numpy")
def _weighted(amplitude: ComplexArray, relative: float) -> tuple[ComplexArray, FloatArray, FloatArray]:
    """Amplitudes, power and weight of each block; 0 where unknown."""
    n, k = amplitude.shape
    a, power, weight = np.zeros((n, k), dtype=np.complex128), np.zeros(n), np.zeros(n)
    for b in range(n):
        own = 0.0
        for c in range(k):
            own += _power(amplitude[b, c])
        if np.isfinite(own):
            power[b], weight[b] = own, 1.0 / (1.0 + relative**2 * own)
            # one by one: numba takes 1.4 s to compile the assignment of a row
            for c in range(k):
                a[b, c] = amplitude[b, c]
    return a, power, weight


@njit(cache=True, nogil=True, error_model="numpy")
def _of_waves(a: ComplexArray, weight: FloatArray, start: complex, count: int, penalty: float) -> float:
    """Least cost of a wave, a bent wave or two waves."""
    k = a.shape[1]
    # no literals, for each of which numba would compile the function again
    straight, bent = np.int64(0), np.int64(1)
    rss, pole = _one_wave(a, weight, start, straight)
    least = rss + (2 + 2 * k) * penalty
    if count >= 5 and rss > 2.0 * k * count + 2.0 * penalty:
        rss, _ = _one_wave(a, weight, pole, bent)
        least = min(least, rss + (4 + 2 * k) * penalty)
        if count >= 6 and rss > 2.0 * k * count + 2.0 * k * penalty:
            least = min(least, _two_waves(a, weight) + (4 + 4 * k) * penalty)
    return float(least)


@njit(cache=True, nogil=True, error_model="numpy")
def _one_wave(
    a: ComplexArray, weight: FloatArray, pole: complex, bends: int | np.int64
) -> tuple[float, complex]:
    """Twice the least weighted rss of ``c exp(l x + q x^2)``, x from the middle, and ``exp(l)``; q = 0 unless it bends.

    The wave is holomorphic in l and q: Gauss-Newton in complex numbers, the amplitudes projected out.
    """
    n, k = a.shape
    middle = 0.5 * (n - 1)
    rate, bend = np.log(pole + 1e-12), 0j
    least, best = np.inf, rate
    wave, own = np.empty(n, dtype=np.complex128), np.empty(n)
    for _ in range(_STEPS + 1):
        s0 = s1 = s2 = s3 = s4 = 0.0
        for b in range(n):
            x = b - middle
            exponent = (rate + bend * x) * x
            wave[b] = np.exp(complex(min(exponent.real, _MOST_GROWTH), exponent.imag))
            own[b] = weight[b] * _power(wave[b])
            s0 += own[b]
            s1 += own[b] * x
            s2 += own[b] * x * x
            s3 += own[b] * x * x * x
            s4 += own[b] * x * x * x * x
        rss, size, g1, g2 = 0.0, 0.0, 0j, 0j
        for c in range(k):
            amplitude = 0j
            for b in range(n):
                amplitude += weight[b] * np.conj(wave[b]) * a[b, c]
            amplitude /= max(s0, 1e-300)
            size += _power(amplitude)
            for b in range(n):
                x, left = b - middle, a[b, c] - amplitude * wave[b]
                rss += 2.0 * weight[b] * _power(left)
                along = weight[b] * np.conj(amplitude * wave[b]) * left * x
                g1 += along
                g2 += along * x
        if rss < least:
            least, best = rss, rate
        h11, h12, h22 = (s2 - s1**2 / s0) * size, (s3 - s1 * s2 / s0) * size, (s4 - s2**2 / s0) * size
        det = h11 * h22 - h12 * h12
        if not h11 > 0.0 or (bends and not det > _SINGULAR * h11 * h22):
            break
        if bends:
            rate, bend = rate + (h22 * g1 - h12 * g2) / det, bend + (h11 * g2 - h12 * g1) / det
        else:
            rate = rate + g1 / h11
            # no free motion grows
            rate = complex(min(rate.real, _GROWS), rate.imag)
    return least, np.exp(best)


@njit(cache=True, nogil=True, error_model="numpy")
def _two_waves(a: ComplexArray, weight: FloatArray) -> float:
    """Twice the least weighted rss of two waves, from linear prediction by two blocks and Gauss-Newton."""
    g00 = g11 = 0.0
    g01 = y0 = y1 = 0j
    for b in range(2, weight.size):
        if weight[b - 2] * weight[b - 1] * weight[b] > 0.0:
            for c in range(a.shape[1]):
                first, second, third = a[b - 2, c], a[b - 1, c], a[b, c]
                g00 += _power(second)
                g11 += _power(first)
                g01 += np.conj(second) * first
                y0 += np.conj(second) * third
                y1 += np.conj(first) * third
    det = g00 * g11 - _power(g01)
    if not det > _SINGULAR * g00 * g11:
        return np.inf
    first, second = (g11 * y0 - g01 * y1) / det, (g00 * y1 - np.conj(g01) * y0) / det
    root = np.sqrt(first * first + 4.0 * second)
    p, q = 0.5 * (first + root), 0.5 * (first - root)
    least = np.inf
    for _ in range(_STEPS + 1):
        if not (max(abs(p), abs(q)) < _BOTH_GROW and abs(p - q) > 1e-9):
            break
        rss, step_p, step_q = _step_of_two(a, weight, p, q)
        least = min(least, rss)
        if not np.isfinite(step_p.real + step_p.imag + step_q.real + step_q.imag):
            break
        p, q = p + step_p, q + step_q
    return least


@njit(cache=True, nogil=True, error_model="numpy")
def _step_of_two(
    a: ComplexArray, weight: FloatArray, p: complex, q: complex
) -> tuple[float, complex, complex]:
    """Twice the weighted rss of two waves, and the Gauss-Newton steps of their poles, amplitudes projected out."""
    wave, slope = _wave_and_slope(a.shape[0], p, q)
    gram, cross = _products(wave, wave, weight), _products(wave, slope, weight)
    unknown = complex(np.nan, 0.0)
    if not _is_regular(gram):
        return np.inf, unknown, unknown
    inverse = _inverse(gram)
    # what the waves do not explain of the derivatives
    for u in range(2):
        share0 = inverse[0, 0] * cross[0, u] + inverse[0, 1] * cross[1, u]
        share1 = inverse[1, 0] * cross[0, u] + inverse[1, 1] * cross[1, u]
        for b in range(a.shape[0]):
            slope[b, u] -= share0 * wave[b, 0] + share1 * wave[b, 1]
    rss, sizes, along = _residual_of_two(a, weight, wave, slope, inverse)
    curvature = _products(slope, slope, weight) * sizes
    if not _is_regular(curvature):
        return rss, unknown, unknown
    solved = _inverse(curvature)
    step_p = solved[0, 0] * along[0] + solved[0, 1] * along[1]
    return rss, step_p, solved[1, 0] * along[0] + solved[1, 1] * along[1]


@njit(cache=True, nogil=True, error_model="numpy")
def _wave_and_slope(n: int, p: complex, q: complex) -> tuple[ComplexArray, ComplexArray]:
    """The wave of each pole in n blocks, and its derivative by the pole."""
    wave, slope = np.zeros((n, 2), dtype=np.complex128), np.zeros((n, 2), dtype=np.complex128)
    wave[0] = 1.0
    for b in range(1, n):
        wave[b, 0], wave[b, 1] = wave[b - 1, 0] * p, wave[b - 1, 1] * q
        slope[b, 0] = slope[b - 1, 0] * p + wave[b - 1, 0]
        slope[b, 1] = slope[b - 1, 1] * q + wave[b - 1, 1]
    return wave, slope


@njit(cache=True, nogil=True, error_model="numpy")
def _residual_of_two(
    a: ComplexArray, weight: FloatArray, wave: ComplexArray, slope: ComplexArray, inverse: ComplexArray
) -> tuple[float, ComplexArray, ComplexArray]:
    """Twice the weighted rss of two waves, inner products of their amplitudes, and of their slopes with the rest."""
    n, k = a.shape
    sizes, along = np.zeros((2, 2), dtype=np.complex128), np.zeros(2, dtype=np.complex128)
    rss = 0.0
    for c in range(k):
        moment0 = moment1 = 0j
        for b in range(n):
            moment0 += weight[b] * np.conj(wave[b, 0]) * a[b, c]
            moment1 += weight[b] * np.conj(wave[b, 1]) * a[b, c]
        own0 = inverse[0, 0] * moment0 + inverse[0, 1] * moment1
        own1 = inverse[1, 0] * moment0 + inverse[1, 1] * moment1
        for b in range(n):
            left = a[b, c] - own0 * wave[b, 0] - own1 * wave[b, 1]
            rss += 2.0 * weight[b] * _power(left)
            along[0] += np.conj(own0 * slope[b, 0]) * weight[b] * left
            along[1] += np.conj(own1 * slope[b, 1]) * weight[b] * left
        sizes[0, 0] += np.conj(own0) * own0
        sizes[0, 1] += np.conj(own0) * own1
        sizes[1, 0] += np.conj(own1) * own0
        sizes[1, 1] += np.conj(own1) * own1
    return rss, sizes, along


@njit(cache=True, nogil=True, error_model="numpy")
def _power(z: complex) -> float:
    return float(z.real * z.real + z.imag * z.imag)


@njit(cache=True, nogil=True, error_model="numpy")
def _products(left: ComplexArray, right: ComplexArray, weight: FloatArray) -> ComplexArray:
    """Weighted inner products of the columns of two arrays of two columns."""
    found = np.zeros((2, 2), dtype=np.complex128)
    for b in range(weight.size):
        for u in range(2):
            for v in range(2):
                found[u, v] += weight[b] * np.conj(left[b, u]) * right[b, v]
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _is_regular(m: ComplexArray) -> bool:
    return bool(abs(m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0]) > _SINGULAR * abs(m[0, 0] * m[1, 1]))


@njit(cache=True, nogil=True, error_model="numpy")
def _inverse(m: ComplexArray) -> ComplexArray:
    """Of a matrix of two rows."""
    found = np.empty((2, 2), dtype=np.complex128)
    det = m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0]
    found[0, 0], found[0, 1], found[1, 0], found[1, 1] = (
        m[1, 1] / det,
        -m[0, 1] / det,
        -m[1, 0] / det,
        m[0, 0] / det,
    )
    return found


@dataclass(frozen=True)
class Tuning:
    """Division of a record."""

    #: [1] error of the amplitude of a block over that amplitude
    #: convention: Damping that depends on the amplitude, modes nearby.
    relative_error: float = 0.02
    #: [cycles] least length of a motion between two changes
    #: convention: Of less, no damping can be known.
    apart_cycles: float = 1.5
    #: [1] width of a change over that from blocks of more cycles, from which finer blocks tell no more
    #: measurement: Widths that shrink by rounding errors alone never ended the search (*own* 13408).
    closer: float = 0.9
    #: [blocks] longest click
    #: convention: One without duration disturbs two.
    click_blocks: int = 3
    #: [1] mean square residual of a block over the median from which it holds a burst
    #: statistics: Three standard deviations.
    burst: float = 9.0


TUNING = Tuning()


@dataclass(frozen=True)
class Change:
    """A change of the motion between two times, relative to the data; what lies between them may be unknown.

    If it is no click, it stands for the changes `instead`.
    """

    low_s: float
    high_s: float
    unknown: bool = False
    instead: tuple[Change, ...] = ()

    @property
    def place(self) -> ChangeSearch:
        """Where it is looked for."""
        width_s = self.high_s - self.low_s
        return ChangeSearch(0.5 * (self.low_s + self.high_s), width_s / float(np.sqrt(12.0)), width_s)

    def later(self, by_s: float) -> Change:
        """The same, later by `by_s`."""
        instead = tuple(one.later(by_s) for one in self.instead)
        return Change(self.low_s + by_s, self.high_s + by_s, self.unknown, instead)


def find_changes(data: FitData, tones_hz: tuple[float, ...], begin_s: float) -> list[Change]:
    """Changes of the motion after a time, in order, each to about two blocks of the fewest cycles.

    `tones_hz` are the strongest lines, the dominant one first. Blocks of two cycles of a slow line may hold all cycles
    of a fast one between two changes: these are looked for in the fast ones alone as well.
    """
    part = data.between(begin_s, float(data.time_s[-1]))
    found: list[Change] = []
    finest = 0
    for least_hz in sorted(tones_hz):
        count = block_count(part, tones_hz, least_hz)
        if finest >= count:
            break
        finest = count
        closer = _changes(data, line_blocks(part, tones_hz, least_hz), tones_hz, least_hz, begin_s)
        found = [
            one for one in found if all(c.high_s < one.low_s or c.low_s > one.high_s for c in closer)
        ] + closer
    return sorted(found, key=lambda one: one.low_s)


def _changes(
    data: FitData, blocks: LineBlocks, tones_hz: tuple[float, ...], least_hz: float, begin_s: float
) -> list[Change]:
    """Changes of the lines from `least_hz` on; neighbours with too little between them are one."""
    least_s = TUNING.apart_cycles / max(tones_hz[0], least_hz)
    found: list[Change] = []
    for change in _divided(blocks):
        one = _refined(data, tones_hz, begin_s, change.later(begin_s), least_hz)
        if found and one.low_s - found[-1].high_s < least_s:
            last = found.pop()
            inner = tuple(c for both in (last, one) for c in both.instead or (both,))
            instead = inner if last.instead or one.instead else ()
            one = Change(last.low_s, max(one.high_s, last.high_s), unknown=True, instead=instead)
        found.append(one)
    return found


def _divided(blocks: LineBlocks) -> list[Change]:
    """Changes between the stretches of the best division."""
    edges, seen = blocks.edges_s, _seen(blocks)
    if edges.size < 4:
        return []
    found = [
        Change(*_reach(edges, seen, first), unknown=not (seen[first - 1] and seen[first]))
        for first, _ in best_division(_total_costs(blocks))[1:]
    ]
    return sorted(_with_bursts(blocks, found), key=lambda one: one.low_s)


def _seen(blocks: LineBlocks) -> BoolArray:
    """Whether a block has samples; shape (b,)."""
    return np.asarray(np.any(np.isfinite(blocks.amplitude), axis=(1, 2)))


def _reach(edges: FloatArray, seen: BoolArray, at: int) -> tuple[float, float]:
    """Limits a block to either side of an edge; in a gap, the change may be anywhere."""
    before = int(np.max(np.flatnonzero(seen[:at]), initial=0))
    return float(edges[before]), float(edges[at + 1 + int(np.argmax(seen[at:]))])


def _with_bursts(blocks: LineBlocks, known: list[Change]) -> list[Change]:
    """Changes with runs of blocks that the lines explain far worse than most, but for that of the first block.

    A long one with several known changes may be one instead of these. A long one up to the end of the record is a
    motion with further modes, and its begin the change.
    """
    loud = np.flatnonzero(np.nan_to_num(blocks.excess) > TUNING.burst)
    groups = np.split(loud, np.flatnonzero(np.diff(loud) > 1) + 1) if loud.size else []
    for group in groups:
        low_s, high_s = float(blocks.edges_s[group[0]]), float(blocks.edges_s[group[-1] + 1])
        long = group.size > TUNING.click_blocks
        to_end = long and group[-1] + 2 == blocks.edges_s.size
        limits = _reach(blocks.edges_s, _seen(blocks), int(group[0])) if to_end else (low_s, high_s)
        others = [one for one in known if high_s < one.low_s or low_s > one.high_s]
        instead = tuple(sorted((one for one in known if one not in others), key=lambda one: one.low_s))
        if group[0] > 0 and (not instead or (long and not to_end and len(instead) > 1)):
            known = [*others, Change(*limits, not to_end, instead)]
    return known


def _refined(
    data: FitData, tones_hz: tuple[float, ...], begin_s: float, change: Change, least_hz: float = 0.0
) -> Change:
    """A change between blocks of many cycles, to those of fewer, unless what lies between them is unknown."""
    if change.unknown:
        instead = (_refined(data, tones_hz, begin_s, one, least_hz) for one in change.instead)
        return replace(change, instead=tuple(instead))
    shortest_s = shortest_block_s(data, tones_hz, least_hz)
    while (width_s := change.high_s - change.low_s) > 3.0 * shortest_s:
        low_s = max(begin_s, change.low_s - width_s)
        blocks = line_blocks(data.between(low_s, change.high_s + width_s), tones_hz, least_hz)
        if blocks.edges_s.size < 4:
            break
        closer = _of_two(blocks)
        if closer.high_s - closer.low_s > TUNING.closer * width_s:
            break
        change = closer.later(low_s)
    return change


def likeliest_change(data: FitData, tones_hz: tuple[float, ...]) -> Change | None:
    """Where a motion that changes once does so most likely; None where there are too few blocks."""
    blocks = line_blocks(data, tones_hz)
    return _refined(data, tones_hz, 0.0, _of_two(blocks)) if blocks.edges_s.size >= 4 else None


def _of_two(blocks: LineBlocks) -> Change:
    """The change between the two stretches of the best division into two."""
    cost = _total_costs(blocks, inner=0)
    at = int(np.argmin(cost[0, 1:-1] + cost[1:-1, -1])) + 1
    return Change(*_reach(blocks.edges_s, _seen(blocks), at))


def _total_costs(blocks: LineBlocks, inner: int = 1) -> FloatArray:
    """Cost of every stretch from one edge to another, shape (b + 1, b + 1)."""
    penalty = float(np.log(max(2.0 * blocks.amplitude[:, 0].size, 2.0)))
    count = blocks.edges_s.size
    total = np.full((count, count), penalty)
    for tone in range(blocks.amplitude.shape[1]):
        own = np.ascontiguousarray(blocks.amplitude[:, tone])
        total += stretch_costs(own, TUNING.relative_error, penalty, np.int64(inner))
    return total


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

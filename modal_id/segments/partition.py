"""Where a motion changes: the exact optimum over all divisions of a record into damped waves and noise.

A record is cut into blocks. In each, the strongest lines have a complex amplitude. Over a stretch without a change,
that of a line is noise, or ``c exp(l b + q b^2)`` in block b with q = 0 or not, or the sum of two such waves with
q = 0. The costs of all stretches are known, so dynamic programming finds the best division (Jackson et al. 2005,
doi:10.1109/LSP.2001.838216).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from modal_id.data import FitData
from tracker import BoolArray, ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Division of a record."""

    #: [cycles] shortest block
    #: physics: Two separate a wave from an offset and its slope.
    cycles: float = 2.0
    #: [cycles] least length of a motion between two changes
    #: convention: Of less, no damping can be known.
    apart_cycles: float = 1.5
    #: [samples] shortest block
    least_rows: int = 8
    #: [1] largest number of blocks
    #: convention: The time of a search grows with its cube.
    most_blocks: int = 128
    #: [1] share of a block's samples that must be there
    complete: float = 0.6
    #: [1] error of the amplitude of a block over that amplitude
    #: convention: Damping that depends on the amplitude, modes nearby.
    relative_error: float = 0.02
    #: [blocks] fewest blocks from which the noise of a line is measured
    noise_blocks: int = 12
    #: [1] mean square residual of a block over the median from which it holds a burst
    #: statistics: Three standard deviations.
    burst: float = 9.0
    #: [blocks] longest stretch of noise that belongs to a change
    #: convention: A click without duration disturbs two.
    click_blocks: int = 3
    #: [1] power of a longer one, over the lesser of those beside it, from which it does: rest is quieter
    loud: float = 0.1


TUNING = Tuning()

# Gauss-Newton steps of each wave; the nearest pole of a stretch is known from one block to the next.
_STEPS = 3


@dataclass(frozen=True)
class Change:
    """A change of the motion between two times, relative to the data; what lies between them may be unknown."""

    low_s: float
    high_s: float
    unknown: bool = False


def find_changes(data: FitData, tones_hz: tuple[float, ...], begin_s: float) -> list[Change]:
    """Changes of the motion after a time, in order, each to about a block.

    `tones_hz` are the strongest lines, at least a block's resolution apart, the dominant one first.
    """
    found = _divided(data.between(begin_s, float(data.time_s[-1])), tones_hz, begin_s)
    refined = [one if one.unknown else _refined(data, tones_hz, begin_s, one) for one in found]
    least_s = TUNING.apart_cycles / tones_hz[0]
    merged: list[Change] = []
    for one in refined:
        if merged and one.low_s - merged[-1].high_s < least_s:
            one = Change(merged[-1].low_s, max(one.high_s, merged.pop().high_s), unknown=True)
        merged.append(one)
    return merged


def _divided(data: FitData, tones_hz: tuple[float, ...], from_s: float) -> list[Change]:
    """Changes in data whose times are relative to `from_s`."""
    edges = _edges(data, tones_hz)
    if edges.size < 4:
        return []
    amplitude, excess = block_amplitudes(data, tones_hz, edges)
    cost, noise = _total_costs(amplitude)
    stretches = _best_division(cost)
    power = np.nansum(np.abs(amplitude) ** 2, axis=(1, 2))
    mean = [float(np.mean(power[first:last])) for first, last in stretches]
    found: list[Change] = []
    low = None
    seen = np.any(np.isfinite(amplitude), axis=(1, 2))
    for k, (first, last) in enumerate(stretches[1:], 1):
        noisy = low is not None
        low = low if noisy else _reach(edges, seen, first)[0]
        gap = not (seen[first - 1] and seen[first])
        inner = k + 1 < len(stretches) and noise[first, last]
        loud = inner and mean[k] > TUNING.loud * min(mean[k - 1], mean[k + 1])
        if inner and (loud or last - first <= TUNING.click_blocks):
            continue
        # A burst of noise may hide that its last blocks belong to it.
        while noisy and first + 1 < last and excess[first + 1] > TUNING.burst:
            first += 1
        high = _reach(edges, seen, first)[1]
        found.append(Change(from_s + float(low), from_s + float(high), noisy or gap))
        low = None
    found += _bursts(edges, excess, from_s, found)
    return sorted(found, key=lambda one: one.low_s)


def _reach(edges: FloatArray, seen: BoolArray, at: int) -> tuple[float, float]:
    """A block to either side of an edge; in a gap, the change may be anywhere."""
    before = int(np.max(np.flatnonzero(seen[:at]), initial=0))
    return float(edges[before]), float(edges[at + 1 + int(np.argmax(seen[at:]))])


def _bursts(edges: FloatArray, excess: FloatArray, from_s: float, known: list[Change]) -> list[Change]:
    """Runs of blocks, apart from known changes and the first block, that the lines explain far worse than most."""
    loud = np.flatnonzero(np.nan_to_num(excess) > TUNING.burst)
    groups = np.split(loud, np.flatnonzero(np.diff(loud) > 1) + 1) if loud.size else []
    found = []
    for group in groups:
        one = Change(from_s + float(edges[group[0]]), from_s + float(edges[group[-1] + 1]), True)
        if group[0] > 0 and all(one.high_s < other.low_s or one.low_s > other.high_s for other in known):
            found.append(one)
    return found


def _refined(data: FitData, tones_hz: tuple[float, ...], begin_s: float, change: Change) -> Change:
    """A change between blocks of many cycles, to those of fewer."""
    shortest = _shortest_s(data, tones_hz)
    while (width := change.high_s - change.low_s) > 3.0 * shortest:
        low = max(begin_s, change.low_s - width)
        part = data.between(low, min(change.high_s + width, float(data.time_s[-1])))
        edges = _edges(part, tones_hz)
        if edges.size < 4 or 3.0 * (edges[1] - edges[0]) > width:
            break
        amplitude, _ = block_amplitudes(part, tones_hz, edges)
        cost, _ = _total_costs(amplitude)
        at = int(np.argmin(cost[0, 1:-1] + cost[1:-1, -1])) + 1
        first_s, last_s = _reach(edges, np.any(np.isfinite(amplitude), axis=(1, 2)), at)
        if last_s - first_s >= width:
            break
        change = Change(low + first_s, low + last_s)
    return change


def _shortest_s(data: FitData, tones_hz: tuple[float, ...]) -> float:
    rows = max(TUNING.least_rows, 2 * len(tones_hz) + 6)
    return max(TUNING.cycles / min(tones_hz), rows * data.step_s)


def _edges(data: FitData, tones_hz: tuple[float, ...]) -> FloatArray:
    last_s = float(data.time_s[-1]) + data.step_s
    count = min(TUNING.most_blocks, int(last_s / _shortest_s(data, tones_hz)))
    return np.linspace(0.0, last_s, count + 1)


def block_amplitudes(
    data: FitData, tones_hz: tuple[float, ...], edges_s: FloatArray
) -> tuple[ComplexArray, FloatArray]:
    """Amplitude of each tone in each block over its noise, and the mean square residual of a block over the median.

    Shapes (blocks, tones, k) and (blocks,); NaN where samples are missing.

    Least squares with a Hann window, beside an offset and its slope. The noise is the larger of that of white noise
    with the residual of the median block, and of what a block differs from its neighbours.
    """
    blocks, tones, channels = edges_s.size - 1, len(tones_hz), data.values.shape[1]
    amplitude = np.full((blocks, tones, channels), np.nan, dtype=complex)
    gain, square = np.full(amplitude.shape, np.nan), np.full((blocks, channels), np.nan)
    rows = np.searchsorted(data.time_s, edges_s)
    for b in range(blocks):
        some = slice(rows[b], rows[b + 1])
        time_s = data.time_s[some]
        place = (time_s - edges_s[b]) / (edges_s[b + 1] - edges_s[b]) - 0.5
        turn = 2.0 * np.pi * time_s[:, None] * np.array(tones_hz)
        columns = np.concatenate([np.cos(turn), -np.sin(turn), np.ones((time_s.size, 1)), place[:, None]], 1)
        usual = (edges_s[b + 1] - edges_s[b]) / data.step_s
        for k in range(channels):
            weights = data.weights[some, k]
            if np.count_nonzero(weights) < max(columns.shape[1] + 2, TUNING.complete * usual):
                continue
            window = weights * np.cos(np.pi * place) ** 2
            gram = columns.T @ (window[:, None] * columns)
            size = np.sqrt(np.diag(gram)) + 1e-300
            solve = np.linalg.inv(gram / np.outer(size, size) + 1e-9 * np.eye(size.size)) / np.outer(size, size)
            filters = solve @ (window[:, None] * columns).T
            beta = filters @ data.values[some, k]
            left = data.values[some, k] - columns @ beta
            freedom = max(1.0 - columns.shape[1] / np.count_nonzero(weights), 0.1)
            amplitude[b, :, k] = beta[:tones] + 1j * beta[tones : 2 * tones]
            power = np.sum(filters**2 / np.maximum(weights, 1e-300), axis=1)
            gain[b, :, k] = np.sqrt(power[:tones] + power[tones : 2 * tones])
            square[b, k] = np.sum(window * left**2) / np.sum(window / np.maximum(weights, 1e-300)) / freedom
    noise = np.sqrt(np.maximum(_median(square), (1e-6 * np.max(np.abs(data.values), axis=0)) ** 2 + 1e-300))
    known = np.isfinite(square)
    excess = np.sum(np.where(known, square / noise**2, 0.0), axis=1) / np.maximum(np.sum(known, axis=1), 1)
    with np.errstate(invalid="ignore"):
        return _over_neighbours(amplitude / (gain * noise)), excess


def block_levels(data: FitData, tones_hz: tuple[float, ...]) -> tuple[FloatArray, FloatArray]:
    """Centres of the blocks of a record, and the rms over the channels of the amplitude over its noise, shape (b,).

    That of the tone which is strongest there; NaN where samples are missing. Noise alone has a level of about 1.
    """
    edges = _edges(data, tones_hz)
    if edges.size < 2:
        return np.zeros(0), np.zeros(0)
    square = np.abs(block_amplitudes(data, tones_hz, edges)[0]) ** 2
    level = np.sqrt(np.max(np.mean(square, axis=2), axis=1))
    return 0.5 * (edges[1:] + edges[:-1]), level


def _median(values: FloatArray) -> FloatArray:
    """Median of each column's finite values; 1 without any."""
    return np.array([np.median(v[np.isfinite(v)]) if np.any(np.isfinite(v)) else 1.0 for v in values.T])


def _over_neighbours(amplitude: ComplexArray) -> ComplexArray:
    """The amplitudes, those of a channel divided by the noise that their third differences show where it is over 1."""
    scaled = amplitude.copy()
    for tone in range(amplitude.shape[1]):
        for k in range(amplitude.shape[2]):
            own = amplitude[:, tone, k]
            if np.count_nonzero(np.isfinite(own)) < TUNING.noise_blocks:
                continue
            turn = np.nan_to_num(own[1:] * np.conj(own[:-1]))
            mean = np.convolve(turn, np.ones(5), "same")
            level = own * np.exp(-1j * np.cumsum(np.append(0.0, np.angle(mean))))
            differs = np.abs(np.diff(level, 3)) ** 2
            differs = differs[np.isfinite(differs)]
            # third differences of white noise have 20 times its variance; the 35 % quantile of an exponential is .43
            if differs.size >= TUNING.noise_blocks // 2:
                scaled[:, tone, k] /= max(1.0, float(np.sqrt(np.quantile(differs, 0.35) / (20.0 * 0.43))))
    return scaled


def _total_costs(amplitude: ComplexArray) -> tuple[FloatArray, FloatArray]:
    """Cost of every stretch from one edge to another, shape (b + 1, b + 1), and whether all of it is noise."""
    penalty = float(np.log(2.0 * amplitude[:, 0].size))
    blocks = amplitude.shape[0]
    total, noise = np.full((blocks + 1, blocks + 1), penalty), np.ones((blocks + 1, blocks + 1), dtype=bool)
    for tone in range(amplitude.shape[1]):
        cost, waves = _costs(np.ascontiguousarray(amplitude[:, tone]), TUNING.relative_error, penalty)
        total += cost
        noise &= waves == 0
    return total, noise


def _best_division(cost: FloatArray) -> list[tuple[int, int]]:
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


@njit(cache=True, nogil=True, error_model="numpy")
def _costs(a: ComplexArray, relative: float, penalty: float) -> tuple[FloatArray, FloatArray]:
    """-2 ln likelihood of every stretch plus `penalty` for each parameter, and its number of waves (1.5: curved).

    The noise of `a`, shape (b, k), has a variance of 1; to its relative error belongs `relative`.
    """
    n, k = a.shape
    cost, waves = np.full((n + 1, n + 1), np.inf), np.zeros((n + 1, n + 1))
    power, weight = np.zeros(n), np.zeros(n)
    for b in range(n):
        own = np.sum(np.abs(a[b]) ** 2)
        if np.isfinite(own):
            power[b], weight[b] = own, 1.0 / (1.0 + relative**2 * own)
    for i in range(n):
        log_variance, energy, count = 0.0, 0.0, 0
        lag, before = 0j, 0.0
        for j in range(i + 1, n + 1):
            b = j - 1
            if weight[b] > 0.0:
                log_variance -= 2.0 * k * np.log(weight[b])
                energy += power[b]
                count += 1
                if b > i and weight[b - 1] > 0.0:
                    lag += np.sum(np.conj(a[b - 1]) * a[b]) * weight[b - 1]
                    before += (power[b - 1] - k) * weight[b - 1]
            variance = max(energy / max(k * count, 1), 1.0)
            best = 2.0 * k * count * np.log(variance) + 2.0 * energy / variance + penalty
            which = 0.0
            if count >= 3:
                start = lag / max(before, 0.8 * abs(lag) + 1e-300)
                rss, pole, _ = _one_wave(a, weight, i, j, start, False)
                one = rss + log_variance + (2 + 2 * k) * penalty
                if one < best:
                    best, which = one, 1.0
                if count >= 5 and rss > 2.0 * k * count + 2.0 * penalty:
                    rss, _, _ = _one_wave(a, weight, i, j, pole, True)
                    one = rss + log_variance + (4 + 2 * k) * penalty
                    if one < best:
                        best, which = one, 1.5
                    if count >= 6 and rss > 2.0 * k * count + 2.0 * k * penalty:
                        two = _two_waves(a, weight, i, j) + log_variance + (4 + 4 * k) * penalty
                        if two < best:
                            best, which = two, 2.0
            cost[i, j], waves[i, j] = best, which
    return cost, waves


@njit(cache=True, nogil=True, error_model="numpy")
def _one_wave(
    a: ComplexArray, weight: FloatArray, i: int, j: int, pole: complex, curved: bool
) -> tuple[float, complex, complex]:
    """Least of twice the weighted rss of ``c exp(l x + q x^2)``, ``exp(l)`` and q; x from the middle, q = 0 unless curved.

    The wave is holomorphic in l and q: Gauss-Newton in complex numbers, the amplitudes projected out.
    """
    k = a.shape[1]
    middle = 0.5 * (i + j - 1)
    rate, bend = np.log(pole + 1e-12), 0j
    least, best_rate, best_bend = np.inf, rate, bend
    amplitude = np.empty(k, dtype=np.complex128)
    for _ in range(_STEPS + 1):
        # sums over |wave|^2 of 1, x, x^2, x^3, x^4
        s = np.zeros(5)
        amplitude[:] = 0.0
        for b in range(i, j):
            x = b - middle
            wave = np.exp(min((rate * x + bend * x * x).real, 40.0) + 1j * (rate * x + bend * x * x).imag)
            own = weight[b] * abs(wave) ** 2
            for power in range(5):
                s[power] += own * x**power
            if own > 0.0:
                amplitude += weight[b] * np.conj(wave) * a[b]
        amplitude /= max(s[0], 1e-300)
        size = np.sum(np.abs(amplitude) ** 2)
        rss, g1, g2 = 0.0, 0j, 0j
        for b in range(i, j):
            if weight[b] > 0.0:
                x = b - middle
                wave = np.exp(min((rate * x + bend * x * x).real, 40.0) + 1j * (rate * x + bend * x * x).imag)
                left = a[b] - amplitude * wave
                rss += 2.0 * weight[b] * np.sum(np.abs(left) ** 2)
                along = weight[b] * np.sum(np.conj(amplitude * wave) * left)
                g1 += along * x
                g2 += along * x * x
        if rss < least:
            least, best_rate, best_bend = rss, rate, bend
        h11 = (s[2] - s[1] ** 2 / s[0]) * size
        h12, h22 = (s[3] - s[1] * s[2] / s[0]) * size, (s[4] - s[2] ** 2 / s[0]) * size
        if not h11 > 0.0:
            break
        if curved:
            det = h11 * h22 - h12 * h12
            if not det > 1e-12 * h11 * h22:
                break
            rate += (h22 * g1 - h12 * g2) / det
            bend += (h11 * g2 - h12 * g1) / det
        else:
            rate += g1 / h11
            # no free motion grows
            rate = min(rate.real, 0.05) + 1j * rate.imag
    return least, np.exp(best_rate), best_bend


@njit(cache=True, nogil=True, error_model="numpy")
def _two_waves(a: ComplexArray, weight: FloatArray, i: int, j: int) -> float:
    """Twice the least weighted rss of two waves, from linear prediction by two blocks and Gauss-Newton."""
    gram, moment = np.zeros((2, 2), dtype=np.complex128), np.zeros(2, dtype=np.complex128)
    for b in range(i, j - 2):
        if weight[b] > 0.0 and weight[b + 1] > 0.0 and weight[b + 2] > 0.0:
            gram[0, 0] += np.sum(np.abs(a[b + 1]) ** 2)
            gram[1, 1] += np.sum(np.abs(a[b]) ** 2)
            gram[0, 1] += np.sum(np.conj(a[b + 1]) * a[b])
            moment[0] += np.sum(np.conj(a[b + 1]) * a[b + 2])
            moment[1] += np.sum(np.conj(a[b]) * a[b + 2])
    gram[1, 0] = np.conj(gram[0, 1])
    det = gram[0, 0] * gram[1, 1] - abs(gram[0, 1]) ** 2
    if not det.real > 1e-12 * (gram[0, 0] * gram[1, 1]).real:
        return np.inf
    first = (gram[1, 1] * moment[0] - gram[0, 1] * moment[1]) / det
    second = (gram[0, 0] * moment[1] - gram[1, 0] * moment[0]) / det
    root = np.sqrt(first * first + 4.0 * second + 0j)
    poles = np.array([0.5 * (first + root), 0.5 * (first - root)])
    least = np.inf
    for _ in range(_STEPS + 1):
        if not (abs(poles[0]) < 1.3 and abs(poles[1]) < 1.3) or abs(poles[0] - poles[1]) < 1e-9:
            break
        rss, step = _step_of_two(a, weight, i, j, poles)
        least = min(least, rss)
        if not np.all(np.isfinite(step)):
            break
        poles = poles + step
    return least


@njit(cache=True, nogil=True, error_model="numpy")
def _step_of_two(
    a: ComplexArray, weight: FloatArray, i: int, j: int, poles: ComplexArray
) -> tuple[float, ComplexArray]:
    """Twice the weighted rss of two waves, and the Gauss-Newton step of their poles, amplitudes projected out."""
    n, k = j - i, a.shape[1]
    wave, slope = np.empty((n, 2), dtype=np.complex128), np.empty((n, 2), dtype=np.complex128)
    for u in range(2):
        z, dz = 1.0 + 0j, 0j
        for b in range(n):
            wave[b, u], slope[b, u] = z, dz
            dz = dz * poles[u] + z
            z = z * poles[u]
    gram, cross = np.zeros((2, 2), dtype=np.complex128), np.zeros((2, 2), dtype=np.complex128)
    inner = np.zeros((2, 2), dtype=np.complex128)
    moment = np.zeros((2, k), dtype=np.complex128)
    for b in range(n):
        w = weight[i + b]
        if w > 0.0:
            for u in range(2):
                for v in range(2):
                    gram[u, v] += w * np.conj(wave[b, u]) * wave[b, v]
                    cross[u, v] += w * np.conj(wave[b, u]) * slope[b, v]
                    inner[u, v] += w * np.conj(slope[b, u]) * slope[b, v]
                for c in range(k):
                    moment[u, c] += w * np.conj(wave[b, u]) * a[i + b, c]
    none = np.full(2, np.nan, dtype=np.complex128)
    det = gram[0, 0] * gram[1, 1] - gram[0, 1] * gram[1, 0]
    if not abs(det) > 1e-12 * abs(gram[0, 0] * gram[1, 1]):
        return np.inf, none
    inverse = np.array([[gram[1, 1], -gram[0, 1]], [-gram[1, 0], gram[0, 0]]]) / det
    amplitude = inverse @ moment
    rss, along = 0.0, np.zeros(2, dtype=np.complex128)
    for b in range(n):
        w = weight[i + b]
        if w > 0.0:
            for c in range(k):
                left = a[i + b, c] - amplitude[0, c] * wave[b, 0] - amplitude[1, c] * wave[b, 1]
                rss += 2.0 * w * abs(left) ** 2
                for u in range(2):
                    along[u] += w * np.conj(amplitude[u, c] * slope[b, u]) * left
    apart = inner - np.conj(cross.T) @ inverse @ cross
    both = apart * (np.conj(amplitude) @ amplitude.T)
    det = both[0, 0] * both[1, 1] - both[0, 1] * both[1, 0]
    if not abs(det) > 1e-12 * abs(both[0, 0] * both[1, 1]):
        return rss, none
    return rss, np.array([both[1, 1] * along[0] - both[0, 1] * along[1], both[0, 0] * along[1] - both[1, 0] * along[0]]) / det

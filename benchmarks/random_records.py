"""Random records of decays as people make them: at rest, driven, plucked, stopped by hand, hit, moved, with gaps."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from modal_id.posterior import modal_bound
from tracker import DisplacementSeries, FloatArray

Rng = np.random.Generator
# frequency, damping ratio, amplitude
Mode = tuple[float, float, float]

EVENTS = ("rest", "drive", "plucks", "hand stop", "click", "step", "gaps", "outliers", "repeats")
# The strongest mode is driven and stopped; the others are at most this strong.
_WEAKER = 0.6


@dataclass(frozen=True)
class RandomRecord:
    """A record with its truth: modes, strongest first, and its longest undisturbed decay.

    `frequency_bound`, `damping_bound` are the Cramer-Rao bounds of the strongest mode from that decay, relative.
    """

    series: DisplacementSeries
    frequency_hz: tuple[float, ...]
    damping_ratio: tuple[float, ...]
    events: tuple[str, ...]
    decay_s: tuple[float, float]
    frequency_bound: float
    damping_bound: float

    @property
    def is_informative(self) -> bool:
        """Whether the longest undisturbed decay determines frequency and damping ratio to 1 %."""
        return max(self.frequency_bound, self.damping_bound) < 0.01


def random_record(seed: int) -> RandomRecord:
    """The record with this number."""
    rng = np.random.default_rng([20261122, seed])
    # Displacements are in units of the amplitude of the strongest mode.
    per_cycle = float(np.exp(rng.uniform(np.log(3.2), np.log(60.0))))
    frequency = float(np.exp(rng.uniform(np.log(1.0), np.log(300.0))))
    rate = per_cycle * frequency
    samples = int(np.exp(rng.uniform(np.log(500), np.log(6000))))
    time = np.arange(samples) / rate
    modes = _modes(rng, frequency, rate)
    events = tuple(e for e in EVENTS if rng.random() < 0.22)
    y, starts, breaks = _motion(rng, time, modes, events)
    noise = float(np.exp(rng.uniform(np.log(5e-4), np.log(0.05))))
    values, breaks = _disturbed(rng, time, y, noise, frequency, events, breaks)
    begin, end, amplitude = _longest_decay(time, starts, breaks)
    bound = modal_bound(
        time[(time >= begin) & (time < end)] - begin,
        modes[0][0],
        modes[0][1],
        np.array([amplitude]),
        0.3,
        np.array([noise]),
    )
    return RandomRecord(
        DisplacementSeries(
            name="record",
            channels=("m0",),
            time_s=time,
            values=values[:, None],
            sd=np.full((time.size, 1), np.nan),
            unit="px",
            positions_mm=np.full(1, np.nan),
        ),
        tuple(f for f, _, _ in modes),
        tuple(z for _, z, _ in modes),
        events,
        (begin, end),
        bound.frequency_sd_hz / modes[0][0],
        bound.damping_sd / modes[0][1],
    )


def _modes(rng: Rng, frequency: float, rate: float) -> list[Mode]:
    """(frequency, damping ratio, amplitude) of one to three modes, 8 % or more apart and below 0.45 of the rate."""
    modes = [(frequency, _damping(rng), 1.0)]
    for _ in range(rng.integers(0, 3)):
        other = float(np.exp(rng.uniform(np.log(0.3 * frequency), np.log(0.45 * rate))))
        if all(abs(np.log(other / f)) > 0.08 for f, _, _ in modes):
            modes.append((other, min(_damping(rng), 0.05), float(rng.uniform(0.05, _WEAKER))))
    return modes


def _damping(rng: Rng) -> float:
    return float(np.exp(rng.uniform(np.log(1e-4), np.log(0.4))))


def _decay(time: FloatArray, modes: Sequence[Mode], phases: FloatArray) -> FloatArray:
    total = np.zeros(time.size)
    for (f, z, a), phase in zip(modes, phases, strict=True):
        omega = 2 * np.pi * f
        total += a * np.exp(-z * omega * time) * np.cos(omega * np.sqrt(1 - z * z) * time + phase)
    return total


def _motion(
    rng: Rng, time: FloatArray, modes: Sequence[Mode], events: Sequence[str]
) -> tuple[FloatArray, list[tuple[float, float]], list[float]]:
    """Displacement without noise, (start, amplitude) of each decay, and times at which a decay is disturbed."""
    y, span = np.zeros(time.size), float(time[-1])
    begin = span * float(rng.uniform(0.05, 0.3)) if {"rest", "drive"} & set(events) else 0.0
    count = int(rng.integers(2, 5)) if "plucks" in events else 1
    starts = begin + (span - begin) * np.arange(count) / count
    breaks = [*starts[1:], span]
    sizes = [1.0, *rng.uniform(0.4, 1.2, count - 1)]
    for start, size in zip(starts, sizes, strict=True):
        after = time >= start
        driven = "drive" in events and start == starts[0]
        # A release from a deflection has phase 0, an impulse -90 degrees; a stopped drive any.
        phases = (
            rng.uniform(-np.pi, np.pi, len(modes))
            if driven
            else np.full(len(modes), rng.choice([0.0, -np.pi / 2]))
        )
        y[after] = size * _decay(time[after] - start, modes, phases)
        if driven:
            f, z, a = modes[0]
            omega = 2 * np.pi * f * np.sqrt(1 - z * z)
            before = time < start
            y[before] = a * np.cos(omega * (time[before] - start) + phases[0])
    if "hand stop" in events:
        f = modes[0][0]
        start = float(starts[-1])
        held = start + (span - start) * float(rng.uniform(0.3, 0.8))
        after = time >= held
        y[after] *= np.exp(-(time[after] - held) * f * rng.uniform(0.5, 3.0))
        breaks.append(held)
    return y, list(zip(starts, sizes, strict=True)), breaks


def _disturbed(
    rng: Rng,
    time: FloatArray,
    y: FloatArray,
    noise: float,
    frequency: float,
    events: Sequence[str],
    breaks: Sequence[float],
) -> tuple[FloatArray, list[float]]:
    """Displacement with noise, clicks, steps, gaps and repeats, and the times of all that disturbs a decay."""
    y, span, n = y.copy(), float(time[-1]), time.size
    breaks = list(breaks)
    for name, room in (("click", 0.6), ("step", 0.9)):
        if name not in events:
            continue
        at = span * float(rng.uniform(0.35, room))
        after = time >= at
        since = time[after] - at
        size = float(rng.uniform(0.2, 1.5)) * rng.choice([-1.0, 1.0])
        # A click rattles: a single frequency would be a decay of its own.
        rattle = np.exp(-since * frequency) * np.clip(rng.standard_normal(since.size), -2.0, 2.0)
        y[after] += size * (rattle if name == "click" else 1.0)
        breaks.append(at)
    y += noise * rng.standard_normal(n)
    if "outliers" in events:
        hit = rng.random(n) < rng.uniform(0.002, 0.03)
        y[hit] += rng.choice([-1.0, 1.0], hit.sum()) * rng.uniform(0.3, 3.0, hit.sum())
    if "repeats" in events:
        last = int(rng.integers(2, 30))
        y[-last:] = y[-last - 1] + 0.05 * noise * rng.standard_normal(last)
        breaks.append(float(time[-last - 1]))
    if "gaps" in events:
        for _ in range(rng.integers(1, 6)):
            first = int(rng.integers(0, n))
            y[first : first + int(rng.integers(1, max(2, n // 20)))] = np.nan
    return y, breaks


def _longest_decay(
    time: FloatArray, starts: Sequence[tuple[float, float]], breaks: Sequence[float]
) -> tuple[float, float, float]:
    """Begin, end and amplitude of the undisturbed decay that contains most time."""
    found = []
    for start, size in starts:
        end = min(b for b in [*breaks, float(time[-1]) + time[1]] if b > start)
        found.append((end - start, float(start), float(end), float(size)))
    return max(found)[1:]

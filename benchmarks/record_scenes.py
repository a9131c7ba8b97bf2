"""Random records in which parts differ: drives, hands, several plucks, damping that grows with the amplitude, drift.

Mode 1 has amplitude 1, and frequency and damping ratio over the ranges of real beams; 100 samples per second; AR(1)
noise in half of the records. `scene(seed)` gives the same record on every machine up to rounding.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from modal_id.posterior import modal_bound
from tracker import DisplacementSeries, FloatArray

RATE_HZ = 100.0
_FREQUENCY = (0.01, 0.45)
_DAMPING = (2e-4, 0.08)
_TAU = 2.0 * np.pi


@dataclass(frozen=True)
class TruePart:
    """A part of a record: "rest", "driven", "decay" or "held" (by a hand), from row `start` to before row `end`.

    `amplitude` is that of mode 1 at its start, where it is a decay.
    """

    kind: str
    start: int
    end: int
    amplitude: float = 0.0


@dataclass(frozen=True)
class RecordScene:
    """A record with its truth: `modes` are (frequency in Hz, damping ratio at small amplitude), mode 1 first.

    `excited` is the number of modes that move at all: a drive that stops releases mode 1 alone. `energy` is that of
    each part, about its mean. `informative`: whether the longest decay determines frequency and damping ratio of mode 1
    to 1 % (Cramer-Rao bound without drift). `traits` names what the record holds, for tables by class.
    """

    series: DisplacementSeries
    modes: tuple[tuple[float, float], ...]
    parts: tuple[TruePart, ...]
    energy: tuple[float, ...]
    excited: int
    informative: bool
    traits: frozenset[str]


def scene(seed: int) -> RecordScene:
    """The record with this number."""
    rng = np.random.default_rng(seed + 12345)
    modes, amplitudes, channels, n, close = _modes(rng)
    shapes = rng.standard_normal((len(modes), channels))
    shapes /= np.abs(shapes).max(1, keepdims=True)
    signal_to_noise = _log_uniform(rng, 3.0, 3000.0)
    script = _script(rng, modes[0][0], n)
    motion, parts = _motion(rng, script, modes, amplitudes, shapes, n)
    has_drift = rng.uniform() < 0.5
    if has_drift:
        motion += _drift(rng, modes[0][0], n, channels)
    memory = rng.uniform(0.0, 0.9) if rng.uniform() < 0.5 else 0.0
    motion += math.sqrt(1.0 - memory**2) / signal_to_noise * _ar1(rng, n, channels, memory)
    traits = {
        "only drive": script.only_drive,
        "drive": script.drive and not script.only_drive,
        "hand": any(part.kind == "held" for part in parts),
        "plucks": script.plucks > 1 and not script.only_drive,
        "zeta(A)": script.growth > 0,
        "close": close,
        "coloured noise": memory > 0.3,
        "drift": has_drift,
        "SNR < 10": signal_to_noise < 10,
        "SNR > 100": signal_to_noise > 100,
    }
    plain = not any(traits[name] for name in ("only drive", "drive", "hand", "plucks", "zeta(A)", "close"))
    return RecordScene(
        _series(motion),
        tuple(modes),
        tuple(parts),
        tuple(float(((motion[p.start : p.end] - motion[p.start : p.end].mean(0)) ** 2).sum()) for p in parts),
        1 if script.drive and script.plucks == 1 else len(modes),
        _is_informative(modes[0], parts, shapes[0], memory, signal_to_noise),
        frozenset(name for name, holds in {**traits, "plain": plain}.items() if holds),
    )


@dataclass(frozen=True)
class _Script:
    """What happens: a drive at `drive_hz` or rest until row `onset`, plucks at `starts`, a hand on the last decay."""

    only_drive: bool
    drive: bool
    onset: int
    growth: float
    plucks: int
    hand: bool
    drive_hz: float
    starts: tuple[int, ...]
    drive_phase: float
    drive_amplitude: float


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _modes(
    rng: np.random.Generator,
) -> tuple[list[tuple[float, float]], list[float], int, int, bool]:
    """Modes, their amplitudes, number of channels and of rows, and whether the second is within 4 % of the first."""
    first = _log_uniform(rng, *_FREQUENCY) * RATE_HZ
    modes, amplitudes = [(first, _log_uniform(rng, *_DAMPING))], [1.0]
    count = int(rng.integers(1, 5))
    channels = int(rng.choice([1, 1, 2, 3, 5]))
    n = int(np.clip(_log_uniform(rng, 20.0, 1500.0) / first * RATE_HZ, 400, 20000))
    close = count > 1 and rng.uniform() < 0.15
    for index in range(1, count):
        near = close and index == 1
        for _ in range(100):
            if near:
                other = first * (1 + rng.choice([-1, 1]) * rng.uniform(0.01, 0.04))
            else:
                other = _log_uniform(rng, *_FREQUENCY) * RATE_HZ
            if all(abs(other / f - 1) > (0.009 if near else 0.08) for f, _ in modes):
                break
        modes.append((float(other), _log_uniform(rng, *_DAMPING)))
        amplitudes.append(float(rng.uniform(0.05, 0.6)))
    return modes, amplitudes, channels, n, close


def _script(rng: np.random.Generator, frequency_hz: float, n: int) -> _Script:
    only_drive = rng.uniform() < 0.05
    onset = int(n * rng.uniform(0.05, 0.5)) if rng.uniform() < 0.7 else 0
    drive = onset > 0 and rng.uniform() < 0.4
    growth = rng.uniform(0.3, 3.0) if rng.uniform() < 0.2 else 0.0
    plucks = 1 if rng.uniform() < 0.7 else int(rng.integers(2, 5))
    hand = rng.uniform() < 0.2
    drive_hz = frequency_hz * (1 + rng.uniform(-0.03, 0.03))
    shares = np.r_[0.0, np.sort(np.r_[0.0, rng.uniform(0.15, 0.9, plucks - 1)])][1:]
    starts = np.r_[onset + shares * (n - onset), n].astype(int)
    phase = rng.uniform(0, _TAU)
    return _Script(
        only_drive,
        drive,
        onset,
        float(growth),
        plucks,
        hand,
        float(drive_hz),
        tuple(map(int, starts)),
        float(phase),
        float(rng.uniform(0.3, 1.0)),
    )


def _motion(
    rng: np.random.Generator,
    script: _Script,
    modes: list[tuple[float, float]],
    amplitudes: list[float],
    shapes: FloatArray,
    n: int,
) -> tuple[FloatArray, list[TruePart]]:
    motion = np.zeros((n, shapes.shape[1]))
    turning = _TAU * script.drive_hz * np.arange(n) / RATE_HZ + script.drive_phase
    if script.only_drive:
        return motion + np.outer(np.cos(turning), shapes[0]), [TruePart("driven", 0, n)]
    parts = []
    if script.onset:
        parts.append(TruePart("driven" if script.drive else "rest", 0, script.onset))
    if script.drive:
        before = turning[: script.onset]
        motion[: script.onset] += np.outer(script.drive_amplitude * np.cos(before), shapes[0])
    frequency, damping = modes[0]
    for k, (i, j) in enumerate(zip(script.starts[:-1], script.starts[1:], strict=True)):
        level = 1.0 if k == 0 else rng.uniform(0.4, 1.5)
        end = j
        if script.hand and k == len(script.starts) - 2 and j - i > 20 / frequency * RATE_HZ:
            free = rng.uniform(0.3, 1.5) / (damping * _TAU * frequency) * RATE_HZ
            end = int(i + max(np.clip(free, 10 / frequency * RATE_HZ, 0.8 * (j - i)), 5))
        held = float(np.clip(damping * rng.uniform(8, 30), 0.05, 0.3))
        goes_on, released = script.drive and k == 0, 0.0
        for m, (f, zeta) in enumerate(modes):
            if m == 0:
                size = released = script.drive_amplitude if goes_on else level * rng.uniform(0.9, 1.1)
            else:
                size = amplitudes[m] * level * (0.0 if goes_on else rng.uniform(0.5, 1.5))
            if goes_on and m == 0:
                phase = _TAU * script.drive_hz * script.onset / RATE_HZ + script.drive_phase
            else:
                phase = rng.uniform(0, _TAU)
            ratio = np.where(np.arange(j - i) < end - i, zeta, max(held, zeta))
            growth = script.growth if m == 0 else 0.0
            motion[i:j] += np.outer(_swing(_TAU * f, ratio, growth, size, phase), shapes[m])
        parts.append(TruePart("decay", i, end, released))
        if end < j:
            parts.append(TruePart("held", end, j))
    return motion, parts


def _is_informative(
    mode: tuple[float, float], parts: list[TruePart], shape: FloatArray, memory: float, signal_to_noise: float
) -> bool:
    decays = [part for part in parts if part.kind == "decay"]
    if not decays:
        return False
    longest = max(decays, key=lambda part: part.end - part.start)
    # white noise with the level that AR(1) noise has at the mode
    turn = _TAU * mode[0] / RATE_HZ
    level = (1 - memory**2) / (1 - 2 * memory * math.cos(turn) + memory**2)
    bound = modal_bound(
        np.arange(longest.end - longest.start) / RATE_HZ,
        *mode,
        longest.amplitude * shape,
        0.3,
        np.full(shape.size, math.sqrt(level) / signal_to_noise),
        with_drift=False,
    )
    return max(bound.frequency_sd_hz / mode[0], bound.damping_sd / mode[1]) < 0.01


def _swing(omega: float, zeta: FloatArray, growth: float, amplitude: float, phase: float) -> FloatArray:
    """A mode's free motion, zeta(A) = zeta (1 + growth A^2), in half steps of constant damping."""
    n = zeta.size
    half = omega / 2 / RATE_HZ
    if growth == 0.0:
        # before each sample, two half steps of every earlier one
        lost, turned = (
            np.concatenate([[0.0], np.cumsum(2.0 * half * rate[:-1])])
            for rate in (zeta, np.sqrt(1 - np.minimum(zeta, 0.9) ** 2))
        )
        return np.asarray(amplitude * np.exp(-lost) * np.cos(phase + turned))
    sizes, phases = np.empty(n), np.empty(n)
    for i, ratio in enumerate(zeta.tolist()):
        sizes[i], phases[i] = amplitude, phase
        for _ in range(2):
            z = ratio * (1 + growth * amplitude * amplitude)
            amplitude *= math.exp(-z * half)
            phase += half * math.sqrt(1 - min(z, 0.9) ** 2)
    return np.asarray(sizes * np.cos(phases))


def _drift(rng: np.random.Generator, frequency_hz: float, n: int, channels: int) -> FloatArray:
    time_s, span_s = np.arange(n) / RATE_HZ, n / RATE_HZ
    size, slow = _log_uniform(rng, 0.003, 0.5), rng.uniform(0.3, 3.0) / span_s
    while slow > frequency_hz / 10:
        slow /= 2
    wave = np.sin(_TAU * slow * time_s + rng.uniform(0, 6)) + rng.uniform(-1, 1) * time_s / span_s
    return np.outer(size * wave, rng.uniform(-1, 1, channels))


def _ar1(rng: np.random.Generator, n: int, channels: int, memory: float) -> FloatArray:
    white = rng.standard_normal((n + 200, channels))
    return np.asarray(lfilter([1.0], [1.0, -memory], white, axis=0)[200:])


def _series(motion: FloatArray) -> DisplacementSeries:
    n, k = motion.shape
    return DisplacementSeries(
        name="record",
        channels=tuple(f"m{i}" for i in range(k)),
        time_s=np.arange(n) / RATE_HZ,
        values=motion,
        sd=np.full(motion.shape, np.nan),
        unit="px",
        positions_mm=np.full(k, np.nan),
    )

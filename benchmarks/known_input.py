"""Records with a measured base motion, simulated: errors, intervals and computing time of the identified modes.

``python -m benchmarks.known_input --records 30 > known_input.jsonl`` prints a JSON line a record.

The truth is a sum of sinusoids, whose response from rest is known in closed form, or a sweep, integrated by
`scipy.integrate.solve_ivp`. Neither uses the splines of `modal_id.response`.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.integrate import solve_ivp
from scipy.signal import lfilter

from modal_id import Identification, identify
from tracker import DisplacementSeries, KnownInput

FREQUENCIES_HZ, DAMPING_RATIOS = np.array([6.4, 38.7]), np.array([0.009, 0.004])
#: Relative motion of three markers in each mode for a unit base motion far above the resonance.
PARTICIPATION = np.array([[1.57, 0.86, 0.31], [-0.87, 0.43, 0.39]])
RATE_HZ, SPAN_S, NOISE_MM = 400.0, 20.0, 0.02
KINDS = ("sweep", "random", "hand", "decay")


@dataclass(frozen=True)
class Record:
    """One simulated record, in s and mm: base motion and absolute motion of the markers with their noise."""

    time_s: np.ndarray
    base: np.ndarray
    values: np.ndarray


@lru_cache(maxsize=8)
def _sweep() -> tuple[np.ndarray, np.ndarray]:
    """Base motion of 3 to 45 Hz that fades in, and the modes' responses to it."""
    time_s, span_s = np.arange(int(SPAN_S * RATE_HZ)) / RATE_HZ, SPAN_S
    rate, omega = 2.0 * np.pi * 42.0 / span_s, 2.0 * np.pi * FREQUENCIES_HZ

    def base(t: np.ndarray | float) -> np.ndarray:
        return (
            0.2 * (1.0 - np.exp(-((np.asarray(t) / 0.3) ** 4))) * np.sin(6.0 * np.pi * t + 0.5 * rate * t**2)
        )

    def slope(t: float, y: np.ndarray) -> np.ndarray:
        # Relative coordinate plus base motion, x'' = -w^2 (x - u) - 2 zeta w (x' - u'), with v = x' - 2 zeta w u.
        x, v, two = y[:2], y[2:], 2.0 * DAMPING_RATIOS * omega
        u = float(base(t))
        return np.concatenate([v + two * u, -(omega**2) * (x - u) - two * (v + two * u)])

    found = solve_ivp(slope, (0.0, time_s[-1]), np.zeros(4), "DOP853", time_s, rtol=1e-10, atol=1e-12)
    u = base(time_s)
    return u, found.y[:2].T - u[:, None]


def _sinusoids(kind: str, generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A random base motion from rest of the beam, and the modes' responses to it."""
    time_s = np.arange(int(SPAN_S * RATE_HZ)) / RATE_HZ
    low, high, size = (2.0, 60.0, 0.15) if kind == "random" else (0.6, 12.0, 0.6)
    # Not periodic in the record.
    lines = np.sort(generator.uniform(low, high, 400))
    factor = generator.standard_normal((400, 2)) @ np.array([1.0, 1j]) * size / np.sqrt(400)
    if kind == "hand":
        factor = factor / (1.0 + (lines / 3.0) ** 2)
    s = 2j * np.pi * lines
    waves = np.exp(np.outer(time_s, s))
    base = np.real(waves @ factor)
    responses = []
    for omega, zeta in zip(2.0 * np.pi * FREQUENCIES_HZ, DAMPING_RATIOS, strict=True):
        gain = -(s**2) / (s**2 + 2.0 * zeta * omega * s + omega**2)
        steady, start, speed = waves @ (gain * factor), np.sum(gain * factor), np.sum(s * gain * factor)
        pole = -zeta * omega + 1j * omega * np.sqrt(1.0 - zeta**2)
        # Free motion that makes the beam start at rest relative to the base.
        a = -start.real
        b = (-speed.real - pole.real * a) / pole.imag
        responses.append(steady.real + np.real((a - 1j * b) * np.exp(pole * time_s)))
    return base, np.column_stack(responses)


def record(
    kind: str, seed: int, *, noise_mm: float = NOISE_MM, input_noise_mm: float = 0.0, correlation: float = 0.0
) -> Record:
    """A record of a kind in `KINDS`; noise is white or AR(1) with this correlation of neighbours."""
    generator = np.random.default_rng([seed, KINDS.index(kind)])
    time_s = np.arange(int(SPAN_S * RATE_HZ)) / RATE_HZ
    if kind == "sweep":
        base, modes = _sweep()
    elif kind == "decay":
        base = np.zeros(time_s.size)
        poles = 2.0 * np.pi * FREQUENCIES_HZ * (-DAMPING_RATIOS + 1j * np.sqrt(1.0 - DAMPING_RATIOS**2))
        modes = np.real(np.exp(np.outer(time_s, poles))) * [3.0, 1.0]
    else:
        base, modes = _sinusoids(kind, generator)
    white = generator.standard_normal((time_s.size, 3)) * np.sqrt(1.0 - correlation**2)
    noise = lfilter([1.0], [1.0, -correlation], white, axis=0)
    values = base[:, None] + modes @ PARTICIPATION + noise_mm * noise
    return Record(time_s, base + input_noise_mm * generator.standard_normal(time_s.size), values)


def measured(kind: str, seed: int, input_noise_mm: float, correlation: float) -> dict[str, object]:
    """Errors over standard deviations of the modes found in one record, and its computing time."""
    one = record(kind, seed, input_noise_mm=input_noise_mm, correlation=correlation)
    series = DisplacementSeries(
        name=kind,
        time_s=one.time_s,
        channels=("y1", "y2", "y3"),
        values=one.values,
        sd=np.full(one.values.shape, np.nan),
        unit="mm",
        positions_mm=np.full(3, np.nan),
        known_input=KnownInput("base", one.base, "mm", sd=input_noise_mm),
    )
    start = time.process_time()
    found = identify(series)
    modes = found.modes if isinstance(found, Identification) else ()
    scores: dict[str, list[float]] = {}
    for hz, zeta in zip(FREQUENCIES_HZ, DAMPING_RATIOS, strict=True):
        for m in (m for m in modes if abs(m.frequency_hz - hz) < 0.1 * hz):
            z = (m.frequency_hz - hz) / m.frequency_sd_hz, (m.damping_ratio - zeta) / m.damping_ratio_sd
            scores[f"{hz:g}"] = [float(value) for value in z]
    return {
        "kind": kind,
        "seed": seed,
        "input_noise_mm": input_noise_mm,
        "correlation": correlation,
        "modes": len(modes),
        "z": scores,
        "cpu_s": time.process_time() - start,
    }


def main() -> None:
    """Print a JSON line for each record."""
    parser = argparse.ArgumentParser(description="Modes from the response to a measured input, simulated.")
    parser.add_argument("--records", type=int, default=30, help="Records of each kind and noise.")
    count = parser.parse_args().records
    for correlation, input_noise_mm in ((0.0, 0.0), (0.8, 0.0), (0.0, NOISE_MM)):
        for kind in KINDS[:3]:
            for seed in range(count):
                line = json.dumps(measured(kind, seed, input_noise_mm, correlation))
                sys.stdout.write(line + "\n")


if __name__ == "__main__":
    main()

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
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from modal_id import Identification, identify
from tracker import DisplacementSeries, KnownInput

FREQUENCIES_HZ, DAMPING_RATIOS = np.array([6.4, 38.7]), np.array([0.009, 0.004])
#: Relative motion of three markers in each mode for a unit base motion far above the resonance.
PARTICIPATION = np.array([[1.57, 0.86, 0.31], [-0.87, 0.43, 0.39]])
RATE_HZ, SPAN_S, NOISE_MM = 400.0, 20.0, 0.02
KINDS = ("sweep", "random", "hand", "decay", "broad")
#: Correlation of neighbouring noise values, noise of the input, whether its sd is stated.
CONDITIONS = (
    (0.0, 0.0, True),
    (0.8, 0.0, True),
    (0.0, NOISE_MM, True),
    (0.0, 0.0, False),
    (0.0, NOISE_MM, False),
)
_MODES = (*FREQUENCIES_HZ, *DAMPING_RATIOS)


@dataclass(frozen=True)
class Record:
    """One simulated record, in s and mm: base motion and absolute motion of the markers with their noise."""

    time_s: np.ndarray
    base: np.ndarray
    values: np.ndarray


@lru_cache(maxsize=16)
def _sweep(modes: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Base motion of 3 to 45 Hz that fades in, and the modes' responses to it."""
    time_s, span_s = np.arange(int(SPAN_S * RATE_HZ)) / RATE_HZ, SPAN_S
    omega, ratios = 2.0 * np.pi * np.array(modes[:2]), np.array(modes[2:])
    rate = 2.0 * np.pi * 42.0 / span_s

    def base(t: np.ndarray | float) -> np.ndarray:
        return (
            0.2 * (1.0 - np.exp(-((np.asarray(t) / 0.3) ** 4))) * np.sin(6.0 * np.pi * t + 0.5 * rate * t**2)
        )

    def slope(t: float, y: np.ndarray) -> np.ndarray:
        # Relative coordinate plus base motion, x'' = -w^2 (x - u) - 2 zeta w (x' - u'), with v = x' - 2 zeta w u.
        x, v, two = y[:2], y[2:], 2.0 * ratios * omega
        u = float(base(t))
        return np.concatenate([v + two * u, -(omega**2) * (x - u) - two * (v + two * u)])

    found = solve_ivp(slope, (0.0, time_s[-1]), np.zeros(4), "DOP853", time_s, rtol=1e-10, atol=1e-12)
    u = base(time_s)
    return u, found.y[:2].T - u[:, None]


@lru_cache(maxsize=1)
def _waves(lines: tuple[float, ...]) -> np.ndarray:
    return np.exp(np.outer(np.arange(int(SPAN_S * RATE_HZ)) / RATE_HZ, 2j * np.pi * np.array(lines)))


def _sinusoids(
    kind: str, generator: np.random.Generator, modes: tuple[float, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """A random base motion from rest of the beam, and the modes' responses to it."""
    time_s = np.arange(int(SPAN_S * RATE_HZ)) / RATE_HZ
    low, high, size = {"random": (2.0, 60.0, 0.15), "broad": (0.5, 195.0, 0.27), "hand": (0.6, 12.0, 0.6)}[
        kind
    ]
    # Not periodic in the record.
    lines = np.sort(generator.uniform(low, high, 400))
    factor = generator.standard_normal((400, 2)) @ np.array([1.0, 1j]) * size / np.sqrt(400)
    if kind == "hand":
        factor = factor / (1.0 + (lines / 3.0) ** 2)
    s = 2j * np.pi * lines
    waves = _waves(tuple(lines))
    base = np.real(waves @ factor)
    responses = []
    for hz, zeta in zip(modes[:2], modes[2:], strict=True):
        omega = 2.0 * np.pi * hz
        gain = -(s**2) / (s**2 + 2.0 * zeta * omega * s + omega**2)
        steady, start, speed = waves @ (gain * factor), np.sum(gain * factor), np.sum(s * gain * factor)
        pole = -zeta * omega + 1j * omega * np.sqrt(1.0 - zeta**2)
        # Free motion that makes the beam start at rest relative to the base.
        a = -start.real
        b = (-speed.real - pole.real * a) / pole.imag
        responses.append(steady.real + np.real((a - 1j * b) * np.exp(pole * time_s)))
    return base, np.column_stack(responses)


def motion(
    kind: str, generator: np.random.Generator, modes: tuple[float, ...] = _MODES
) -> tuple[np.ndarray, np.ndarray]:
    """Base motion, and the motion of the modes relative to it for a unit participation; frequencies, damping ratios."""
    return _sweep(modes) if kind == "sweep" else _sinusoids(kind, generator, modes)


def bound(kind: str, seed: int, correlation: float) -> dict[str, tuple[float, float]]:
    """Cramer-Rao bound of frequency and damping ratio of each mode, for an input without noise.

    Free are, as in the fit, for each marker the factors of the base motion, of its second derivative, of a cubic drift,
    of the response of each mode and its quadrature, and of its free decay. Slopes are differences of simulations.
    """

    def whitened(columns: np.ndarray) -> np.ndarray:
        # The innovations of the noise, whose variance is NOISE_MM^2 (1 - correlation^2).
        return lfilter([1.0, -correlation], [1.0], columns, axis=0)[1:] / (
            NOISE_MM * np.sqrt(1.0 - correlation**2)
        )

    def simulated(modes: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
        return motion(kind, np.random.default_rng([seed, KINDS.index(kind)]), modes)

    base, responses = simulated(_MODES)
    time_s = np.arange(base.size) / RATE_HZ
    slopes = []
    for index, value in enumerate(_MODES):
        step = 1e-4 * value
        up, down = (
            simulated((*_MODES[:index], value + turn * step, *_MODES[index + 1 :]))[1][:, index % 2]
            for turn in (1, -1)
        )
        slopes.append((up - down) / (2.0 * step))
    omega = 2.0 * np.pi * FREQUENCIES_HZ
    free = np.exp(np.outer(time_s, omega * (-DAMPING_RATIOS + 1j * np.sqrt(1.0 - DAMPING_RATIOS**2))))
    # Central differences would lose a tenth of the slope at the end of the sweep, and the bound a fifth.
    linear = [base[:, None], CubicSpline(time_s, base)(time_s, 2)[:, None], np.vander(time_s / time_s[-1], 4)]
    # With the base motion, the slope is that of the resonant part: its second column.
    linear += [responses, CubicSpline(time_s, responses + base[:, None])(time_s, 1), free.real, free.imag]
    columns = whitened(np.column_stack(linear))
    basis = np.linalg.qr(columns / np.linalg.norm(columns, axis=0))[0]
    information = np.zeros((4, 4))
    for of_marker in PARTICIPATION.T:
        own = whitened(np.column_stack(slopes) * np.tile(of_marker, 2))
        own -= basis @ (basis.T @ own)
        information += own.T @ own
    sd = np.sqrt(np.diag(np.linalg.pinv(information, rcond=1e-12, hermitian=True)))
    return {f"{hz:g}": (float(sd[k]), float(sd[2 + k])) for k, hz in enumerate(FREQUENCIES_HZ)}


def record(
    kind: str, seed: int, *, noise_mm: float = NOISE_MM, input_noise_mm: float = 0.0, correlation: float = 0.0
) -> Record:
    """A record of a kind in `KINDS`; noise is white or AR(1) with this correlation of neighbours."""
    generator = np.random.default_rng([seed, KINDS.index(kind)])
    time_s = np.arange(int(SPAN_S * RATE_HZ)) / RATE_HZ
    if kind == "decay":
        base = np.zeros(time_s.size)
        poles = 2.0 * np.pi * FREQUENCIES_HZ * (-DAMPING_RATIOS + 1j * np.sqrt(1.0 - DAMPING_RATIOS**2))
        modes = np.real(np.exp(np.outer(time_s, poles))) * [3.0, 1.0]
    else:
        base, modes = motion(kind, generator)
    white = generator.standard_normal((time_s.size, 3)) * np.sqrt(1.0 - correlation**2)
    noise = lfilter([1.0], [1.0, -correlation], white, axis=0)
    values = base[:, None] + modes @ PARTICIPATION + noise_mm * noise
    return Record(time_s, base + input_noise_mm * generator.standard_normal(time_s.size), values)


def measured(
    kind: str, seed: int, correlation: float, input_noise_mm: float, *, stated: bool
) -> dict[str, object]:
    """Errors over standard deviations and over the bound of the modes found in one record, and its computing time."""
    one = record(kind, seed, input_noise_mm=input_noise_mm, correlation=correlation)
    series = DisplacementSeries(
        name=kind,
        time_s=one.time_s,
        channels=("y1", "y2", "y3"),
        values=one.values,
        sd=np.full(one.values.shape, np.nan),
        unit="mm",
        positions_mm=np.full(3, np.nan),
        known_input=KnownInput("base", one.base, "mm", sd=input_noise_mm if stated else float("nan")),
    )
    start = time.process_time()
    found = identify(series)
    modes = found.modes if isinstance(found, Identification) else ()
    cpu_s = time.process_time() - start
    limits = bound(kind, seed, correlation) if input_noise_mm == 0.0 else {}
    scores: dict[str, list[float]] = {}
    over_bound: dict[str, list[float]] = {}
    for hz, zeta in zip(FREQUENCIES_HZ, DAMPING_RATIOS, strict=True):
        for m in (m for m in modes if abs(m.frequency_hz - hz) < 0.1 * hz):
            z = (m.frequency_hz - hz) / m.frequency_sd_hz, (m.damping_ratio - zeta) / m.damping_ratio_sd
            scores[f"{hz:g}"] = [float(value) for value in z]
            if limits:
                errors = np.array([m.frequency_hz - hz, m.damping_ratio - zeta])
                over_bound[f"{hz:g}"] = (errors / limits[f"{hz:g}"]).tolist()
    return {
        "kind": kind,
        "seed": seed,
        "input_noise_mm": input_noise_mm,
        "correlation": correlation,
        "stated": stated,
        "flags": sorted({flag for m in modes for flag in m.flags}),
        "modes": len(modes),
        "z": scores,
        "over_bound": over_bound,
        "cpu_s": cpu_s,
    }


def main() -> None:
    """Print a JSON line for each record."""
    parser = argparse.ArgumentParser(description="Modes from the response to a measured input, simulated.")
    parser.add_argument("--records", type=int, default=30, help="Records of each kind and noise.")
    count = parser.parse_args().records
    for condition in CONDITIONS:
        for kind in (*KINDS[:3], *KINDS[4:]):
            for seed in range(count):
                sys.stdout.write(json.dumps(measured(kind, seed, *condition[:2], stated=condition[2])) + "\n")


if __name__ == "__main__":
    main()

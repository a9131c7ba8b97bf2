"""Records with a measured base motion and their truth.

The truth is a sum of sinusoids, whose response from rest is known in closed form, or a sweep, integrated by
`scipy.integrate.solve_ivp`. Neither uses the splines of `modal_id.response`.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp
from scipy.signal import butter, cont2discrete, lfilter, sosfilt

from sim.render import Camera, DotMarker, SampledMotion, Scene, render_frames, write_video

FREQUENCIES_HZ, DAMPING_RATIOS = np.array([6.4, 38.7]), np.array([0.009, 0.004])
#: Relative motion of three markers in each mode for a unit base motion far above the resonance.
PARTICIPATION = np.array([[1.57, 0.86, 0.31], [-0.87, 0.43, 0.39]])
RATE_HZ, SPAN_S, NOISE_MM = 400.0, 20.0, 0.02
KINDS = ("sweep", "random", "hand", "decay", "broad")
#: Frequencies in Hz, then damping ratios.
MODES = (*FREQUENCIES_HZ, *DAMPING_RATIOS)


@dataclass(frozen=True)
class Record:
    """One simulated record, in s and mm: base motion and absolute motion of the markers with their noise."""

    time_s: np.ndarray
    base: np.ndarray
    values: np.ndarray


def _sweep_at(t: np.ndarray | float) -> np.ndarray:
    """Base motion of 3 to 45 Hz that fades in."""
    t = np.asarray(t)
    phase = 6.0 * np.pi * t + np.pi * 42.0 / SPAN_S * t**2
    return np.asarray(0.2 * (1.0 - np.exp(-((t / 0.3) ** 4))) * np.sin(phase))


@lru_cache(maxsize=16)
def _sweep(modes: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Base motion, and the modes' responses to it."""
    time_s = np.arange(int(SPAN_S * RATE_HZ)) / RATE_HZ
    omega, ratios = 2.0 * np.pi * np.array(modes[:2]), np.array(modes[2:])

    def slope(t: float, y: np.ndarray) -> np.ndarray:
        # Relative coordinate plus base motion, x'' = -w^2 (x - u) - 2 zeta w (x' - u'), with v = x' - 2 zeta w u.
        x, v, two = y[:2], y[2:], 2.0 * ratios * omega
        u = float(_sweep_at(t))
        return np.concatenate([v + two * u, -(omega**2) * (x - u) - two * (v + two * u)])

    found = solve_ivp(slope, (0.0, time_s[-1]), np.zeros(4), "DOP853", time_s, rtol=1e-10, atol=1e-12)
    u = _sweep_at(time_s)
    return u, found.y[:2].T - u[:, None]


@lru_cache(maxsize=1)
def _waves(lines: tuple[float, ...]) -> np.ndarray:
    return np.exp(np.outer(np.arange(int(SPAN_S * RATE_HZ)) / RATE_HZ, 2j * np.pi * np.array(lines)))


def _lines(kind: str, generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies in Hz and complex amplitudes of the sinusoids of a random base motion."""
    low, high, size = {"random": (2.0, 60.0, 0.15), "broad": (0.5, 195.0, 0.27), "hand": (0.6, 12.0, 0.6)}[
        kind
    ]
    # Not periodic in the record.
    lines = np.sort(generator.uniform(low, high, 400))
    factor = generator.standard_normal((400, 2)) @ np.array([1.0, 1j]) * size / np.sqrt(400)
    if kind == "hand":
        factor = factor / (1.0 + (lines / 3.0) ** 2)
    return lines, factor


def _sinusoids(
    kind: str, generator: np.random.Generator, modes: tuple[float, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """A random base motion from rest of the beam, and the modes' responses to it."""
    time_s = np.arange(int(SPAN_S * RATE_HZ)) / RATE_HZ
    lines, factor = _lines(kind, generator)
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
    kind: str, generator: np.random.Generator, modes: tuple[float, ...] = MODES
) -> tuple[np.ndarray, np.ndarray]:
    """Base motion, and the motion of the modes relative to it for a unit participation; frequencies, damping ratios."""
    return _sweep(modes) if kind == "sweep" else _sinusoids(kind, generator, modes)


def late_base(kind: str, seed: int, lag_s: float) -> np.ndarray:
    """The base motion of `record` as a channel shows it whose clock is late by `lag_s`."""
    time_s = np.arange(int(SPAN_S * RATE_HZ)) / RATE_HZ
    if kind == "sweep":
        return _sweep_at(time_s - lag_s)
    lines, factor = _lines(kind, np.random.default_rng([seed, KINDS.index(kind)]))
    return np.real(_waves(tuple(lines)) @ (factor * np.exp(-2j * np.pi * lines * lag_s)))


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


#: Forces: their rate, the noise of their channel in N, and the displacement of a unit participation for a unit force.
FORCE_RATE_HZ, FORCE_NOISE_N, MM_PER_N = 8000.0, 0.05, 20.0
FORCE_KINDS = ("impacts", "shaker")


@dataclass(frozen=True)
class ForceRecord:
    """Displacements in mm as in `Record`, and a force in N that another recorder took at its own times."""

    time_s: np.ndarray
    values: np.ndarray
    force_time_s: np.ndarray
    force: np.ndarray


def force_record(kind: str, seed: int, lag_s: float, *, span_s: float = SPAN_S) -> ForceRecord:
    """Response to ten impacts of 1.5 ms, or to a shaker with noise of 3 to 60 Hz, whose recorder is late by `lag_s`.

    The force is linear between its samples, for which the response is exact (first-order hold of SciPy).
    """
    generator = np.random.default_rng([seed, FORCE_KINDS.index(kind)])
    t = np.arange(int(span_s * FORCE_RATE_HZ)) / FORCE_RATE_HZ
    if kind == "impacts":
        force = np.zeros(t.size)
        for at_s in np.sort(generator.uniform(0.02, 0.9, 10)) * span_s:
            inside = (t > at_s) & (t < at_s + 1.5e-3)
            force[inside] += generator.uniform(30.0, 80.0) * np.sin(np.pi * (t[inside] - at_s) / 1.5e-3)
    else:
        band = butter(4, (3.0, 60.0), "bandpass", fs=FORCE_RATE_HZ, output="sos")
        force = 8.0 * sosfilt(band, generator.standard_normal(t.size))
    moved = np.zeros((t.size, 3))
    for hz, zeta, part in zip(FREQUENCIES_HZ, DAMPING_RATIOS, PARTICIPATION, strict=True):
        omega = 2.0 * np.pi * hz
        system = ([1.0], [1.0, 2.0 * zeta * omega, omega**2])
        b, a, _ = cont2discrete(system, 1.0 / FORCE_RATE_HZ, method="foh")
        moved += MM_PER_N * FREQUENCIES_HZ[0] ** 2 * lfilter(b[0], a, force)[:, None] * part
    every = int(FORCE_RATE_HZ / RATE_HZ)
    values = moved[::every] + NOISE_MM * generator.standard_normal(moved[::every].shape)
    measured_n = force + FORCE_NOISE_N * generator.standard_normal(t.size)
    return ForceRecord(t[::every], values, t + lag_s, measured_n)


#: Of the films.
FILM_RATE_HZ, FILM_MM_PER_PX, DOT_MM = 200.0, 1.0, 10.0


def film(kind: str, seed: int, path: Path, *, span_s: float = SPAN_S) -> Path:
    """A lossless film of the motion of `record`: a dot on the clamp, the uppermost, and the markers below, tip last."""
    base, modes = motion(kind, np.random.default_rng([seed, KINDS.index(kind)]))
    across = base[:, None] + np.column_stack([np.zeros(base.size), modes @ PARTICIPATION[:, ::-1]])
    moved = np.arange(base.size) / RATE_HZ, across
    times_s = np.arange(1, int(span_s * FILM_RATE_HZ)) / FILM_RATE_HZ
    # At various fractions of a pixel.
    return film_of(moved, np.array([12.3, 28.1, 44.7, 60.9]), times_s, path, [seed, KINDS.index(kind), 1])


def film_of(
    moved: tuple[np.ndarray, np.ndarray],
    down_mm: np.ndarray,
    times_s: np.ndarray,
    path: Path,
    seed: list[int],
) -> Path:
    """Dots below each other that move along the rows by the samples of `moved`, exposed for 1 ms at `times_s`."""
    time_s, across = moved
    motion = SampledMotion(time_s, across, np.tile(-down_mm, (time_s.size, 1)), np.zeros(across.shape))
    width = 2 * int(np.ceil(DOT_MM + np.max(np.abs(across)) / FILM_MM_PER_PX))
    camera = Camera(
        width_px=width,
        height_px=int(np.ceil(np.max(down_mm) + 1.3 * DOT_MM)),
        mm_per_px=FILM_MM_PER_PX,
        origin_px=(0.5 * width + 0.2, 0.0),
        exposure_s=1e-3,
        read_noise_sd=1.5,
        noise_gain=0.05,
    )
    scene = Scene(markers=(DotMarker(diameter_mm=DOT_MM),) * down_mm.size, motion=motion)
    images = render_frames(scene, camera, times_s, np.random.default_rng(seed))
    write_video(path, images, fps_container=Fraction(25), codec="ffv1")
    return path

"""Ambient records with known modes: exact response of modes to white force, sampled, with noise."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.linalg import cholesky
from scipy.signal import lfilter

from benchmarks.known_input_scenes import film_of
from sim.beam import BeamModes
from tracker import DisplacementSeries, FloatArray

#: Distances of the dots of a film from the clamp.
FILMED_MM = np.array([190.0, 340.0, 490.0])


@dataclass(frozen=True)
class Truth:
    """Modes of a record: frequencies in Hz, damping ratios, shapes (k, m), sd of each mode's motion in mm, (m,)."""

    frequency_hz: FloatArray
    damping_ratio: FloatArray
    shapes: FloatArray
    motion_sd: FloatArray


def response(
    frequency_hz: FloatArray,
    damping_ratio: FloatArray,
    coherence: FloatArray,
    samples: int,
    step_s: float,
    rng: np.random.Generator,
) -> FloatArray:
    """Stationary displacement of each mode with unit variance, shape (n, m).

    Exact in discrete time: the complex states ``z' = lambda z + w`` are an autoregression whose innovations have the
    covariance ``S_ij (exp((lambda_i + conj lambda_j) dt) - 1) / (lambda_i + conj lambda_j)``, and the same without
    conjugation; the first state is drawn from the stationary distribution.
    """
    omega = 2.0 * np.pi * frequency_hz
    poles = omega * (-damping_ratio + 1j * np.sqrt(1.0 - damping_ratio**2))
    every = np.concatenate([poles, np.conj(poles)])
    sums = every[:, None] + every[None, :]
    force = np.kron(np.ones((2, 2)), coherence)
    stationary = -force / sums
    innovation = force * np.expm1(sums * step_s) / sums
    # Displacement and velocity are linear in a state and its conjugate: x = Im z / omega_d.
    m = poles.size
    to_real = np.block([[np.eye(m), np.eye(m)], [-1j * np.eye(m), 1j * np.eye(m)]]) / 2.0
    draws = []
    for matrix, count in ((stationary, 1), (innovation, samples - 1)):
        real = np.real(to_real @ matrix @ to_real.T)
        scale = np.sqrt(np.diag(real))
        factor = cholesky(real / np.outer(scale, scale) + 1e-12 * np.eye(2 * m), lower=True)
        draws.append(scale[:, None] * (factor @ rng.standard_normal((2 * m, count))))
    states = np.concatenate(draws, axis=1)
    driven = states[:m] + 1j * states[m:]
    motion = np.empty((samples, m))
    for i in range(m):
        z = lfilter([1.0], [1.0, -np.exp(poles[i] * step_s)], driven[i])
        motion[:, i] = z.imag
    sd = np.sqrt(np.diag(np.real(to_real @ stationary @ to_real.T))[m:])
    return motion / sd


def ambient_film(
    beam: BeamModes, damping_ratio: FloatArray, path: Path, *, seed: int, duration_s: float, rate_hz: float
) -> Path:
    """Film of the lowest modes of a hanging beam under random forces: dots at `FILMED_MM`, lossless, a px a mm.

    The forces are independent; each mode moves the tip by 3 mm (sd) over its number.
    """
    rng, m = np.random.default_rng([0xF11, seed]), damping_ratio.size
    # Four samples a frame: the spline between them changes mode 2 of the samples by 1e-4.
    step_s = 0.25 / rate_hz
    size = int(duration_s / step_s)
    found = response(beam.frequency_hz[:m], damping_ratio, np.eye(m), size, step_s, rng)
    shapes = beam.transverse_at(1e-3 * FILMED_MM)[:, :m]
    across = found @ (3.0 / np.arange(1, m + 1) * shapes / np.abs(shapes[-1])).T
    times_s = np.arange(1, int(duration_s * rate_hz) - 1) / rate_hz
    return film_of((np.arange(size) * step_s, across), FILMED_MM, times_s, path, [0xF11, seed, 1])


def coloured_noise(samples: int, channels: int, exponent: float, rng: np.random.Generator) -> FloatArray:
    """Noise of unit variance whose density falls with this power of the frequency, shape (n, k)."""
    spectrum = np.fft.rfft(rng.standard_normal((2 * samples, channels)), axis=0)
    shaping = np.maximum(np.arange(spectrum.shape[0]), 1.0) ** (-0.5 * exponent)
    noise = np.fft.irfft(spectrum * shaping[:, None], axis=0)[:samples]
    return np.asarray(noise / np.std(noise, axis=0))


def ambient_record(
    seed: int, *, duration_s: float = 600.0, rate_hz: float = 100.0, channels: int = 6
) -> tuple[DisplacementSeries, Truth]:
    """Four modes between 2 and 30 Hz, in every third record two of them 3 % apart; noise white or coloured."""
    rng = np.random.default_rng([0xA3B, seed])
    count = 4
    base = rng.uniform(2.0, 3.5)
    frequency_hz = base * np.array([1.0, rng.uniform(2.2, 2.8), rng.uniform(4.2, 5.2), rng.uniform(7.0, 8.5)])
    if seed % 3 == 0:
        close = int(rng.integers(0, 3))
        frequency_hz[close + 1] = 1.03 * frequency_hz[close]
    damping_ratio = np.exp(rng.uniform(np.log(0.003), np.log(0.02), count))
    shapes = np.linalg.qr(rng.standard_normal((channels, channels)))[0][:, :count]
    shapes /= np.max(np.abs(shapes), axis=0)
    mix = rng.standard_normal((count, count)) * 0.3 + np.eye(count)
    coherence = mix @ mix.T
    coherence /= np.sqrt(np.outer(np.diag(coherence), np.diag(coherence)))
    samples = int(duration_s * rate_hz)
    motion = response(frequency_hz, damping_ratio, coherence, samples, 1.0 / rate_hz, rng)
    motion_sd = rng.uniform(0.5, 2.0, count) * (frequency_hz / frequency_hz[0]) ** -1.0
    noise_sd = np.exp(rng.uniform(np.log(0.003), np.log(0.1)))
    values = motion @ (shapes * motion_sd).T
    noise = rng.standard_normal(values.shape)
    if seed % 2:
        noise = 0.5 * noise + coloured_noise(samples, channels, 1.0, rng)
    values += noise_sd * noise
    return series_of(values, rate_hz), Truth(frequency_hz, damping_ratio, shapes, motion_sd)


def noise_record(seed: int, *, duration_s: float = 600.0, rate_hz: float = 100.0) -> DisplacementSeries:
    """No mode: white noise, noise that falls with a power of the frequency up to 2, or both; 1 to 6 channels."""
    rng = np.random.default_rng([0x2015E, seed])
    samples, channels = int(duration_s * rate_hz), int(rng.integers(1, 7))
    values = rng.standard_normal((samples, channels))
    if seed % 2:
        mixing = np.eye(channels) + 0.5 * rng.standard_normal((channels, channels))
        values = (
            rng.uniform(0.0, 1.0) * values
            + coloured_noise(samples, channels, rng.uniform(0.5, 2.0), rng) @ mixing
        )
    return series_of(0.01 * values, rate_hz, "noise")


def series_of(values: FloatArray, rate_hz: float, name: str = "ambient") -> DisplacementSeries:
    """Values in mm as a series."""
    n, k = values.shape
    return DisplacementSeries(
        name=name,
        time_s=np.arange(n) / rate_hz,
        channels=tuple(f"m{i + 1}" for i in range(k)),
        values=values,
        sd=np.full(values.shape, np.nan),
        unit="mm",
        positions_mm=np.full(k, np.nan),
    )

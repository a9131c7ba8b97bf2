"""Simulated decays of the paper's beam for the coverage study, each with one disturbance found in real records."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from tracker import DisplacementSeries, FloatArray

# Table 2 of Yoo, Lee & Kim, "Tracking for high-order damping of thin beam oscillation".
PAPER_HZ = (1.85, 10.19, 26.84, 53.20, 88.60)
PAPER_ZETA = (0.0100, 0.0028, 0.0028, 0.0023, 0.0030)
CASES = (
    "white",
    "AR(1) 0.5",
    "AR(1) 0.9",
    "pink and 50 Hz hum",
    "neighbour 2 %",
    "drift 0.5 px",
    "2 % missing",
    "0.5 % outliers",
    "all together",
)
FPS = 1000.0
DURATION_S = 10.0
SNR_DB = 40.0
_HUM_HZ, _HUM_PX = 50.0, 0.01


def decay(frequency_hz: float, zeta: float, time_s: FloatArray, phase: float) -> FloatArray:
    """Eq. 1 with amplitude 1."""
    omega = 2.0 * np.pi * frequency_hz
    return np.asarray(
        np.exp(-zeta * omega * time_s) * np.cos(omega * np.sqrt(1.0 - zeta**2) * time_s + phase)
    )


def autoregressive(rng: np.random.Generator, n: int, coefficient: float) -> FloatArray:
    """AR(1) noise of unit variance."""
    white = rng.standard_normal(n + 300)
    return np.asarray(lfilter([1.0], [1.0, -coefficient], white)[300:] * np.sqrt(1.0 - coefficient**2))


def pink(rng: np.random.Generator, n: int) -> FloatArray:
    """1/f noise of unit variance, cut from a series four times as long so that it is not periodic."""
    spectrum = rng.standard_normal(2 * n + 1) + 1j * rng.standard_normal(2 * n + 1)
    spectrum[0] = 0.0
    spectrum[1:] /= np.sqrt(np.arange(1.0, 2.0 * n + 1.0))
    noise = np.fft.irfft(spectrum, 4 * n)
    return np.asarray(noise[:n] / np.std(noise))


def make(case: str, mode: int, seed: int) -> tuple[DisplacementSeries, float, float]:
    """Return a record, its natural frequency (Hz) and its damping ratio.

    Frequency and damping ratio are drawn within 3 % and 20 % of the mode's values, as required by simulation-based
    calibration: Talts et al. (2018), arXiv:1804.06788.
    """
    rng = np.random.default_rng([seed, mode, CASES.index(case)])
    t = np.arange(int(FPS * DURATION_S)) / FPS
    frequency = PAPER_HZ[mode] * rng.uniform(0.97, 1.03)
    zeta = PAPER_ZETA[mode] * rng.uniform(0.8, 1.2)
    sd = np.sqrt(0.5) * 10.0 ** (-SNR_DB / 20.0)
    every = case == "all together"
    colour = {"AR(1) 0.5": 0.5, "AR(1) 0.9": 0.9, "all together": 0.9}.get(case, 0.0)
    noise = pink(rng, t.size) if case == "pink and 50 Hz hum" else autoregressive(rng, t.size, colour)
    y = decay(frequency, zeta, t, 2.0 * np.pi * rng.random()) + sd * noise
    if every or case == "pink and 50 Hz hum":
        y += _HUM_PX * np.cos(2.0 * np.pi * (_HUM_HZ * t + rng.random()))
    if every or case == "neighbour 2 %":
        other = mode + 1 if mode < 4 else mode - 1
        y += 0.02 * decay(PAPER_HZ[other], PAPER_ZETA[other], t, 2.0 * np.pi * rng.random())
    if every or case == "drift 0.5 px":
        y += 0.5 * np.sin(2.0 * np.pi * (0.05 * t + rng.random()))
    if every or case == "0.5 % outliers":
        hit = rng.random(t.size) < 0.005
        y[hit] += rng.choice([-1.0, 1.0], hit.sum()) * rng.uniform(0.2, 1.0, hit.sum())
    if every or case == "2 % missing":
        y[rng.random(t.size) < 0.02] = np.nan
    series = DisplacementSeries(
        name="synthetic",
        time_s=t,
        channels=("m0",),
        values=y[:, None],
        sd=np.full((t.size, 1), np.nan),
        unit="px",
        positions_mm=np.full(1, np.nan),
    )
    return series, frequency, zeta

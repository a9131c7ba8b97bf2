"""Synthetic decays with known truth, and the Cramer-Rao bound of their parameters, independent of modal_id."""

from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

from tracker import DisplacementSeries

# Table 2 of Yoo, Lee & Kim, "Tracking for high-order damping of thin beam oscillation".
PAPER_HZ = np.array([1.85, 10.19, 26.84, 53.20, 88.60])
PAPER_ZETA = np.array([0.0100, 0.0028, 0.0028, 0.0023, 0.0030])
POSITIONS_MM = np.array([2.0, 90.0, 190.0, 290.0, 390.0, 490.0])
LENGTH_MM = 500.0
_CLAMPED_FREE = np.array([1.8751040687, 4.6940911330, 7.8547574382, 10.9955407349, 14.1371683910])


def pole_of(frequency_hz, zeta):
    omega = 2.0 * np.pi * frequency_hz
    return omega * (-zeta + 1j * np.sqrt(1.0 - zeta**2))


def clamped_free_shapes(positions_mm=POSITIONS_MM):
    """Euler-Bernoulli modes of a cantilever at the positions, 1 at the tip; shape (k, 5)."""
    x = np.asarray(positions_mm)[:, None] / LENGTH_MM * _CLAMPED_FREE
    b = _CLAMPED_FREE
    ratio = (np.sinh(b) - np.sin(b)) / (np.cosh(b) + np.cos(b))
    return 0.5 * (np.cosh(x) - np.cos(x) - ratio * (np.sinh(x) - np.sin(x))) * np.array([1, -1, 1, -1, 1])


def coloured(rng, n, ar):
    """AR(1) noise of unit variance."""
    if ar == 0.0:
        return rng.standard_normal(n)
    return lfilter([1.0], [1.0, -ar], rng.standard_normal(n + 300))[300:] * np.sqrt(1.0 - ar**2)


def series_of(time_s, values, unit="px", sd=np.nan, positions_mm=None):
    values = np.asarray(values)
    if values.ndim == 1:
        values = values[:, None]
    k = values.shape[1]
    return DisplacementSeries(
        name="synthetic",
        time_s=time_s,
        channels=tuple(f"m{i}" for i in range(k)),
        values=values,
        sd=np.full(values.shape, float(sd)),
        unit=unit,
        positions_mm=np.full(k, np.nan) if positions_mm is None else positions_mm,
    )


def one_mode(mode, seed, *, fps=1000.0, duration_s=10.0, snr_db=40.0, ar=0.0):
    """One mode of the paper's beam, amplitude 1, random phase; (series, noise sd)."""
    rng = np.random.default_rng([seed, mode])
    t = np.arange(int(fps * duration_s)) / fps
    pole = pole_of(PAPER_HZ[mode], PAPER_ZETA[mode])
    sd = np.sqrt(0.5) * 10.0 ** (-snr_db / 20.0)
    y = np.exp(pole * t + 2j * np.pi * rng.random()).real + sd * coloured(rng, t.size, ar)
    return series_of(t, y), sd


def dirty(mode, seed):
    """Drift 0.5 px, 2 % lost samples, 0.5 % outliers, an adjacent mode of 2 % and AR(1) 0.9 noise, 40 dB."""
    series, _ = one_mode(mode, seed, ar=0.9)
    rng = np.random.default_rng([seed, mode, 7])
    t, y = series.time_s, series.values[:, 0].copy()
    other = mode + 1 if mode < 4 else mode - 1
    y += 0.02 * np.exp(pole_of(PAPER_HZ[other], PAPER_ZETA[other]) * t + 2j * np.pi * rng.random()).real
    y += 0.5 * np.sin(2.0 * np.pi * 0.05 * t + 2.0 * np.pi * rng.random())
    hit = rng.random(t.size) < 0.005
    y[hit] += rng.choice([-1.0, 1.0], hit.sum()) * rng.uniform(0.2, 1.0, hit.sum())
    y[rng.random(t.size) < 0.02] = np.nan
    return series_of(t, y)


def cramer_rao(mode, sd, time_s):
    """Smallest possible standard deviations of (frequency in Hz, zeta) of `one_mode`, by its Jacobian."""

    def model(p):
        wave = np.exp(pole_of(p[0], p[1]) * time_s)
        return p[2] * wave.real - p[3] * wave.imag

    at = np.array([PAPER_HZ[mode], PAPER_ZETA[mode], 1.0, 0.0])
    steps = np.diag([1e-7 * at[0], 1e-7, 1e-6, 1e-6])
    jacobian = np.stack([(model(at + h) - model(at - h)) / (2.0 * h.sum()) for h in steps], axis=1)
    return sd * np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))[:2]


def shaken_then_free(mode, *, amplitude, noise, fps, duration_s, shaking_s, seed):
    """Steady resonance under base motion, stopped at `shaking_s`; six markers, the first near the clamp.

    The stop excites the other modes at 0.3 % of the amplitude.
    """
    rng = np.random.default_rng([seed, mode])
    t = np.arange(int(duration_s * fps)) / fps
    pole = pole_of(PAPER_HZ[mode], PAPER_ZETA[mode])
    omega, phase = 2.0 * np.pi * PAPER_HZ[mode], 2.0 * np.pi * rng.random()
    base = amplitude * 2.0 * PAPER_ZETA[mode] / 1.5
    driven = amplitude * np.exp(1j * (omega * t + phase))
    at_stop = amplitude * np.exp(1j * (omega * shaking_s + phase))
    x0, v0 = at_stop.real, (1j * omega * at_stop).real
    c = x0 - 1j * (v0 - pole.real * x0) / pole.imag
    late = np.maximum(t - shaking_s, 0.0)
    free = t >= shaking_s
    modal = np.where(free, (c * np.exp(pole * late)).real, driven.real)
    moved = base * np.sin(omega * np.minimum(t, shaking_s) + phase)
    shapes = clamped_free_shapes()
    y = modal[:, None] * shapes[:, mode] + moved[:, None]
    for other in set(range(5)) - {mode}:
        other_decay = 0.003 * amplitude * np.exp(pole_of(PAPER_HZ[other], PAPER_ZETA[other]) * late).imag
        y += (free * other_decay)[:, None] * shapes[:, other]
    y += noise * rng.standard_normal(y.shape)
    return series_of(t, y, sd=noise, positions_mm=POSITIONS_MM)


# Modal participation Gamma_r phi_r at the tip of a clamped-free beam; the sum over all modes is 1.
_PARTICIPATION = np.array([1.566, -0.868, 0.509, -0.364, 0.283])


def base_stopped_dead(mode, *, stop_s, phase, snr_db, fps, duration_s, seed, relative=False, base_share=None):
    """A linear beam on a base that oscillates at resonance and stops abruptly; tip amplitude 1, six markers.

    Exact solution of ``eta'' + 2 zeta w eta' + w^2 eta = -Gamma b''``: steady state, then free decay from the same eta
    and from a velocity that is Gamma b' higher. With `phase` 0, the base passes its mean position at the stop. With
    `relative` the base's motion is subtracted and returned with the series. `base_share` is the base's amplitude, by
    default that of resonance.
    """
    rng = np.random.default_rng([seed, mode])
    t = np.arange(int(duration_s * fps)) / fps
    since = t - stop_s
    before = since < 0.0
    omega = 2.0 * np.pi * PAPER_HZ[mode]
    amplitude = 2.0 * PAPER_ZETA[mode] / abs(_PARTICIPATION[mode]) if base_share is None else base_share
    b = amplitude * np.exp(1j * (phase - 0.5 * np.pi))
    velocity = (1j * omega * b).real
    base = np.where(before, (b * np.exp(1j * omega * since)).real, b.real)
    values = np.zeros((t.size, POSITIONS_MM.size))
    shapes = clamped_free_shapes()
    for r in range(5):
        pole = pole_of(PAPER_HZ[r], PAPER_ZETA[r])
        steady = b * omega**2 / (abs(pole) ** 2 - omega**2 - 2j * pole.real * omega)
        x0, v0 = steady.real, (1j * omega * steady).real + velocity
        c = x0 - 1j * (v0 - pole.real * x0) / pole.imag
        late = np.maximum(since, 0.0)
        eta = np.where(before, (steady * np.exp(1j * omega * since)).real, (c * np.exp(pole * late)).real)
        values += _PARTICIPATION[r] * eta[:, None] * shapes[:, r]
    size = 1.0 if base_share is None else np.max(np.abs(values))
    sd = size * np.sqrt(0.5) * 10.0 ** (-snr_db / 20.0)
    series = series_of(t, values + (0.0 if relative else base[:, None]), sd=sd, positions_mm=POSITIONS_MM)
    noisy = series.values + sd * rng.standard_normal(values.shape)
    follow = (
        {"base": base + sd * rng.standard_normal(t.size), "base_sd": np.full(t.size, sd)} if relative else {}
    )
    return replace(series, values=noisy, **follow)

"""Series with known truth: decays, records as people make them, many stations; bounds independent of modal_id."""

from dataclasses import replace

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.optimize import least_squares
from scipy.signal import lfilter

from modal_id import SamplerSettings
from sim.render import cantilever_slope
from tracker import DisplacementSeries, PositionErrors

# Table 2 of Yoo, Lee & Kim, "Tracking for high-order damping of thin beam oscillation".
PAPER_HZ = np.array([1.85, 10.19, 26.84, 53.20, 88.60])
PAPER_ZETA = np.array([0.0100, 0.0028, 0.0028, 0.0023, 0.0030])
POSITIONS_MM = np.array([2.0, 90.0, 190.0, 290.0, 390.0, 490.0])
LENGTH_MM = 500.0
# For tests that do not check the posterior: a fifth of the default's steps, medians within 0.03 standard deviations,
# intervals within 5 % of their width.
QUICK = SamplerSettings(check_steps=20, autocorrelation_times=10.0)
STATIONS_TRUTH = ((4.0, 0.004, 3.0), (25.1, 0.003, 1.5), (70.2, 0.0025, 0.6))
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


def series_of(time_s, values, unit="px", sd=np.nan, positions_mm=None, **more):
    """A series of one channel, or of one for each column; `more` are other fields of the series."""
    values = np.asarray(values)
    if values.ndim == 1:
        values = values[:, None]
    k = values.shape[1]
    given = {
        "name": "synthetic",
        "channels": tuple(f"m{i}" for i in range(k)),
        "sd": np.array(np.broadcast_to(sd, values.shape), dtype=float),
        "positions_mm": np.full(k, np.nan) if positions_mm is None else positions_mm,
    }
    return DisplacementSeries(time_s=time_s, values=values, unit=unit, **(given | more))


def errors_of_positions(k, rows=1, **given):
    """Errors of positions of `k` channels, which are zero but for `given`: numbers, the same for all channels."""
    arrays = dict.fromkeys(("rest_px", "px_per_unit", "periodic_sd"), (rows, k))
    arrays |= dict.fromkeys(("shrinkage", "lag", "shrinkage_sd", "lag_sd", "along_px"), (k,))
    filled = {name: np.full(size, given.get(name, 0.0)) for name, size in arrays.items()}
    return PositionErrors(**({"period_px": 1.0, "frame_s": 0.01} | given | filled))


def decay(time_s, frequency_hz, zeta, amplitude=1.0, phase=0.7):
    return amplitude * np.exp(pole_of(frequency_hz, zeta) * time_s + 1j * phase).real


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


def repeated_end(repeats, seed=1):
    """A tuning fork of 32 Hz and zeta 3.5e-4 at 250 fps; the last frames repeat with the small changes of H.264."""
    rng = np.random.default_rng(seed)
    t = np.arange(882) / 250.0
    y = decay(t, 32.0, 3.5e-4, 1.9, 0.0) + 0.04 * rng.standard_normal(t.size)
    frozen = decay(t[-1:], 32.0, 3.5e-4, 1.9, 0.0) + 0.003 * rng.standard_normal(repeats)
    return np.arange(882 + repeats) / 250.0, np.concatenate([y, frozen])


def stopped_by_hand(seed=1):
    """4.265 Hz and 0.45 %, touched at 8 s: a twentieth of the motion remains."""
    rng = np.random.default_rng(seed)
    t = np.arange(2000) / 100.0
    free = np.exp(-0.0045 * 2.0 * np.pi * 4.265 * np.minimum(t, 8.0)) * np.cos(2.0 * np.pi * 4.265 * t)
    left = np.where(t < 8.0, 1.0, 0.05 * np.exp(-np.clip(t - 8.0, 0.0, None) / 5.0))
    return t, free * left + 0.002 * rng.standard_normal(t.size)


def strongly_damped(fps, frequency_hz, zeta, duration_s, seed=1):
    """A storey frame of three floors, 65 px at the top."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(duration_s * fps)) / fps
    y = decay(t, frequency_hz, zeta, 65.0)[:, None] * np.array([1.0, 0.75, 0.4])
    return t, y + 0.1 * rng.standard_normal(y.shape)


def of_amplitude(steps, step_s, law, start, phase):
    """``a cos(phase)`` with zeta(a) and the damped frequency f(a) in Hz that `law` returns."""
    y, a = np.empty(steps), start
    for i in range(steps):
        y[i] = a * np.cos(phase)
        for _ in range(4):
            zeta, frequency_hz = law(a)
            turn = 2.0 * np.pi * frequency_hz * step_s / 4.0
            a *= np.exp(-zeta * turn)
            phase += turn
    return y


def ruler(zeta=0.008, change=0.025, frequency_hz=38.4, bend=0.0, start=30000.0, phase=0.7):
    """2.45 s of a ruler: zeta falls from 3.3 to 0.8 % with the amplitude."""

    def law(a):
        return zeta + change * a / 30000.0, frequency_hz + bend * (a / 30000.0) ** 2

    return of_amplitude(6125, 1.0 / 2500.0, law, start, phase)


def ruler_with_click(seed=1):
    """At rest, plucked at 0.55 s; a click of 700 Hz at 2 s."""
    rng = np.random.default_rng(seed)
    t = np.arange(7500) / 2500.0
    y = np.concatenate([np.zeros(1375), ruler()])
    click = (t > 2.0) & (t < 2.1)
    since = t[click] - 2.0
    y[click] += 26000.0 * np.exp(-since / 0.008) * np.sign(np.sin(2.0 * np.pi * 700.0 * since))
    return t, y + 300.0 * rng.standard_normal(t.size)


def several_plucks(zetas=(0.008, 0.008, 0.008, 0.008), seed=1):
    """Plucks of a beam of 14.9 Hz at 1, 7, 13 and 19 s, two channels."""
    rng = np.random.default_rng(seed)
    t = np.arange(12000) / 500.0
    y = np.zeros(t.size)
    for start_s, amplitude, zeta in zip((1.0, 7.0, 13.0, 19.0), (1.0, 0.6, 1.3, 0.8), zetas, strict=True):
        on = t >= start_s
        y[on] = decay(t[on] - start_s, 14.9, zeta, amplitude)
    return t, np.column_stack([k * y + 0.004 * rng.standard_normal(t.size) for k in (1.0, 0.5)])


def clamp(zeta=29e-4, change=23e-4, s=0.2, frequency_hz=9.372, shift=0.043, r=0.25, start=2.2, phase=0.0):
    """19 s in a vice that slips: zeta and frequency fall with the amplitude and saturate at large ones."""

    def law(a):
        return zeta + change * a * a / (a * a + s * s), frequency_hz + shift * a * a / (a * a + r * r)

    return of_amplitude(3800, 1.0 / 200.0, law, start, phase)


def slipping_clamp(seed=1):
    """The same with noise."""
    y = clamp()
    return np.arange(y.size) / 200.0, y + 0.002 * np.random.default_rng(seed).standard_normal(y.size)


def steady_drive(seed=1):
    """A machine under steady drive of 26.765 Hz with its first harmonic, in coloured noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(3336) / 1000.0
    noise, shock = np.zeros(t.size), 0.006 * rng.standard_normal(t.size)
    for i in range(1, t.size):
        noise[i] = 0.9 * noise[i - 1] + shock[i]
    line = 0.05 * np.cos(2.0 * np.pi * 26.765 * t)
    return t, line + 0.018 * np.cos(2.0 * np.pi * 53.53 * t + 1.0) + noise


def cantilever_shapes(stations, modes=3):
    """Shapes at places of 0 to 1 along the beam, 1 at the tip; (stations, modes)."""
    fine = np.linspace(0.0, 1.0, 4001)
    slopes = [cantilever_slope(number, fine) for number in range(1, modes + 1)]
    return np.transpose([np.interp(stations, fine, cumulative_trapezoid(s, fine, initial=0)) for s in slopes])


def station_series(
    stations, seed, *, n=1200, fps=300.0, truth=STATIONS_TRUTH, missing=0.0, outliers=0.0, errors=None
):
    """Series, shapes and noise sd of each station; `missing` and `outliers` are shares of the samples."""
    rng = np.random.default_rng([seed, stations, n])
    time_s, at = np.arange(n) / fps, np.linspace(0.02, 1.0, stations)
    shapes = cantilever_shapes(at, len(truth))
    motion = np.stack([decay(time_s, f, z, a, rng.uniform(0, 6)) for f, z, a in truth], axis=1)
    sd = np.exp(rng.uniform(np.log(0.003), np.log(0.03), stations))
    clean = motion @ shapes.T + rng.uniform(-1.0, 1.0, stations)
    values = clean + sd * rng.standard_normal((n, stations))
    values[rng.random((n, stations)) < missing] = np.nan
    values += np.where(rng.random((n, stations)) < outliers, 5.0 * rng.standard_normal((n, stations)), 0.0)
    series = series_of(
        time_s, values, "mm", positions_mm=LENGTH_MM * at, sd=sd, position_errors=errors, name="film",
        channels=tuple(f"s{i + 1}" for i in range(stations)),
    )  # fmt: skip
    return series, shapes, clean


def least_squares_fit(time_s, values, start_hz=32.0):
    """Frequency of a damped sine on a cubic trend and the residual, by least squares independent of the program."""
    found = np.isfinite(values)
    t, y = time_s[found], values[found]

    def residual(p):
        phase = 2 * np.pi * p[0] * t
        wave = np.exp(-p[1] * phase)
        trend = [(t - t.mean()) ** k for k in range(4)]
        design = np.stack([wave * np.cos(phase), wave * np.sin(phase), *trend], axis=1)
        return y - design @ np.linalg.lstsq(design, y, rcond=None)[0]

    fit = least_squares(residual, [start_hz, 3e-4], x_scale=[0.01, 1e-4])
    return fit.x[0], fit.fun

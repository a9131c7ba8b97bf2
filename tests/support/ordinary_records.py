"""Records as people make them, with known truth: repeated frames, a stop by hand, clicks, several plucks, a drive."""

import numpy as np
from support.modal_decays import pole_of


def decay(time_s, frequency_hz, zeta, amplitude=1.0, phase=0.7):
    return amplitude * np.exp(pole_of(frequency_hz, zeta) * time_s + 1j * phase).real


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

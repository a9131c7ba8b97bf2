"""Records as people make them, with known truth: repeated frames, a stop by hand, clicks, several plucks, a drive."""

import numpy as np
from support.modal_decays import pole_of


def decay(time_s, frequency_hz, zeta, amplitude=1.0, phase=0.7):
    return amplitude * np.exp(pole_of(frequency_hz, zeta) * time_s + 1j * phase).real


def repeated_end(repeats, seed=1):
    """A fork of 32 Hz and 3.5e-4 at 250 fps whose last frames repeat as H.264 repeats them."""
    rng = np.random.default_rng(seed)
    t = np.arange(882) / 250.0
    y = decay(t, 32.0, 3.5e-4, 1.9, 0.0) + 0.04 * rng.standard_normal(t.size)
    frozen = decay(t[-1:], 32.0, 3.5e-4, 1.9, 0.0) + 0.003 * rng.standard_normal(repeats)
    return np.arange(882 + repeats) / 250.0, np.concatenate([y, frozen])


def stopped_by_hand(seed=1):
    """4.265 Hz and 0.45 %, touched at 8 s: a twentieth of the motion remains."""
    rng = np.random.default_rng(seed)
    t = np.arange(4000) / 200.0
    free = np.exp(-0.0045 * 2.0 * np.pi * 4.265 * np.minimum(t, 8.0)) * np.cos(2.0 * np.pi * 4.265 * t)
    left = np.where(t < 8.0, 1.0, 0.05 * np.exp(-np.clip(t - 8.0, 0.0, None) / 5.0))
    return t, free * left + 0.002 * rng.standard_normal(t.size)


def ruler_with_click(seed=1):
    """At rest, plucked at 0.55 s; zeta falls from 3.3 to 0.8 % with the amplitude; a click of 700 Hz at 2 s."""
    rng = np.random.default_rng(seed)
    t = np.arange(15000) / 5000.0
    y = np.zeros(t.size)
    amplitude, phase, turn = 30000.0, 0.7, 2.0 * np.pi * 38.4 / 5000.0
    for i in np.flatnonzero(t >= 0.55):
        y[i] = amplitude * np.cos(phase)
        amplitude *= np.exp(-(0.008 + 0.025 * amplitude / 30000.0) * turn)
        phase += turn
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


def steady_drive(seed=1):
    """A machine under steady drive of 26.765 Hz with its first harmonic, in coloured noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(3336) / 1000.0
    noise, shock = np.zeros(t.size), 0.006 * rng.standard_normal(t.size)
    for i in range(1, t.size):
        noise[i] = 0.9 * noise[i - 1] + shock[i]
    line = 0.05 * np.cos(2.0 * np.pi * 26.765 * t)
    return t, line + 0.018 * np.cos(2.0 * np.pi * 53.53 * t + 1.0) + noise

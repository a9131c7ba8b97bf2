"""Impacts within the first cycles of a record, also beside a large swing of the supports."""

import numpy as np
import pytest
from kit.identified import assert_inside, in_sd
from kit.series import decay, series_of

from modal_id import identify
from modal_id.data import FitData, rough_variance
from modal_id.segments import rest_until

FPS, HZ, ZETA, NOISE = 15000.0, 700.0, 0.0046, 0.02
T = np.arange(3750) / FPS


def impact(since_s, frequency_hz, zeta, phase):
    """A sine from time 0 on; at rest before."""
    return np.where(since_s >= 0.0, decay(since_s, frequency_hz, zeta, phase=phase - np.pi / 2), 0.0)


def noisy(values, seed):
    return values + NOISE * np.random.default_rng(seed).standard_normal(values.shape)


def rest_of(values):
    data = FitData(T, values[:, None], np.ones((T.size, 1)))
    return rest_until(data, rough_variance(data), (HZ,))


@pytest.mark.parametrize("cycles", [0.8, 2.0, 5.0, 140.0])
def test_end_of_rest_is_found(cycles):
    """Before the last start, a slow swing moves the marker by nine sd of the noise: slow drift is rest."""
    start = cycles / HZ
    found = rest_of(noisy(impact(T - start, HZ, ZETA, 0.0) + 0.3 * np.sin(2 * np.pi * 2.0 * T), 1))
    # a sine of amplitude 1 from zero exceeds six sd of 0.02, with noise on the way, within two samples
    assert start - 1 / FPS < found + 1e-9 < start + 3 / FPS


@pytest.mark.parametrize("seed", [2, 3, pytest.param(8, marks=pytest.mark.slow)])
def test_a_release_after_a_long_rest_that_a_hand_stops_soon_is_found_to_the_sample(seed):
    """Ten cycles of four modes after 45 of rest, then held: no mode was found, or one 28 sd from the true one."""
    time_s, rng = np.arange(0.0, 45.0, 1e-2), np.random.default_rng(seed)
    free, held = np.clip(time_s - 9.4, 0.0, None), np.clip(time_s - 11.49, 0.0, None)
    values = np.zeros(time_s.size)
    modes = ((4.77, 0.016, 1.0), (1.65, 0.0012, 0.35), (18.7, 0.017, 0.3), (5.93, 0.03, 0.4))
    for (hz, zeta, amplitude), phase in zip(modes, rng.uniform(0.0, 6.28, 4), strict=True):
        size = amplitude * np.exp(-2.0 * np.pi * hz * (zeta * (free - held) + 0.3 * held))
        wave = size * np.cos(2.0 * np.pi * hz * np.sqrt(1.0 - zeta**2) * free + phase)
        values += np.where(time_s < 9.4, 0.0, wave)
    found = identify(series_of(time_s, values + 1e-3 * rng.standard_normal(time_s.size)))
    assert found.segments[0].kind == "at rest"
    assert found.segments[0].end_s == pytest.approx(9.39, abs=0.011)
    assert np.max(np.abs(in_sd(found.target, 4.77, 0.016))) < 4.0, found


@pytest.mark.parametrize("phase", np.linspace(0.0, 2 * np.pi, 9)[:-1])
def test_decay_from_the_first_sample_has_no_rest(phase):
    assert rest_of(noisy(impact(T, HZ, ZETA, phase), 2)) is None
    assert rest_of(noisy(0.0 * T, 3)) is None, "nothing moves"


def test_impact_beside_a_swing_of_the_supports():
    start = 0.004
    since = T - start
    values = impact(since, HZ, ZETA, 0.0) + 20.0 * impact(since, 38.0, 0.15, 0.0)
    found = identify(series_of(T, np.stack([noisy(g * values, 7 + g) for g in (1, 2, 3)], axis=1)))
    assert [s.kind for s in found.segments] == ["at rest", "decay"]
    assert start - 1 / FPS < found.onset.time_s < start + 1 / HZ
    mode = min(found.modes, key=lambda m: abs(m.frequency_hz - HZ))
    assert np.max(np.abs(in_sd(mode, HZ, ZETA))) < 4, mode
    assert mode.damping_ratio_sd < 0.05 * ZETA


def test_a_pluck_that_decays_in_a_twentieth_of_the_record_is_found_beside_a_swing():
    """It is no line of any window of the record, and the swing of three cycles is."""
    rng = np.random.default_rng(5)
    t = np.arange(1000) / 100.0
    pluck = np.where(t < 3.0, 0.0, decay(np.maximum(t - 3.0, 0.0), 42.7, 0.045))
    found = identify(
        series_of(t, pluck + 0.1 * np.sin(2 * np.pi * 0.3 * t) + 0.002 * rng.standard_normal(t.size))
    )
    (mode,) = [m for m in found.modes if m.frequency_hz > 1.0]
    assert_inside(mode, 42.7, 0.045)

"""Identification of full records: several modes and markers, repeatability, amplitude dependence, short records."""

from dataclasses import replace

import numpy as np
import pytest
from kit.identified import assert_inside
from kit.series import PAPER_HZ, PAPER_ZETA, clamped_free_shapes, one_mode, pole_of, series_of

from modal_id import IdentifySettings, identify

EIGHT_MM = np.linspace(60.0, 490.0, 8)


def five_modes(seed, *, fps=500.0, duration_s=6.0, modes=5):
    rng = np.random.default_rng(seed)
    t = np.arange(int(fps * duration_s)) / fps
    shapes = clamped_free_shapes(EIGHT_MM)
    y = 0.007 * rng.standard_normal((t.size, 8))
    for mode in range(modes):
        wave = np.exp(pole_of(PAPER_HZ[mode], PAPER_ZETA[mode]) * t + 2j * np.pi * rng.random())
        y += wave.real[:, None] * shapes[:, mode]
    return series_of(t, y, positions_mm=EIGHT_MM)


def test_five_modes_with_eight_markers():
    theory = {"expected_frequencies_hz": tuple(PAPER_HZ * 1.03)}
    theory |= {"expected_shapes": clamped_free_shapes(EIGHT_MM)}
    found = identify(five_modes(0), IdentifySettings(mode=4, **theory))
    assert [mode.number for mode in found.modes] == [1, 2, 3, 4, 5], found.failed
    assert [mode.target for mode in found.modes] == [False, False, False, True, False]
    for mode, frequency, zeta in zip(found.modes, PAPER_HZ, PAPER_ZETA, strict=True):
        assert mode.mac > 0.9999
        assert_inside(mode, frequency, zeta)
        assert mode.posterior.r_hat[0] < 1.02
        assert min(mode.posterior.ess) > 1000
        assert np.all(mode.posterior.damping_ratio > 0.0)
    # The residual equals the simulated noise of 0.007 within its scatter.
    scatter = 0.007 * 5.0 / np.sqrt(2.0 * found.series.time_s.size)
    np.testing.assert_allclose(found.residual_sd, 0.007, atol=scatter)


def test_draws_are_reproducible_by_seed_and_differ_between_seeds_and_modes():
    series = five_modes(1, duration_s=8.0, modes=2)
    first, again = (
        identify(series, IdentifySettings(seed=7, seed_key=(1, 2), max_modes=2)) for _ in range(2)
    )
    other = identify(series, IdentifySettings(seed=8, seed_key=(1, 2), max_modes=2))
    assert len(first.modes) == 2
    for a, b, c in zip(first.modes, again.modes, other.modes, strict=True):
        assert a.posterior.frequency_hz.tobytes() == b.posterior.frequency_hz.tobytes()
        assert a.shape.tobytes() == b.shape.tobytes()
        assert a.posterior.frequency_hz.tobytes() != c.posterior.frequency_hz.tobytes()
        # With over 1000 effective draws, the Monte Carlo error of a median is below a tenth of the sd.
        assert abs(a.damping_ratio - c.damping_ratio) < 0.15 * a.damping_ratio_sd
    standard = [
        (m.posterior.frequency_hz[0] - np.mean(m.posterior.frequency_hz)) / np.std(m.posterior.frequency_hz)
        for m in first.modes
    ]
    n = min(draws.size for draws in standard)
    assert abs(np.corrcoef(standard[0][:n], standard[1][:n])[0, 1]) < 0.1
    chains = first.modes[0].posterior.frequency_hz
    assert abs(np.corrcoef(chains[0], chains[1])[0, 1]) < 0.1


def test_emcee_agrees_with_laplace_where_the_posterior_is_normal():
    series, _ = one_mode(2, 11, duration_s=5.0)
    target = identify(series, IdentifySettings()).target
    # The Laplace sd assumes white noise; the draws include the measured noise level.
    ratio = target.damping_ratio_sd / (target.posterior.laplace_sd[1] * target.posterior.noise_factor)
    assert ratio == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("seed", range(3))
def test_tuning_fork_that_loses_a_fifth_of_its_amplitude(seed):
    """32 Hz, zeta 3e-4, 1000 fps: drift must not bias the decay, and the interval must be wide."""
    rng = np.random.default_rng(seed)
    t = np.arange(3700) / 1000.0
    y = 1.5 * np.exp(pole_of(31.97, 3e-4) * t).real + 0.3 * np.sin(2.0 * np.pi * 0.2 * t)
    y += 0.05 * rng.standard_normal(t.size)
    target = identify(series_of(t, y), IdentifySettings()).target
    assert target.frequency_hz == pytest.approx(31.97, abs=0.01)
    low, high = target.damping_interval(0.999)
    assert low < 3e-4 < high
    assert "FEW_CYCLES_LOST" in target.flags


def test_noise_common_to_all_markers_does_not_average_out():
    """Camera vibration moves all markers equally: the noise factor must include it."""
    t = np.arange(4000) / 500.0
    rng = np.random.default_rng(5)
    shape = np.array([0.5, 0.7, 0.8, 1.0])
    wave = np.exp(pole_of(10.19, 0.0028) * t).real
    common = 0.02 * rng.standard_normal(t.size)
    y = wave[:, None] * shape + common[:, None] + 0.001 * rng.standard_normal((t.size, 4))
    target = identify(series_of(t, y), IdentifySettings()).target
    # sum(c)^2 / sum(c^2) = 9 / 2.38 in power; the level is estimated from about 25 bins, 15 % in amplitude.
    assert target.posterior.noise_factor == pytest.approx(np.sqrt(9.0 / 2.38), rel=0.5)


def test_sample_sd_is_used_as_weight():
    series, sd = one_mode(2, 21, fps=500.0, duration_s=4.0)
    rng = np.random.default_rng(9)
    values, sds = series.values.copy(), np.full(series.values.shape, sd)
    # Half of all samples: too many to be rejected as outliers.
    bad = rng.random(series.time_s.size) < 0.5
    values[bad, 0] += 0.2 * rng.standard_normal(bad.sum())
    sds[bad, 0] = 0.2
    weighted = replace(series_of(series.time_s, values), sd=sds)
    with_sd = identify(weighted, IdentifySettings()).target
    without = identify(series_of(series.time_s, values), IdentifySettings()).target
    assert with_sd.damping_ratio_sd < 0.5 * without.damping_ratio_sd


def test_noise_free_decay_gives_the_true_values():
    t = np.arange(2000) / 500.0
    target = identify(series_of(t, np.exp(pole_of(26.84, 0.0028) * t).real), IdentifySettings()).target
    assert target.frequency_hz == pytest.approx(26.84, rel=1e-7)
    assert target.damping_ratio == pytest.approx(0.0028, rel=1e-5)


def test_an_offset_of_a_hundred_thousand_amplitudes_changes_nothing():
    """The offset's rounding is 1.5e-11 of the amplitude, 1e-9 of the noise: far below a thousandth of any sd."""
    series, _ = one_mode(2, 5, fps=500.0, duration_s=4.0)
    values = series.values.copy()
    values[np.random.default_rng(5).random(values.size) < 0.02, 0] = np.nan
    about_zero, far = (identify(series_of(series.time_s, values + offset)).target for offset in (0.0, 1e5))
    for name in ("frequency_hz", "damping_ratio"):
        sd = getattr(about_zero, {"frequency_hz": "frequency_sd_hz"}.get(name, f"{name}_sd"))
        assert abs(getattr(far, name) - getattr(about_zero, name)) < 1e-3 * sd, name

"""Modes within 3 % of each other: resolved if the record covers their beat, flagged otherwise."""

import numpy as np
import pytest
from kit.identified import assert_inside, in_sd, quick
from kit.series import decay, pole_of, series_of

NOISE = 0.007


def pair(first_hz, second_hz, second, duration_s, seed=0, zeta=0.003):
    t = np.arange(int(duration_s * 500)) / 500
    y = np.exp(pole_of(first_hz, zeta) * t).real + second * np.exp(pole_of(second_hz, zeta) * t + 1j).real
    return series_of(t, y + NOISE * np.random.default_rng(seed).standard_normal(t.size))


@pytest.mark.parametrize(
    ("second", "duration_s"),
    [*(pytest.param(a, 10.0, marks=pytest.mark.slow) for a in (1.0, 0.1)), (0.3, 4.0)],
)
def test_a_pair_that_beats_is_two_modes(second, duration_s):
    """12.3 and 12.6 Hz beat in 3.3 s."""
    found = quick(pair(12.3, 12.6, second, duration_s), onset_s=0.0)
    assert len(found.modes) == 2, found.failed
    for mode, truth in zip(found.modes, (12.3, 12.6), strict=True):
        assert_inside(mode, truth, 0.003)
        assert "CLOSE_MODE" in mode.flags
        assert "UNRESOLVED" not in mode.flags
    np.testing.assert_allclose(found.residual_sd, NOISE, rtol=5.0 / np.sqrt(2 * found.series.time_s.size))


@pytest.mark.parametrize(
    ("second_hz", "duration_s"), [(12.35, 5.0), pytest.param(12.4, 8.0, marks=pytest.mark.slow), (12.6, 2.0)]
)
def test_a_pair_that_does_not_beat_is_two_modes_or_flagged(second_hz, duration_s):
    found = quick(pair(12.3, second_hz, 0.5, duration_s), onset_s=0.0)
    if any("UNRESOLVED" in mode.flags for mode in found.modes):
        return
    assert len(found.modes) == 2, [mode.flags for mode in found.modes]
    for mode, truth in zip(found.modes, (12.3, second_hz), strict=True):
        assert np.max(np.abs(in_sd(mode, truth, 0.003))) < 4.0, f"{mode}: {truth} Hz, 0.003"


@pytest.mark.parametrize(
    ("second_hz", "zetas", "beats", "others_hz"),
    [
        (12.6, (0.02, 0.002), 0.7, (30.0,)),
        (12.3, (0.004, 0.001), 0.6, ()),
        pytest.param(12.6, (0.01, 0.002), 0.8, (5.1, 29.0), marks=pytest.mark.slow),
    ],
)
def test_a_pair_of_less_than_a_beat_is_two_modes_where_only_two_explain_the_record(
    second_hz, zetas, beats, others_hz
):
    """Taken for one mode, it was tens of sd from both, and the modes beside it were as far from theirs."""
    time_s = np.arange(0.0, beats / (second_hz - 12.0), 1e-2)
    truths = [(12.0, zetas[0]), (second_hz, zetas[1]), *((hz, 0.005) for hz in others_hz)]
    wave = sum(decay(time_s, hz, zeta, 1.0, 1.0 + hz) for hz, zeta in truths)
    wave = wave + 3e-4 * np.random.default_rng(3).standard_normal(time_s.size)
    found = quick(series_of(time_s, wave), onset_s=0.0)
    assert len(found.modes) == len(truths), [mode.frequency_hz for mode in found.modes]
    for mode, truth in zip(found.modes, sorted(truths), strict=True):
        scores = in_sd(mode, *truth)
        # 18 scores: beyond 4 by chance once in 900 runs.
        assert np.max(np.abs(scores)) < 4.0, f"{mode}: {scores} sd from {truth}"


@pytest.mark.parametrize(
    "friction", [0.05, 0.3, *(pytest.param(f, marks=pytest.mark.slow) for f in (0.1, 0.6))]
)
def test_a_mode_with_friction_is_not_two(friction):
    """With dry friction, `da/dt = -zeta w (a + friction)`, no law of the curves is exact at 60 dB."""
    time_s = np.arange(0.0, 8.0, 1e-2)
    omega, zeta = 2.0 * np.pi * 10.0, 0.003
    size = np.maximum((1.0 + friction) * np.exp(-zeta * omega * time_s) - friction, 0.0)
    wave = size * np.cos(omega * time_s) + 1e-3 * np.random.default_rng(1).standard_normal(time_s.size)
    found = quick(series_of(time_s, wave), onset_s=0.0)
    assert len(found.modes) == 1, [mode.frequency_hz for mode in found.modes]


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_amplitude_dependent_damping_is_not_a_pair(seed):
    t = np.arange(5000) / 500
    omega, zeta0, zeta1 = 2 * np.pi * 12.3, 0.002, 0.003
    decay = np.exp(-zeta0 * omega * t)
    y = decay / (1 + zeta1 / zeta0 * (1 - decay)) * np.cos(omega * t + seed)
    y += NOISE * np.random.default_rng(seed).standard_normal(t.size)
    found = quick(series_of(t, y), onset_s=0.0)
    assert len(found.modes) == 1
    assert "AMPLITUDE_DEPENDENT" in found.target.flags
    assert "UNRESOLVED" not in found.target.flags


@pytest.mark.parametrize("part", [pytest.param(0.02, marks=pytest.mark.slow), 0.05])
def test_motion_distorted_by_its_amplitude_is_one_mode(part):
    """A cubic stiffness adds a component at the frequency of the mode that decays three times as fast."""
    t = np.arange(1200) / 500
    omega, zeta = 2 * np.pi * 88.9, 0.003
    size = np.exp(-zeta * omega * t)
    y = np.outer(size * np.cos(omega * t) + part * size**3 * np.cos(omega * t + 0.7), [1.0, -0.6, 0.3, 0.8])
    y += 1e-4 * np.random.default_rng(2).standard_normal(y.shape)
    found = quick(series_of(t, y), onset_s=0.0)
    assert len([m for m in found.modes if abs(m.frequency_hz - 88.9) < 3.0]) == 1
    assert found.target.damping_ratio == pytest.approx(zeta, rel=0.1)
    assert "CLOSE_MODE" not in found.target.flags


@pytest.mark.parametrize(
    ("apart", "zeta", "beats"),
    [
        (0.005, 0.001, 5),
        pytest.param(0.01, 0.001, 50, marks=pytest.mark.slow),
        pytest.param(0.01, 0.003, 5, marks=pytest.mark.slow),
        pytest.param(0.02, 0.003, 50, marks=pytest.mark.slow),
        pytest.param(0.03, 0.01, 5, marks=pytest.mark.slow),
        pytest.param(0.03, 0.01, 50, marks=pytest.mark.slow),
    ],
)
def test_pairs_whose_half_power_bands_do_not_overlap_are_two_modes(apart, zeta, beats):
    """12 Hz and a little more; in the longest records nine tenths follow the decay."""
    found, truths = close_pair(apart, zeta, beats)
    assert len(found.modes) == 2, (found, found.failed)
    for mode, truth in zip(found.modes, truths, strict=True):
        scores = in_sd(mode, truth, zeta)
        # 24 scores in all: beyond 4 by chance once in 650 runs.
        assert np.max(np.abs(scores)) < 4.0, f"{mode}: {scores} sd from {truth} Hz, {zeta}"
        assert "CLOSE_MODE" in mode.flags


@pytest.mark.parametrize(
    ("apart", "zeta", "beats"),
    [
        pytest.param(0.005, 0.003, 50, marks=pytest.mark.slow),
        pytest.param(0.005, 0.01, 50, marks=pytest.mark.slow),
        (0.01, 0.01, 5),
        pytest.param(0.02, 0.01, 50, marks=pytest.mark.slow),
    ],
)
def test_the_interval_of_an_unresolved_pair_holds_both(apart, zeta, beats):
    """The half-power bands overlap: one mode, said to be a pair or amplitude-dependent, with both inside."""
    found, truths = close_pair(apart, zeta, beats)
    (mode,) = found.modes
    assert {"UNRESOLVED", "AMPLITUDE_DEPENDENT"} & set(mode.flags), mode.flags
    for truth in truths:
        distance = abs(mode.frequency_hz - truth) / mode.frequency_sd_hz
        assert distance < 2.0, f"{truth} Hz lies {distance:.1f} sd from {mode}"


def close_pair(apart, zeta, beats):
    rng = np.random.default_rng([1, int(apart * 1e4), int(zeta * 1e4), beats])
    truths = 12.0 * np.array([1.0, 1.0 + apart])
    t = np.arange(min(int(beats * 10.0 / apart), 20000)) / 120.0
    sizes, phases = (1.0, rng.uniform(0.3, 1.0)), 2j * np.pi * rng.random(2)
    y = sum(a * np.exp(pole_of(f, zeta) * t + p).real for a, f, p in zip(sizes, truths, phases, strict=True))
    series = series_of(t, y + 0.005 * rng.standard_normal(t.size))
    return quick(series, onset_s=0.0), truths


@pytest.mark.parametrize(
    ("zetas", "other_hz", "amplitude"),
    [((0.034, 0.0155), 4.82, 0.2), ((0.03, 0.012), 4.80, 0.3), ((0.02, 0.008), 4.75, 0.15)],
)
def test_the_small_amplitude_of_a_pair_is_no_more_certain_than_its_being_one_mode(zetas, other_hz, amplitude):
    """A law of one mode imitates two that overlap, with values of neither: they were 4 to 16 of their sd from both."""
    time_s = np.arange(2500) / 100.0
    noise = 0.002 * np.random.default_rng(0).standard_normal(time_s.size)
    wave = decay(time_s, 4.71, zetas[0]) + decay(time_s, other_hz, zetas[1], amplitude, 2.0) + noise
    found = quick(series_of(time_s, wave))
    for mode in found.modes:
        value, sd = mode.small_amplitude_damping
        assert min(abs(value - z) for z in zetas) < 4.0 * sd, f"{value:.4g} +- {sd:.2g} is neither of {zetas}"

"""Heavy damping, many outliers, slow oscillations, aliases, a target frequency without a mode."""

import numpy as np
import pytest
from kit.identified import assert_inside, quick
from kit.series import (
    PAPER_HZ,
    PAPER_ZETA,
    clamped_free_shapes,
    cramer_rao,
    decay,
    one_mode,
    pole_of,
    series_of,
)


@pytest.mark.parametrize(
    ("frequency_hz", "zeta", "duration_s"), [(2.0, 0.2, 2.0), (10.0, 0.3, 2.0), (10.0, 0.2, 10.0)]
)
def test_heavy_damping(frequency_hz, zeta, duration_s):
    """A mode that decays within one or two cycles has no narrow spectral peak."""
    t = np.arange(int(1000 * duration_s)) / 1000
    y = np.exp(pole_of(frequency_hz, zeta) * t + 1j).real
    y += 0.007 * np.random.default_rng(0).standard_normal(t.size)
    target = quick(series_of(t, y), onset_s=0.0).target
    assert_inside(target, frequency_hz, zeta)


@pytest.mark.parametrize("share", [0.05, 0.2])
def test_many_scattered_outliers_are_rejected_and_flagged(share):
    series, _ = one_mode(2, 4, fps=500.0, duration_s=6.0)
    rng = np.random.default_rng(1)
    y = series.values[:, 0].copy()
    hit = rng.random(y.size) < share
    y[hit] += rng.choice([-1.0, 1.0], hit.sum()) * rng.uniform(0.2, 1.0, hit.sum())
    clean = quick(series, onset_s=0.0).target
    found = quick(series_of(series.time_s, y), onset_s=0.0)
    assert "MANY_OUTLIERS" in found.target.flags
    # Every outlier exceeds 28 sd; one in two million good samples is rejected, but in one cluster, within half a cycle.
    assert not np.any(found.used[hit])
    assert np.count_nonzero(~found.used) < hit.sum() + 0.5 * 500.0 / 26.84 + 4
    # The remaining samples contain the fraction 1 - share of the information.
    assert found.target.damping_ratio_sd == pytest.approx(
        clean.damping_ratio_sd / np.sqrt(1 - share), rel=0.3
    ), "the noise level is uncertain by about 10 %"
    low, high = found.target.damping_interval(0.999)
    assert low < 0.0028 < high


def test_a_burst_is_left_out_and_named():
    """A disturbance of a tenth of the record, after which the motion goes on, costs its own samples only."""
    series, sd = one_mode(2, 4, fps=500.0, duration_s=6.0)
    y = series.values[:, 0].copy()
    y[2000:2300] += 40 * sd * np.random.default_rng(0).standard_normal(300)
    found = quick(series_of(series.time_s, y), onset_s=0.0)
    (burst,) = (segment for segment in found.segments if segment.kind == "disturbed")
    assert burst.start_s <= 4.0
    assert burst.end_s >= 4.598
    assert not found.used[2000:2300].any()
    low, high = found.target.damping_interval(0.999)
    assert low < PAPER_ZETA[2] < high
    left = np.delete(series.time_s, np.arange(2000, 2300))
    ratio = found.target.frequency_sd_hz / cramer_rao(2, sd, left)[0]
    assert ratio < 1.2, f"noise level uncertain by about 10 %: sd {ratio:.2f} times that without the burst"


def test_oscillation_on_soft_supports_does_not_bias_the_modes():
    """Free-free beam: ten cycles of support oscillation, 30 times the mode's amplitude, that no pole describes."""
    rng = np.random.default_rng(2)
    t = np.arange(3750) / 15000
    slow = 30 * np.exp(-12 * t) * np.sin(2 * np.pi * 38 * t * (1 + 0.3 * t)) * (1 + 0.2 * np.cos(140 * t))
    mode = np.exp(pole_of(695.8, 0.0046) * t + 1j).real
    series = series_of(t, slow + mode + 0.02 * rng.standard_normal(t.size))
    target = quick(series, onset_s=0.0, target_frequency_hz=696.0).target
    assert_inside(target, 695.8, 0.0046)
    # Without the oscillation, the frequency has an sd of 0.03 Hz in this noise.
    assert target.frequency_sd_hz < 0.06


def test_a_mode_at_a_possible_alias_is_flagged():
    """At a sampling rate of 100 Hz, 88.6 Hz appears at 11.4 Hz, near mode 2; alone it would be numbered 2."""
    t = np.arange(600) / 100
    y = np.exp(pole_of(88.6, 0.003) * t).real + 0.01 * np.random.default_rng(0).standard_normal(t.size)
    target = quick(series_of(t, y), expected_frequencies_hz=tuple(PAPER_HZ), onset_s=0.0).target
    assert target.frequency_hz == pytest.approx(11.4, abs=0.01)
    assert "ALIASED_POSSIBLE" in target.flags
    assert any("mode 5" in note and "88.6" in note for note in target.notes)


def test_a_matching_shape_rules_out_the_alias():
    positions = np.linspace(60, 490, 6)
    shapes = clamped_free_shapes(positions)
    t = np.arange(600) / 100
    y = np.exp(pole_of(PAPER_HZ[1], 0.003) * t).real[:, None] * shapes[:, 1]
    y = y + 0.01 * np.random.default_rng(0).standard_normal(y.shape)
    theory = {"expected_frequencies_hz": tuple(PAPER_HZ), "expected_shapes": shapes}
    target = quick(series_of(t, y, positions_mm=positions), onset_s=0.0, **theory).target
    assert target.number == 2
    assert "ALIASED_POSSIBLE" not in target.flags


def test_a_target_frequency_without_a_mode_names_the_modes_found():
    series, _ = one_mode(2, 0, fps=500.0, duration_s=4.0)
    found = quick(series, target_frequency_hz=120.0, onset_s=0.0)
    (reason,) = (mode.reason for mode in found.failed if mode.target)
    assert "the modes found are at 26.84 Hz" in reason
    assert "frame rate" in reason
    found = quick(series, target_frequency_hz=470.0, onset_s=0.0)
    (reason,) = (mode.reason for mode in found.failed if mode.target)
    assert "470 Hz would appear at 30 Hz" in reason
    assert "more than 940 Hz" in reason


def test_a_fit_through_all_samples_that_were_not_rejected_knows_no_noise():
    """Twelve samples of three modes, two left out as outliers of one: ten parameters, and an sd of 1e-8."""
    y = [-1738.8203, -1536.0231, 2000.0541, -3467.0755, 1420.5618, 1575.8598]
    y += [-1407.4769, -28.3817, -252.6503, 1234.3945, -545.235, -1381.3844]
    found = quick(series_of(np.arange(12) * 1.0682855e-3, np.array(y)))
    assert [mode.codes for mode in found.failed] == [("HARDLY_DETERMINED",)], found


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_a_mode_of_three_samples_before_a_gap_is_hardly_determined(seed):
    """With 1 % of its energy after the gap, modes at other frequencies fit as well; of seed 5, enough is left."""
    rng = np.random.default_rng(seed)
    t = np.arange(370) / 53.0
    phases, hz = rng.uniform(0.0, 2.0 * np.pi, 3), rng.uniform(8.0, 18.0)
    waves = ((2.997, 0.004, 0.5), (4.89, 0.002, 0.4), (hz, 0.96 / hz, 1.2))
    y = sum(decay(t, f, z, a, p) for (f, z, a), p in zip(waves, phases, strict=True))
    y += 0.02 * rng.standard_normal(t.size)
    y[3:23] = np.nan
    found = quick(series_of(t, y))
    fast = [mode for mode in found.modes if mode.frequency_hz > 6.0]
    if seed == 5:
        (mode,) = fast
        assert_inside(mode, hz, 0.96 / hz)
    else:
        assert not fast
        assert [mode.codes for mode in found.failed] == [("HARDLY_DETERMINED",)]

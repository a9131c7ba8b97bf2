"""Modes that the user adds below the threshold of the search: those the record determines, and those it does not."""

import numpy as np
import pytest
from kit.series import QUICK, coloured, pole_of, series_of
from scipy.stats import binom

from modal_id import IdentifySettings, identify
from modal_id.data import prepare
from modal_id.fit import find_modes, power_spectrum, with_named

FAST = {"seed": 3, "sampler": QUICK}
# Frequency, damping ratio, shape.
LOUD = ((8.0, 0.01, (0.3, 0.7, 1.0)), (50.0, 0.004, (-0.24, -0.2, 0.4)))
FAINT_HZ, FAINT_ZETA, FAINT_SHAPE = 141.0, 0.003, (0.8, -0.6, 1.0)
NOISE = 0.02
T = np.arange(2000) / 500.0


def record(seed, faint, zeta=FAINT_ZETA, ar=0.0):
    """Two modes that stand out, and one of this amplitude; one sample has noise of 0.02."""
    rng = np.random.default_rng([seed, 7])
    motion = [(*mode, 1.0) for mode in LOUD] + [(FAINT_HZ, zeta, FAINT_SHAPE, faint)]
    y = sum(
        a * np.exp(pole_of(f, z) * T + 2j * np.pi * rng.random()).real[:, None] * np.array(shape)
        for f, z, shape, a in motion
    )
    return series_of(T, y + NOISE * np.stack([coloured(rng, T.size, ar) for _ in range(3)], axis=1))


def near(found, hz, reach=0.02):
    return [one for one in found if abs(one.frequency_hz - hz) < reach * hz]


@pytest.mark.parametrize("seed", [pytest.param(1, marks=pytest.mark.slow), 5])
def test_a_mode_below_the_threshold_is_fitted_where_it_is_named(seed):
    """Amplitude 0.017 beside noise of 0.02: by the bound of Cramer and Rao, its frequency is known to about 0.1 Hz."""
    series = record(seed, 0.017)
    plain = identify(series, IdentifySettings(**FAST))
    assert [round(mode.frequency_hz) for mode in plain.modes] == [8, 50]
    # Named to 0.5 %, as a click would.
    found = identify(series, IdentifySettings(add_hz=(141.7,), **FAST))
    (added,) = near(found.modes, FAINT_HZ)
    assert "ADDED" in added.flags
    assert added.frequency_hz == pytest.approx(FAINT_HZ, abs=4.0 * added.frequency_sd_hz)
    assert added.damping_ratio == pytest.approx(FAINT_ZETA, abs=4.0 * added.damping_ratio_sd)
    assert added.frequency_sd_hz < 0.3
    assert not added.target
    for before, after in zip(plain.modes, found.modes, strict=False):
        assert after.frequency_hz == pytest.approx(before.frequency_hz, abs=0.3 * before.frequency_sd_hz)
        assert "ADDED" not in after.flags


def test_a_mode_that_the_search_finds_is_the_same_with_its_name():
    series = record(0, 0.1)
    plain, named = (identify(series, IdentifySettings(add_hz=hz, **FAST)) for hz in ((), (141.0,)))
    for before, after in zip(plain.modes, named.modes, strict=True):
        assert after.frequency_hz == before.frequency_hz
        assert after.flags == before.flags
    assert named.failed == plain.failed


def test_a_line_that_need_not_decay_is_refused():
    """The hum of a lamp, below the threshold."""
    found = identify(record(2, 0.0042, zeta=1e-7), IdentifySettings(add_hz=(FAINT_HZ,), **FAST))
    assert not near(found.modes, FAINT_HZ)
    (refused,) = near(found.failed, FAINT_HZ)
    assert "does not determine whether it decays" in refused.reason or "does not decay" in refused.reason


@pytest.mark.parametrize(
    ("hz", "reason"),
    [
        (51.0, "too close to the mode at 50"),
        (260.0, "half the sampling rate"),
        (0.9, "drift"),
        (100.0, "does not determine a mode at 100 Hz"),
    ],
)
def test_the_reason_is_given_where_none_can_be_fitted(hz, reason):
    model = with_named(find_modes(prepare(record(0, 0.0)).data, 8), prepare(record(0, 0.0)).data, (hz,))
    ((refused_hz, why),) = model.refused
    assert refused_hz == hz
    assert reason in why.reason
    assert model.added_hz == ()


def highest_peak_hz(model):
    """The peak of what the modes leave that stands out most from its neighbourhood, away from the modes."""
    linear = model.fit.linear
    hz, power = power_spectrum(T, linear.residual, model.data.weights, linear.noise_variance)
    level = np.array([np.median(power[max(k - 60, 0) : k + 61]) for k in range(hz.size)])
    away = np.all([np.abs(hz / own - 1.0) > 0.1 for own, *_ in LOUD], axis=0) & (hz > 5.0) & (hz < 245.0)
    return float(hz[away][np.argmax((power / level)[away])])


@pytest.mark.parametrize(
    ("count", "ar", "chance"),
    [
        (10, 0.0, 0.005),
        pytest.param(200, 0.0, 1e-4, marks=pytest.mark.slow),
        pytest.param(200, 0.9, 1e-4, marks=pytest.mark.slow),
    ],
)
def test_the_highest_peak_of_noise_is_no_mode(count, ar, chance):
    """A user clicks on the highest peak of a spectrum; 1 % of them may have a mode there."""
    added = 0
    for seed in range(count):
        data = prepare(record(seed, 0.0, ar=ar)).data
        model = find_modes(data, 8)
        added += len(with_named(model, data, (highest_peak_hz(model),)).added_hz)
    most = int(binom.ppf(1.0 - chance, count, 0.01))
    assert added <= most, f"{added} of {count}; at a probability of 1 %, > {most} are a chance of {chance:g}"


@pytest.mark.slow
def test_intervals_of_added_modes_contain_the_truth():
    inside = []
    for seed in range(40):
        found = identify(record(seed, 0.017), IdentifySettings(add_hz=(FAINT_HZ,), **FAST))
        for mode in near(found.modes, FAINT_HZ):
            low, high = mode.damping_interval(0.9)
            inside.append(low <= FAINT_ZETA <= high)
    least = int(binom.ppf(1e-3, len(inside), 0.9))
    assert len(inside) >= 25, "most records determine it"
    assert sum(inside) >= least, (
        f"{sum(inside)} of {len(inside)} 90 % intervals; binomial bound of 1 in 1000: {least}"
    )

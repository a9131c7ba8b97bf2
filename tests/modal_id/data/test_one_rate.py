"""Records whose sampling rate changes: only the longest stretch at one rate is used, and said."""

import numpy as np
import pytest
from kit.identified import in_sd, quick
from kit.series import pole_of, series_of
from scipy.stats import chi2

from modal_id.data import longest_at_one_rate

SLOW_HZ, FREQUENCY_HZ, ZETA, NOISE = 30.0, 110.0, 0.002, 0.005


def times(slow, fast, fast_hz=960.0):
    before = np.arange(slow) / SLOW_HZ
    return np.concatenate([before, before[-1] + (1.0 + np.arange(fast)) / fast_hz])


def found_at(time_s, released_s, seed):
    """The motion rests until its release; 110 Hz shows as 10 Hz where it is sampled at 30 Hz."""
    rng = np.random.default_rng(seed)
    since = time_s - released_s
    motion = np.where(since < 0.0, 1.0, np.exp(pole_of(FREQUENCY_HZ, ZETA) * since).real)
    series = series_of(time_s, motion + NOISE * rng.standard_normal(time_s.size))
    return quick(series, seed=seed)


@pytest.mark.parametrize(
    ("time_s", "released_s"),
    [
        (times(45, 400), 0.0),
        (times(45, 400), 44.5 / SLOW_HZ),
        (times(45, 179), 44.5 / SLOW_HZ),
        (times(200, 600), 199.5 / SLOW_HZ),
    ],
)
def test_a_motion_above_half_the_slow_rate_is_no_alias(time_s, released_s):
    scores = []
    for seed in range(2):
        found = found_at(time_s, released_s, seed)
        assert found, found.reason
        assert "sampling rate changes" in " ".join(found.notes)
        assert "not used" in [s.kind for s in found.segments]
        scores += [*in_sd(found.target, FREQUENCY_HZ, ZETA)]
    limit = chi2.isf(1e-4, len(scores))
    assert np.sum(np.square(scores)) < limit, f"errors in sd {np.round(scores, 1)}: chi2 above its 1e-4 point"


def test_a_decay_over_before_the_fast_stretch_is_not_answered():
    found = found_at(times(200, 600), 0.0, 1)
    assert not found
    assert "no vibration exceeds noise" in found.reason


def test_times_at_one_rate_are_used_as_they_are():
    rng = np.random.default_rng(1)
    even = np.arange(2000) / 700.0
    missing = even[rng.random(even.size) > 0.2]
    gap = np.concatenate([even[:600], even[1500:]])
    drifting = np.cumsum(np.linspace(1.0, 1.3, 2000)) / 700.0
    jitter = even + 0.1 / 700.0 * rng.random(even.size)
    for time_s in (even, np.round(even, 3), missing, gap, drifting, jitter, even[:5]):
        assert longest_at_one_rate(np.unique(time_s)) is None


def test_rows_cover_stretches_on_both_sides_of_a_gap():
    fast = times(40, 500)
    with_gap = np.delete(fast, np.arange(200, 230))
    first, end, _ = longest_at_one_rate(with_gap)
    assert 39 <= first < 39 + 4, "the rate is a mean over four steps"
    assert end == with_gap.size

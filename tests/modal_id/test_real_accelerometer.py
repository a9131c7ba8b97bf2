"""Aluminium strips with an accelerometer: about 4 kHz, uneven time stamps, damping that decreases with amplitude."""

from functools import cache

import numpy as np
import pytest
from kit.identified import quick
from kit.series import series_of
from support.paths import REALDATA, REALDATA_ABSENT

from modal_id import IdentifySettings, identify

FOLDER = REALDATA / "al_cantilever"

pytestmark = pytest.mark.skipif(not FOLDER.is_dir(), reason=REALDATA_ABSENT)


def load(pattern):
    (path,) = FOLDER.glob(pattern)
    time_s, acceleration_g = np.load(path)
    return series_of(time_s, acceleration_g, unit="g")


@cache
def identified(pattern):
    return quick(load(pattern), max_modes=3)


@pytest.mark.parametrize(
    ("pattern", "frequency_hz", "tolerance_hz"),
    [
        pytest.param("30cm*21-08-55*", 16.33, 0.05, marks=pytest.mark.slow),
        pytest.param("30cm*21-12-02*", 16.33, 0.05, marks=pytest.mark.slow),
        pytest.param("30cm*21-13-02*", 16.33, 0.05, marks=pytest.mark.slow),
        pytest.param("50cm*11-46-55*", 6.05, 0.02, marks=pytest.mark.slow),
        pytest.param("50cm*11-47-32*", 6.05, 0.02, marks=pytest.mark.slow),
        ("50cm*11-47-59*", 6.05, 0.02),
    ],
)
def test_dominant_mode(pattern, frequency_hz, tolerance_hz):
    found = identified(pattern)
    assert found, found.reason
    target = found.target
    # One-mode fits of the first seconds by another method: 16.33 and 6.049-6.050 Hz.
    assert target.frequency_hz == pytest.approx(frequency_hz, abs=tolerance_hz)
    assert "AMPLITUDE_DEPENDENT" in target.flags
    dependence = target.amplitude_dependence
    assert dependence.significant
    assert dependence.zeta1 > 5.0 * dependence.zeta1_sd
    low, high = target.damping_interval(0.9)
    assert low < dependence.zeta0 < high, "the widened interval must include the damping at small amplitude"
    # The fit uses the uneven time stamps unchanged.
    time_s = found.series.time_s
    np.testing.assert_array_equal(time_s, load(pattern).time_s)
    after = time_s >= found.onset.fit_from_s
    assert np.all(np.isfinite(found.fitted[after]))


def test_all_zero_record_is_refused_with_a_reason():
    found = identify(load("30cm*17-54-24*"), IdentifySettings())
    assert not found
    assert "never changes" in found.reason


@pytest.mark.slow  # in the fast suite: simulated clipping, data/
def test_clipped_start_is_excluded():
    found = identified("30cm*21-12-02*")
    assert any("clipped" in note for note in found.notes)
    assert found.onset.fit_from_s > 0.6
    assert np.nanmax(np.abs(found.series.values[found.used])) < 9.80


def test_release_after_rest_is_found():
    found = identified("50cm*11-47-59*")
    assert found.onset.source == "peak"
    assert found.onset.time_s == pytest.approx(0.337, abs=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(
    "patterns",
    [
        ("30cm*21-08-55*", "30cm*21-12-02*", "30cm*21-13-02*"),
        ("50cm*11-46-55*", "50cm*11-47-32*", "50cm*11-47-59*"),
    ],
    ids=["30cm", "50cm"],
)
def test_repeats_agree_within_their_intervals(patterns):
    """Three releases of one strip: the damping ratios decrease with amplitude, and their 90 % intervals overlap."""
    targets = [identified(pattern).target for pattern in patterns]
    for target in targets:
        dependence = target.amplitude_dependence
        # 30 cm: one-mode fits by other methods give 0.0038 over the first seconds and 0.0025 over the last.
        assert dependence.zeta0 < target.damping_ratio < dependence.zeta0 + dependence.zeta1
    for interval in ("frequency_interval_hz", "damping_interval"):
        low, high = zip(*(getattr(target, interval)() for target in targets), strict=True)
        assert max(low) < min(high)

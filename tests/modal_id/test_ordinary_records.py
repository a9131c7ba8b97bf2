"""Which part of an ordinary record is a decay, and what the rest of it is."""

import numpy as np
import pytest
from kit.identified import assert_inside, quick
from kit.series import decay, one_mode, series_of, several_plucks, stopped_by_hand

from modal_id import IdentifySettings, identify

# Of a cosine of 4.265 Hz whose amplitude falls by 0.0045 of its phase.
STOPPED = (4.265 * np.hypot(1.0, 0.0045), 0.0045 / np.hypot(1.0, 0.0045))


def identified(record, **settings):
    return quick(series_of(*record), **settings)


def kinds(found):
    return [segment.kind for segment in found.segments]


def test_a_channel_with_many_gaps_hides_no_event():
    """Six of ten samples of the second channel are missing: no window of two cycles has enough of them."""
    rng = np.random.default_rng(3)
    t, y = stopped_by_hand()
    t, y = t[::2], y[::2]
    other = np.where(rng.random(t.size) < 0.6, np.nan, 0.7 * y + 0.002 * rng.standard_normal(t.size))
    found = identified((t, np.column_stack([y, other])))
    assert kinds(found)[:2] == ["decay", "disturbed"]
    # The search resolves two cycles of 4.265 Hz.
    assert 8.0 - 2.0 / 4.265 < found.segments[0].end_s <= 8.0
    assert_inside(found.target, *STOPPED)


def test_onset_before_the_end_of_clipping_refers_the_amplitude_to_the_first_sample_used():
    t = np.arange(3000) / 500.0
    y = decay(t, 12.0, 0.01, 3.0)
    noise = 1e-4 * np.random.default_rng(4).standard_normal(t.size)
    found = identified((t, np.where(np.abs(y) < 1.0, y + noise, np.sign(y))), onset_s=0.1)
    start_s = found.series.time_s[found.used.any(axis=1)][0]
    assert start_s > 1.0, "3 exp(-zeta omega t) exceeds the limit of 1 until 1.46 s"
    assert (found.onset.time_s, found.onset.fit_from_s) == (0.1, start_s)
    expected = 3.0 * np.exp(-0.01 * 2.0 * np.pi * 12.0 * start_s)
    # Noise of 1e-4 in 2000 samples and its share of the damping ratio: below 1e-4 of the amplitude.
    assert found.target.amplitude == pytest.approx(expected, rel=1e-3)


def test_a_pluck_from_rest_is_no_beat_of_decays_through_the_whole_piece():
    """Three close modes with alternating signs leave less than a tenth of the motion at 1 s."""
    t, y = several_plucks()
    found = identified((t[t < 7.0], y[t < 7.0]))
    assert kinds(found) == ["at rest", "decay"]
    # A cycle of 14.9 Hz.
    assert found.onset.time_s == pytest.approx(1.0, abs=1.0 / 14.9)
    assert_inside(found.target, 14.9, 0.008)


def test_scatter_between_decays_is_in_the_standard_deviation():
    zetas = (0.007, 0.008, 0.009, 0.0085)
    mode = identified(several_plucks(zetas)).target
    expected = np.std(zetas, ddof=1) / 2.0
    assert mode.damping_ratio_sd == pytest.approx(expected, rel=0.05), "scatter over the root of four decays"
    assert mode.damping_ratio == pytest.approx(np.mean(zetas), rel=0.02)


def test_a_ringing_record_with_rising_damping_was_not_shaken():
    """Damping that grows as the amplitude falls looks like driving that ends, but the amplitude falls throughout."""
    t = np.arange(3300) / 1000.0
    rate = np.where(t < 1.2, 0.5, 1.5)
    amplitude = np.exp(-np.cumsum(rate) / 1000.0)
    y = 0.35 * amplitude * np.cos(2 * np.pi * 128.0 * t) + np.random.default_rng(1).normal(0, 0.004, t.size)
    found = identified((t, y))
    assert found.onset.source == "record start"
    assert found.onset.fit_from_s == 0.0
    assert "driven" not in kinds(found)


def test_end_given_by_the_user():
    t, y = stopped_by_hand()
    found = identified((t, y), onset_s=2.0, end_s=7.0)
    assert_inside(found.target, *STOPPED)
    assert np.flatnonzero(found.used.any(axis=1))[[0, -1]].tolist() == [200, 700]
    assert kinds(found) == ["not used", "decay", "not used"]


def test_end_before_onset_and_too_short_a_part_are_refused():
    with pytest.raises(ValueError, match="end_s must be later than onset_s"):
        IdentifySettings(onset_s=3.0, end_s=2.0)
    series, _ = one_mode(2, 1, fps=500.0, duration_s=5.0)
    found = identify(series, IdentifySettings(onset_s=1.0, end_s=1.01))
    assert not found
    assert "onset_s and end_s" in found.reason


def test_a_refusal_says_what_the_record_shows():
    rng = np.random.default_rng(6)
    t = np.arange(3000) / 500.0
    found = identified((t, decay(t, 20.0, 0.002) + 0.01 * rng.standard_normal(t.size)), onset_s=5.99)
    assert not found
    noise = identified((t, rng.standard_normal(t.size)))
    assert not noise
    assert "decay from" not in noise.reason, "the record was taken for one decay, and shows none"

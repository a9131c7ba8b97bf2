import numpy as np
import pytest
from kit.series import decay, repeated_end

from modal_id.data import repeated_rows


@pytest.mark.parametrize("repeats", [3, 6, 12])
def test_frames_repeated_at_the_end_are_found(repeats):
    _, y = repeated_end(repeats)
    assert np.flatnonzero(repeated_rows(y[:, None])).tolist() == list(range(882, 882 + repeats))


def test_frames_repeated_within_the_record_are_found():
    rng = np.random.default_rng(2)
    y = decay(np.arange(900) / 250.0, 32.0, 1e-3) + 0.01 * rng.standard_normal(900)
    y[401:411] = y[400] + 2e-4 * rng.standard_normal(10)
    y[700] = y[699]
    assert np.flatnonzero(repeated_rows(y[:, None])).tolist() == [*range(401, 411), 700]


@pytest.mark.parametrize("noise", [0.0, 1e-6, 1e-3])
def test_a_turning_point_of_slow_motion_is_no_repetition(noise):
    """A thousand samples a cycle that end at rest: the last steps are the smallest of the record."""
    t = np.arange(4001) / 1000.0
    y = decay(t, 1.0, 1e-3, 1.0, 0.0) + noise * np.random.default_rng(3).standard_normal(t.size)
    assert not repeated_rows(y[:, None]).any()


def test_equal_samples_of_a_coarse_converter_are_no_repetition():
    rng = np.random.default_rng(4)
    y = np.round(decay(np.arange(2000) / 500.0, 8.0, 0.01, 20.0) + 0.3 * rng.standard_normal(2000))
    assert not repeated_rows(y[:, None]).any()


def test_pairs_of_rows_between_gaps_do_not_repeat():
    """No second difference is known, so that nothing shows whether the motion is slow."""
    y = np.random.default_rng(8).standard_normal((60, 1))
    y[2::3] = np.nan
    assert not repeated_rows(y).any()


def test_all_channels_must_repeat():
    rng = np.random.default_rng(5)
    y = rng.standard_normal((500, 2)).cumsum(axis=0)
    y[490:, 0] = y[489, 0]
    assert not repeated_rows(y).any()


@pytest.mark.parametrize("rate_hz", [13.0, 22.0, 29.97])
def test_a_display_that_holds_each_image_for_several_frames_repeats_most_of_them(rate_hz):
    """60 frames a second of a screen that shows fewer images: rows of the same image are known from the rates."""
    t = np.arange(450) / 60.0
    image = np.floor(t * rate_hz + 0.3)
    y = decay(image / rate_hz, 0.97, 0.02, 70.0) + 0.01 * np.random.default_rng(6).standard_normal(t.size)
    same = np.append(False, np.diff(image) == 0.0)
    found = repeated_rows(y[:, None])
    # The images at the two turning points of a cycle cannot be told from slow motion.
    expected = 1.0 - 2.0 * 0.97 / rate_hz
    assert np.mean(found[same]) > expected - 0.05, "of the rows that repeat the one before"
    assert np.mean(found[~same]) < 0.05, "of the rows that show a new image"


@pytest.mark.parametrize("channels", [1, 3])
def test_noise_does_not_stall(channels):
    assert not repeated_rows(np.random.default_rng(7).standard_normal((80, channels))).any()


def test_noise_at_rest_is_no_repetition():
    """Six samples a cycle, rest before the release and after a stop by hand, outliers."""
    rng = np.random.default_rng(6)
    t = np.arange(2000) / 6.0
    y = np.where(t > 100.0, decay(t - 100.0, 1.0, 1e-4), 0.0) * np.exp(-np.clip(t - 250.0, 0.0, None))
    y += 1e-3 * rng.standard_normal(t.size)
    y[rng.random(t.size) < 0.01] += 1.0
    assert not repeated_rows(y[:, None]).any()

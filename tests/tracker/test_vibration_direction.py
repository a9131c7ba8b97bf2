"""The direction of the vibration, beside drift and jumps across it."""

import numpy as np
import pytest

from tracker import stronger_across, vibration_direction

N, FPS = 888, 250.0
T = np.arange(N) / FPS


def motion(frequency_hz, angle, amplitude, seed, noise=0.02):
    rng = np.random.default_rng(seed)
    wave = amplitude * np.exp(-0.3 * T) * np.cos(2.0 * np.pi * frequency_hz * T)
    one = np.stack([np.cos(angle) * wave, np.sin(angle) * wave])[:, :, None]
    return np.repeat(one, 2, axis=2) + noise * rng.standard_normal((2, N, 2))


def angle_of(xy):
    found = vibration_direction(xy - np.nanmean(xy, axis=1, keepdims=True))
    assert np.hypot(*found) == pytest.approx(1.0)
    return float(np.arctan2(found[1], found[0]))


@pytest.mark.parametrize("angle", [0.0, 0.4, -0.7])
@pytest.mark.parametrize(("frequency_hz", "amplitude"), [(8.0, 0.6), (31.98, 0.1), (122.05, 0.1)])
def test_jumps_and_drift_across_it_do_not_count(frequency_hz, amplitude, angle):
    """A patch slides by 1 px along an edge, and creeps, while it vibrates by less."""
    for seed in range(3):
        xy = motion(frequency_hz, angle, amplitude, seed)
        across = np.array([-np.sin(angle), np.cos(angle)])[:, None]
        xy[:, :, 1] += across * (np.where((T > 2.0) & (T < 3.1), -1.0, 0.0) + 0.3 * np.exp(-T))[None, :]
        # The noise turns the direction by its amplitude in the line over that of the line; a slow line has the spectrum
        # of a jump of 1 px, 2 / (pi f T) px in its bin, beside it.
        turn = (0.02 * np.sqrt(2.0 / N) + 2.0 / (np.pi * frequency_hz * FPS)) / amplitude
        assert abs(angle_of(xy) - angle) < 5.0 * turn


def test_a_strong_vibration_has_the_direction_of_its_variance():
    xy = motion(23.7, 0.3, 5.0, 1)
    centred = (xy - xy.mean(axis=1, keepdims=True)).reshape(2, -1)
    vector = np.linalg.eigh(centred @ centred.T)[1][:, 1]
    # Noise of 0.02 px turns the direction of 1776 positions with an rms of 2.4 px by 2e-4.
    assert angle_of(xy) == pytest.approx(np.arctan(vector[1] / vector[0]), abs=5 * 2e-4)


def test_without_a_line_the_largest_variance_decides():
    rng = np.random.default_rng(1)
    xy = np.stack([0.1 * rng.standard_normal((N, 1)), np.cumsum(0.1 * rng.standard_normal((N, 1)), axis=0)])
    assert abs(abs(angle_of(xy)) - 0.5 * np.pi) < 0.1


def test_missing_frames_and_short_tracks():
    xy = motion(31.98, 0.4, 1.0, 1)
    xy[:, 100:300, 0] = np.nan
    assert angle_of(xy) == pytest.approx(0.4, abs=0.01)
    assert angle_of(xy[:, :40]) == pytest.approx(0.4, abs=0.02)
    assert vibration_direction(np.full((2, 50, 1), np.nan)).tolist() == [1.0, 0.0]


# The noise turns the direction by its amplitude in the line of 1000 frames, 0.02 sqrt(2 / 1000), over that of a decay
# from 2.9 px to 0.77 px, about 1.5 px. Of the slow motion, whose amplitude counts by the sixth power of 2.2 cycles
# over 4 or less, little is left.
TURN = 5.0 * 0.02 * np.sqrt(2.0 / 1000) / 1.5
CLOCK = np.arange(1000) / 250.0
SLOW = {
    "8 px in the record": 8.0 * CLOCK / CLOCK[-1],
    "2 px at .3 Hz": 2.0 * np.sin(2.0 * np.pi * 0.3 * CLOCK),
    "8 px at .5 Hz": 8.0 * np.sin(2.0 * np.pi * 0.5 * CLOCK),
}


def beside(slow, time_s=CLOCK, seed=1):
    decay = 2.9 * np.exp(-0.333 * time_s) * np.cos(2.0 * np.pi * 10.577 * time_s)
    noise = 0.02 * np.random.default_rng(seed).standard_normal((2, time_s.size, 1))
    xy = np.stack([decay, slow])[:, :, None] + noise
    return xy - np.median(xy, axis=1, keepdims=True)


@pytest.mark.parametrize("slow", SLOW.values(), ids=SLOW)
def test_slow_motion_of_the_camera_is_not_the_vibration(slow):
    for seed in range(3):
        centred = beside(slow, seed=seed)
        for frame_s in (None, 0.004):
            assert vibration_direction(centred, frame_s) == pytest.approx([1.0, 0.0], abs=TURN)


def test_slow_motion_of_many_cycles_is_told_from_the_vibration_by_its_frequency():
    time_s = np.arange(5000) / 250.0
    centred = beside(8.0 * np.sin(2.0 * np.pi * 0.5 * time_s), time_s)
    assert vibration_direction(centred, 0.004)[0] == pytest.approx(1.0, abs=1e-3)
    (note,) = stronger_across(centred, np.array([1.0, 0.0]), 0.004)
    assert "0.5 Hz" in note
    assert "camera" in note


def test_a_note_only_where_the_axis_left_out_moves_more():
    right = np.array([1.0, 0.0])
    assert stronger_across(beside(0.0 * CLOCK), right, 0.004) == ()
    assert stronger_across(beside(0.2 * np.sin(2.0 * np.pi * 0.3 * CLOCK)), right, 0.004) == ()
    (note,) = stronger_across(beside(6.0 * np.sin(2.0 * np.pi * 30.0 * CLOCK)), right, 0.004)
    assert "about 30 Hz" in note
    assert "`direction`" in note

"""Shadows, jumps and damaged frames: stations are flagged or found again, not guessed."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from kit.lines import SMALL, calibrated, followed

from benchmarks.line_scenes import LineScene
from tracker import flags
from tracker.line import LINES, ORDER, LineFollower
from tracker.line import follower as line_follower
from tracker.line import stations as line_kernels

SCENE = LineScene(**SMALL)


@pytest.fixture(scope="module")
def frames():
    return SCENE.frames(24)


def test_a_covered_part_is_missing_and_the_rest_is_measured(frames):
    covered = [f.copy() for f in frames]
    for image in covered[10:]:
        image[60:85] = 120
    found = followed(SCENE, covered, calibration=10)
    rows = SCENE.points(0.0, found.arc_px)[0][:, 1]
    inside, outside = (rows > 63.0) & (rows < 82.0), (rows < 55.0) | (rows > 90.0)
    assert np.all(np.isnan(found.across_px[10:, inside]))
    assert np.all(found.flags[10:, inside] & flags.NOT_FOUND.value)
    assert np.all(np.isfinite(found.across_px[10:, outside]))
    sd = np.nanmedian(found.sd_px)
    assert np.abs(found.across_px[10:, outside]).max() < 6.0 * sd


def test_a_jump_of_many_widths_is_found_again(frames):
    """Half of the record is missing: the beam is elsewhere, its prediction is worth nothing."""
    far = replace(SCENE, tip_px=(34.0, 0.0), shape=(150, 110), clamp_px=(54.3, 16.6))
    times = [0, 1, 2, 3, 4, 5, 6, 7, 13, 27, 40, 53]
    images = [far.frames(1, first=k)[0] for k in times]
    steps = [
        np.abs(far.points(a, np.array([110.0]))[0] - far.points(b, np.array([110.0]))[0]).max()
        for a, b in pairwise(times[8:])
    ]
    assert max(steps) > 10 * far.width_px, "the scene has no jump"
    found = followed(far, images, calibration=8, times=times)
    assert np.mean(np.isfinite(found.across_px)) > 0.99
    assert np.nanmax(np.abs(found.across_px)) < 6.0 * np.nanmax(found.sd_px)


def test_a_damaged_frame_is_missing_and_the_next_is_not(frames):
    model = calibrated(SCENE, frames[:12])
    follower = LineFollower(model)
    for image in frames[:5]:
        follower.step(image)
    missing = follower.missing(flags.DECODE_CORRUPT.value)
    assert np.all(np.isnan(missing.out))
    assert np.all(missing.marks == flags.DECODE_CORRUPT.value | flags.NOT_FOUND.value)
    assert np.all(np.isfinite(follower.step(frames[6]).out))


def test_an_empty_picture_has_no_line(frames):
    model = calibrated(SCENE, frames[:12])
    rng = np.random.default_rng(4)
    empty = np.clip(rng.normal(180.0, 2.0, frames[0].shape), 0, 255).astype(np.uint8)
    result = LineFollower(model).step(empty)
    assert np.all(np.isnan(result.out))
    assert np.all(result.marks & flags.NOT_FOUND.value)


def test_a_line_without_contrast_is_refused(frames):
    rng = np.random.default_rng(5)
    plain = [np.clip(rng.normal(120.0, 2.0, f.shape), 0, 255).astype(np.uint8) for f in frames[:8]]
    refused = calibrated(SCENE, plain)
    assert not refused
    assert "line_px" in refused.reason


def test_only_the_component_across_the_line_is_measured(frames):
    """Errors of x and y of a line at 45 degrees are the same: their sum or difference is exact."""
    slanted = replace(
        SCENE,
        angle_rad=0.25 * np.pi,
        length_px=90.0,
        shape=(110, 110),
        clamp_px=(20.3, 20.6),
        tip_px=(1.0, 0.0),
    )
    found = followed(slanted, slanted.frames(8))
    normal = np.array([-np.sin(0.25 * np.pi), np.cos(0.25 * np.pi)])
    assert np.all(found.correlation == np.sign(normal[0] * normal[1]))


def test_three_decaying_vibrations_are_predicted():
    """Sums of three damped sines about any rest follow a recursion over six steps exactly."""
    rng = np.random.default_rng(7)
    rest, shapes = rng.uniform(0.0, 100.0, (5, 2)), rng.uniform(-4.0, 4.0, (3, 5, 2))
    rates = np.array([0.031, 0.19, 0.37])

    def line(k):
        swings = np.exp(-0.01 * rates * k) * np.cos(2.0 * np.pi * rates * k + rates)
        return rest + np.tensordot(swings, shapes, 1)

    normal, rhs, ahead, missed = np.zeros((ORDER, ORDER)), np.zeros(ORDER), np.zeros(LINES), []
    for k in range(LINES, 80):
        past, found, guess = np.stack([line(k - 1 - i) for i in range(LINES)]), line(k), np.empty((5, 2))
        line_kernels.weighted(ahead, past, guess)
        missed.append(np.abs(guess - found).max())
        line_kernels.learn_recursion(past, found, normal, rhs, ahead)
    # From the weights' shrinkage only, which stands for errors of 0.01 px in lines that move by px from frame to frame.
    assert max(missed[20:]) < 10.0 * line_kernels.TUNING.learnable_px, missed
    assert ahead.sum() == pytest.approx(1.0), "what rests is predicted to rest"


def test_fast_vibrations_are_met_at_the_first_attempt(monkeypatch):
    """Two vibrations of a third and a fifth of the frame rate: a polynomial misses each line by px."""
    fast = replace(SCENE, cycles_per_frame=(0.21, 0.33))
    images = fast.frames(48)
    follower = LineFollower(calibrated(fast, images[:24]))
    found, attempts = [], []
    register_about = line_kernels.register_about

    def counted(*arguments):
        attempts[-1] += 1
        return register_about(*arguments)

    monkeypatch.setattr(line_kernels, "register_about", counted)
    for image in images:
        attempts.append(0)
        follower.step(image)
        found.append(follower.model.line.at_stations(follower.fit.moved).points)
    steps = np.diff(found, n=3, axis=0)[20:]
    assert np.abs(steps).max() > 10.0 * line_follower.TUNING.largest_miss_px, "a polynomial would do"
    # 24 frames are enough to learn from; before that, every line is registered twice or more.
    assert min(attempts[4:8]) > 1, attempts
    assert max(attempts[24:]) == 1, attempts

"""Thumbnails of a recording: their frames, number and size."""

import numpy as np

from tracker.follow import StripKeeper, recording


def filled(n, x, size=(100, 640)):
    keeper = StripKeeper()
    for k in range(n):
        image = np.full(size, k % 251, np.uint8)
        keeper.offer(k, image, np.array([[x[k], np.nan], [5.0, np.nan]]))
    return keeper


def test_first_last_even_and_the_largest_displacement_are_kept():
    n = 1000
    x = 50 + 0.1 * np.sin(np.arange(n))
    x[637] += 4.0
    strip = filled(n, x).strip(np.arange(n))
    assert {0, 637, 999} <= set(strip.frame.tolist())
    assert recording.TUNING.most_images / 2 <= strip.frame.size <= recording.TUNING.most_images + 2
    assert np.all(np.diff(strip.frame) > 0)
    assert np.max(np.diff(strip.frame)) <= n / (recording.TUNING.most_images / 2)
    assert strip.images.shape == (strip.frame.size, 50, 320)
    assert strip.shrink == 2.0
    assert strip.images[:, 7, 9].tolist() == [k % 251 for k in strip.frame]


def test_the_strip_is_in_presentation_order():
    order = np.array([1, 0, 2])
    strip = filled(3, np.zeros(3)).strip(order)
    assert strip.frame.tolist() == [0, 1, 2]
    assert strip.images[:, 0, 0].tolist() == [1, 0, 2]


def test_without_frames_there_is_no_strip():
    assert StripKeeper().strip(np.arange(0)) is None


def test_images_of_more_than_8_bit_are_scaled_to_8_bit():
    keeper = StripKeeper()
    image = np.linspace(1000, 3000, 64 * 64).reshape(64, 64).astype(np.uint16)
    keeper.offer(0, image, np.full((2, 1), np.nan))
    strip = keeper.strip(np.arange(1))
    assert strip.images.dtype == np.uint8
    assert (strip.images.min(), strip.images.max()) == (0, 255)

"""Pictures whose background departs for one frame, and scenes in which nothing is wrong."""

import numpy as np
import pytest

from tracker.video import Frame, without_departures

FRAMES, HEIGHT, WIDTH, EVENT = 60, 160, 240, 30
Y, X = np.mgrid[:HEIGHT, :WIDTH]


def scene(change, depth=8, seed=3):
    """A textured wall and a vibrating dot with noise; `change(k, image)` is what happens besides."""
    rng = np.random.default_rng(seed)
    wall = 110.0 + 25.0 * np.sin(X / 9.0) * np.cos(Y / 13.0)
    for k in range(FRAMES):
        dot = np.clip(15.0 - np.hypot(X - 120.0 - 12.0 * np.sin(0.8 * k), Y - 80.0), 0.0, 1.0)
        image = change(k, np.where(dot > 0.0, wall - 80.0 * dot, wall)) + rng.normal(0.0, 2.0, wall.shape)
        scaled = np.clip(image, 0.0, 255.0) * 2.0 ** (depth - 8)
        yield Frame(np.rint(scaled).astype(np.uint8 if depth == 8 else np.uint16), 3 * k)


def missing(change, depth=8):
    shown = list(without_departures(scene(change, depth), 2**depth - 1))
    assert [frame.pts for frame in shown] == [3 * k for k in range(FRAMES)], "frames are lost or out of order"
    return [k for k, frame in enumerate(shown) if frame.image is None]


def from_block(k, image, *, frames=(EVENT,), row=64, column=80, height=16, step=12.0):
    """A row of blocks is wrong from one of them on, as after an error in the code of a JPEG image."""
    if k in frames:
        image = image.copy()
        image[row : row + height, column:] += step
    return image


@pytest.mark.parametrize("depth", [8, 12])
def test_a_damaged_row_of_blocks_has_no_image(depth):
    assert missing(from_block, depth) == [EVENT]


def test_a_frame_without_image_beside_a_damaged_one_stays_in_its_place():
    frames = [Frame(None, f.pts) if f.pts == 3 * (EVENT + 1) else f for f in scene(from_block)]
    shown = list(without_departures(iter(frames), 255))
    assert [f.pts for f in shown] == [f.pts for f in frames]
    assert [k for k, f in enumerate(shown) if f.image is None] == [EVENT, EVENT + 1]


def flash(k, image):
    return image + 40.0 * (k == EVENT)


def lamp(k, image):
    return image + 30.0 * (X / WIDTH) * (k >= EVENT)


def flicker(k, image):
    return image * (1.0 + 0.1 * np.sin(2.1 * k + Y / 40.0))


def hand(k, image):
    return np.where(np.abs(X - 20.0 * (k - EVENT)) < 50.0, 190.0, image)


def bump(k, image):
    late = max(k - EVENT, 0)
    return np.roll(image, round(6.0 * np.exp(-0.2 * late) * np.sin(1.3 * late)), axis=1)


def released_beam(k, image):
    late = max(k - EVENT, 0)
    return np.where(np.abs(X - 170.0 - 40.0 * np.exp(-0.03 * late) * np.cos(2.0 * late)) < 4.0, 20.0, image)


def lamp_in_view(k, image):
    blinks = k >= EVENT and k % 5 == 0
    return image + 90.0 * (blinks & (np.hypot(X - 40.0, Y - 120.0) < 14.0))


@pytest.mark.parametrize("change", [flash, lamp, flicker, hand, bump, released_beam, lamp_in_view])
def test_events_in_front_of_the_camera_are_not_damage(change):
    assert missing(change) == []

"""Points proposed as patches: where there is texture that moves, and nowhere else."""

import itertools
from contextlib import closing

import numpy as np
import pytest
from support.paths import REALDATA

from tracker.markers.proposals import WINDOW_PX, propose_points
from tracker.video.registry import open_recording

HEIGHT, WIDTH = 200, 300


def film(shift_px, count=12, noise=1.0):
    """A still textured background and a textured square of 40 px about (200, 90) that moves sideways."""
    rng = np.random.default_rng(3)
    still = np.kron(rng.uniform(60, 190, (HEIGHT // 4, WIDTH // 4)), np.ones((4, 4)))
    square = np.kron(rng.uniform(20, 250, (10, 10)), np.ones((4, 4)))
    frames = []
    for k in range(count):
        image = still.copy()
        left = 180 + round(shift_px * np.sin(0.7 * k))
        image[70:110, left : left + 40] = square
        frames.append(np.clip(image + rng.normal(0, noise, image.shape), 0, 255).astype(np.uint8))
    return frames


def test_the_moving_square_is_proposed_first():
    points = propose_points(film(3.0))
    # Half the window reaches the square, whose edges move as well.
    assert np.max(np.abs(points[0] - (200, 90))) <= 20 + 3 + WINDOW_PX / 2, points
    apart = np.linalg.norm(points[:, None] - points[None], axis=2)[np.triu_indices(len(points), 1)]
    assert apart.size == 0 or apart.min() >= WINDOW_PX


@pytest.mark.parametrize("frames", [film(0.0), film(0.0)[:2], [np.zeros((40, 40), np.uint8)] * 5])
def test_nothing_is_proposed_where_nothing_moves(frames):
    assert propose_points(frames).shape == (0, 2)


def test_deep_images_give_the_same_points():
    frames = film(3.0, noise=0.0)
    deep = [image.astype(np.uint16) * 16 for image in frames]
    assert np.allclose(propose_points(deep)[0], propose_points(frames)[0], atol=WINDOW_PX / 2)


@pytest.mark.skipif(
    not REALDATA.is_dir(), reason="the folder of real recordings, ../shared/realdata, is absent"
)
def test_the_weights_of_a_fork_are_proposed():
    """The weights reach from (283, 76) to (310, 128) and from (352, 76) to (379, 130)."""
    (path,) = (REALDATA / "tuning_forks").glob("tuning_hz32*.mp4")
    with closing(open_recording(path)) as source:
        frames = [frame.image for frame in itertools.islice(source.frames(), 32)]
    points = propose_points(frames, 2)
    lefts = [283, 352] if points[0, 0] < points[1, 0] else [352, 283]
    for (x, y), left in zip(points, lefts, strict=True):
        assert left - 8 <= x <= left + 27 + 8, points
        assert 76 - 8 <= y <= 130 + 8, points

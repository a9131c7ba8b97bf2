"""Points proposed as patches: where there is texture that moves, and nowhere else."""

import itertools
from contextlib import closing

import numpy as np
import pytest
from scipy import ndimage
from support.paths import REALDATA, REALDATA_ABSENT

from tracker.markers import proposals, propose_points
from tracker.video import open_recording

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
    assert np.max(np.abs(points[0] - (200, 90))) <= 20 + 3 + proposals.TUNING.window_px / 2, points
    apart = np.linalg.norm(points[:, None] - points[None], axis=2)[np.triu_indices(len(points), 1)]
    assert apart.size == 0 or apart.min() >= proposals.TUNING.window_px


@pytest.mark.parametrize("frames", [film(0.0), film(0.0)[:2], [np.zeros((40, 40), np.uint8)] * 5])
def test_nothing_is_proposed_where_nothing_moves(frames):
    assert propose_points(frames).shape == (0, 2)


def test_a_frame_in_which_a_spot_is_not_seen_is_not_its_stillest():
    assert proposals.stillest_frame(np.outer([0.0, 9.0, 18.0, np.nan, 18.1, 40.0], [1.0, 0.0])) == 0


def test_deep_images_give_the_same_points():
    frames = film(3.0, noise=0.0)
    deep = [image.astype(np.uint16) * 16 for image in frames]
    assert np.allclose(
        propose_points(deep)[0], propose_points(frames)[0], atol=proposals.TUNING.window_px / 2
    )


@pytest.mark.parametrize("shift_px", [0.1, 0.3])
def test_a_motion_of_a_tenth_of_a_pixel_is_proposed_before_stronger_changes(shift_px):
    """A texture that shifts as a whole, beside one that changes into others, as a gear that turns.

    Slopes of 10 gray levels per px and noise of 1: the shift explains 1 gray level, the noise of a window of 31 px
    0.05. The pixels of the other texture change by 30.
    """
    rng = np.random.default_rng(4)
    base = ndimage.gaussian_filter(rng.normal(size=(HEIGHT, WIDTH)), 2.0)
    base *= 30.0 / base.std()
    across = np.gradient(base, axis=1)
    frames = []
    for k in range(16):
        image = 120.0 + base
        image[60:120, 170:240] -= shift_px * np.sin(0.7 * k) * across[60:120, 170:240]
        other = ndimage.gaussian_filter(rng.normal(size=(40, 40)), 2.0)
        image[60:100, 50:90] = 120.0 + 30.0 * other / other.std()
        frames.append(np.clip(np.rint(image + rng.normal(0, 1.0, image.shape)), 0, 255).astype(np.uint8))
    x, y = propose_points(frames)[0]
    assert 170 - proposals.TUNING.window_px / 2 < x < 240 + proposals.TUNING.window_px / 2, (x, y)
    assert 60 - proposals.TUNING.window_px / 2 < y < 120 + proposals.TUNING.window_px / 2, (x, y)


@pytest.mark.skipif(not REALDATA.is_dir(), reason=REALDATA_ABSENT)
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


@pytest.mark.skipif(not REALDATA.is_dir(), reason=REALDATA_ABSENT)
@pytest.mark.parametrize(
    ("file", "left_px"), [("fork64_on_bricks_fps250.mp4", 415), ("fork128_on_bricks_fps1000.mp4", 440)]
)
def test_the_prongs_of_a_fork_are_proposed_beside_turning_gears(file, left_px):
    """Motions of 2 and 0.3 px; the gears lie between 230 and 350 px, and the prongs right of `left_px`.

    Measured: 6 and 5 of 6 proposals on the prongs.
    """
    with closing(open_recording(REALDATA / "ordinary" / file)) as source:
        frames = [frame.image for frame in itertools.islice(source.frames(), 32)]
    points = propose_points(frames)
    assert np.count_nonzero(points[:, 0] > left_px) >= 4, points

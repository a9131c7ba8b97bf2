"""Films of targets that move far between frames: what is identified from them is right within its intervals."""

import numpy as np
import pytest
from kit import films as media
from kit.films import BALL_HZ, BALL_ZETA, DOTS_X_PX, FPS_BALL, FPS_DOTS, ball_images, dot_images, swing_px
from kit.identified import in_sd

from modal_id import IdentifySettings, identify
from tracker import TrackerSettings, displacement_series, track


def identified(path, settings):
    tracks = track(path, settings, recording="a")
    assert tracks, tracks.reason
    found = identify(displacement_series(tracks), IdentifySettings(seed=1))
    assert found, found.reason
    return found


def assert_right(mode, frequency_hz, zeta):
    assert np.max(np.abs(in_sd(mode, frequency_hz, zeta))) < 3.0, mode


@pytest.mark.slow  # in the fast suite: the positions, tracker/follow/test_look_alikes.py
def test_look_alikes_that_swing_by_half_their_spacing_at_three_frames_a_cycle(tmp_path):
    swing = swing_px(80)
    # Three of the dots: fewer tell less which is which.
    centres = np.stack([DOTS_X_PX[None, :3] + swing[:, None], np.full((80, 3), 55.0)], axis=2)
    path = media.write(tmp_path / "a.mkv", dot_images(centres, shape=(110, 440)), codec="ffv1")
    # The exposure of this film is estimated in tracker/follow/test_look_alikes.py.
    found = identified(path, TrackerSettings(fps=FPS_DOTS, kind="blob", exposure_s=1e-5))
    # Decay of 0.05 and phase of 2 pi / 3.1 in a frame.
    pole = FPS_DOTS * complex(-0.05, 2.0 * np.pi / 3.1)
    assert_right(found.target, abs(pole) / (2.0 * np.pi), -pole.real / abs(pole))


# in the fast suite: such a ball is followed (test_patch), little decay is identified (test_little_decay)
@pytest.mark.slow
@pytest.mark.xfail(
    strict=True, reason="a weak line in a part of the record is taken for a faster motion: refused"
)
def test_a_ball_that_leaves_its_first_window_by_far(tmp_path):
    """600 frames of a pendulum that keeps 95 % of its amplitude."""
    # The ball reaches from column 137 to 503.
    images = ball_images(600, rows=(75, 165), columns=(120, 520))
    path = media.write(tmp_path / "a.mkv", images, codec="ffv1")
    settings = TrackerSettings(fps=FPS_BALL, kind="patch", points_px=((350.0, 45.0),))
    found = identified(path, settings)
    omega = 2.0 * np.pi * BALL_HZ * complex(-BALL_ZETA, 1.0)
    assert_right(found.target, abs(omega) / (2.0 * np.pi), -omega.real / abs(omega))
    assert "FEW_CYCLES_LOST" in found.target.flags

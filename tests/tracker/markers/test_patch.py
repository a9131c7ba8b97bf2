"""Patches with square and round windows, on a textured ball that swings in front of a textured wall."""

import numpy as np
import pytest
from kit import films as media
from kit.films import FPS_BALL, ball_images, ball_x_px

from tracker import TrackerSettings, track
from tracker.markers import PatchDetector

FRAMES = 40
POINTS_PX = ((470.0, 120.0),)


def test_the_round_window_leaves_out_the_corners():
    image = np.random.default_rng(0).integers(0, 255, (200, 300), dtype=np.uint8)
    areas = {}
    for shape in ("square", "round"):
        found = PatchDetector(((150.0, 100.0),), None, 61.0, shape).detect([image])
        areas[shape] = np.count_nonzero(found.detections[0].template.support)
    # A disc fills pi / 4 of the square around it, to the pixels on its circumference.
    assert areas["round"] / areas["square"] == pytest.approx(np.pi / 4, abs=0.03)


def test_patches_have_the_names_that_were_given():
    image = np.random.default_rng(0).integers(0, 255, (200, 300), dtype=np.uint8)
    points = ((100.0, 100.0), (200.0, 100.0))
    found = PatchDetector(points, None, 31.0, names=("root", "free end")).detect([image])
    assert [one.name for one in found.detections] == ["root", "free end"]
    assert found.notes[1].startswith("Patch free end is")
    refused = PatchDetector(points, None, 31.0, names=("root",)).detect([image])
    assert "names has 1 entries, but points_px has 2" in refused.reason


def test_a_patch_on_a_ball_follows_it_and_not_the_wall(tmp_path):
    """A window as large as the ball: half a period carries it over 300 px of wall, up to 15 px a frame."""
    path = media.write(tmp_path / "a.mkv", ball_images(FRAMES), codec="ffv1")
    settings = TrackerSettings(
        fps=FPS_BALL, kind="patch", points_px=POINTS_PX, size_px=61.0, patch_shape="round", exposure_s=1e-5
    )
    tracks = track(path, settings, recording="a")
    error = tracks.x_px[:, 0] - ball_x_px(FRAMES)
    assert np.isfinite(error).mean() > 0.95
    # Linear interpolation of the rendered ball moves its texture by up to a tenth of a pixel.
    assert np.nanmax(np.abs(error)) < 0.2, "a patch that stays on the wall is 300 px off"
    assert any("round window of 61 px" in note for note in tracks.notes)

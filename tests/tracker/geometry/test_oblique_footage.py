"""Footage warped to an oblique view, with known motion: rectified by the shape of its markers."""

from fractions import Fraction

import cv2
import numpy as np
from kit import films as media
from kit.scenes import Recording

from tracker import TrackerSettings, displacement_series, track

# From the frontal to the oblique image: compressed horizontally, smaller towards the right.
VIEW = np.array([[0.85, 0.03, 30.0], [0.02, 1.0, -5.0], [2.5e-4, 2e-5, 1.0]])


def footage(tmp_path, view, frames=20):
    # 20 frames are nine tenths of a cycle.
    recording = Recording(
        "aruco", frames=frames, markers=6, frequency_hz=45.2, amplitude_px=3.0, rotation_rad=0.0, size_px=32.0
    )
    images = recording.images()
    if view is not None:
        images = [
            cv2.warpPerspective(i, view, (640, 480), flags=cv2.INTER_CUBIC, borderValue=200) for i in images
        ]
    path = media.write(tmp_path / "a.mkv", images, codec="ffv1")
    settings = TrackerSettings(
        fps=Fraction(1000), kind="aruco", dictionary="DICT_4X4_50", size_mm=32.0, exposure_s=1e-5
    )
    return recording, track(path, settings, recording="a")


def test_displacements_have_their_true_length_everywhere(tmp_path):
    recording, tracks = footage(tmp_path, VIEW)
    assert tracks.plane is not None
    assert any("The view is oblique" in note for note in tracks.notes)
    truth = recording.truth_px()
    plain = np.ptp(tracks.x_px, axis=0) * tracks.scale.mm_per_px
    # The scale of the scene is 1 mm per pixel.
    for k, name in enumerate(tracks.markers):
        path_mm = truth[:, int(name.removeprefix("id"))]
        measured = np.stack([tracks.x_mm[:, k], tracks.y_mm[:, k]], axis=1)
        largest, expected = (np.hypot(*(p - p[0]).T).max() for p in (measured, path_mm))
        # Each size of 30 px has an error of 0.05 px; six markers determine five parameters.
        assert abs(largest / expected - 1.0) < 0.006, (name, largest / expected)
    assert np.ptp(plain) > 0.1 * np.mean(plain)
    assert displacement_series(tracks).unit == "mm"


def test_a_frontal_view_is_not_rectified(tmp_path):
    _, tracks = footage(tmp_path, None, frames=12)
    assert tracks.plane is None
    assert abs(tracks.scale.mm_per_px - 1.0) < 3 * tracks.scale.sd_mm_per_px

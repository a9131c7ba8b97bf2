"""The cases of the benchmark of moving cameras."""

import pytest

from benchmarks.camera_motion import CameraCase
from tracker import displacement_series


def test_displacements_beside_a_drifting_camera_are_along_the_vibration():
    series = displacement_series(CameraCase(drift_px=8.0).tracks())
    assert series.direction == pytest.approx((1.0, 0.0), abs=1e-3)
    assert any("motion of the camera" in note for note in series.notes)
    assert not any("camera" in note for note in displacement_series(CameraCase().tracks()).notes)

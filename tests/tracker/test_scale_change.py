"""Slow zoom: followed by the spacing of the markers, and nothing else taken for it."""

import numpy as np
import pytest

from benchmarks.camera_motion import CameraCase, answer
from tracker.displacement import displacement_series


def series(case):
    return displacement_series(case.tracks(), unit="px")


@pytest.mark.parametrize("markers", [2, 3, 6])
@pytest.mark.parametrize("hz", [0.0, 0.3])
def test_the_scale_is_that_of_the_camera(markers, hz):
    case = CameraCase(zoom=0.02, zoom_hz=hz, markers=markers)
    found = series(case).scale_change
    assert found is not None
    scale = found.scale(case.time_s) * case.scale()[0]
    # Two markers 200 px from the middle with 0.02 px of noise: 1e-4 in one frame. A spline averages dozens of frames.
    error = float(np.sqrt(np.mean((scale / case.scale() / np.mean(scale / case.scale()) - 1.0) ** 2)))
    assert error < 1e-4, f"rms error of the scale {error:.2g}, noise of one frame is 1e-4"


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("zoom", [-0.02, 0.01, 0.03])
def test_damping_is_right_in_spite_of_a_zoom(zoom, seed):
    case = CameraCase(zoom=zoom, markers=3, seed=seed)
    found = answer(case, case.tracks())
    assert abs(found.damping_z) < 3.5, f"off by {found.damping_z:.2g} sd; without a correction by 16 to 40"


@pytest.mark.parametrize("markers", [1, 2, 3, 6])
@pytest.mark.parametrize("amplitude_px", [1.0, 2.9, 20.0, 60.0])
def test_a_camera_at_rest_does_not_zoom(markers, amplitude_px):
    """Large vibrations shorten the beam at twice their frequency and by a slow part: that is no zoom."""
    for seed in range(5):
        found = series(CameraCase(markers=markers, amplitude_px=amplitude_px, seed=seed))
        assert found.scale_change is None
        assert not [note for note in found.notes if "zoom" in note]


def test_one_marker_does_not_show_a_zoom_and_says_so():
    found = series(CameraCase(zoom=0.03, markers=1))
    assert found.scale_change is None
    assert [note for note in found.notes if "One marker does not show which" in note]


@pytest.mark.slow
def test_intervals_of_damping_include_the_error_of_the_correction():
    z = []
    for seed in range(100):
        case = CameraCase(zoom=0.02, zoom_hz=0.1, markers=3, seed=seed)
        z.append(answer(case, case.tracks()).damping_z)
    # 100 values of unit variance have an rms of 1 with a standard error of 0.07.
    assert 0.8 < float(np.sqrt(np.mean(np.square(z)))) < 1.2

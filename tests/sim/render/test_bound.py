"""Bound of the marker position, compared with the bound from a rendered scene, and its scaling."""

import numpy as np
import pytest
from kit.scenes import Recording, cramer_rao_px

from sim.render import Camera, DotMarker, position_bound_px


def camera(**changes):
    options = {
        "width_px": 64,
        "height_px": 64,
        "mm_per_px": 1.0,
        "origin_px": (0.0, 0.0),
        "read_noise_sd": 1.5,
    }
    return Camera(**{**options, "noise_gain": 0.05, **changes})


@pytest.mark.parametrize("kind", ["blob", "aruco"])
def test_bound_matches_the_rendered_scene(kind):
    recording = Recording(kind, markers=3, height_px=160, rotation_rad=0.0)
    marker = recording.scene.markers[0]
    expected = np.sqrt(
        np.mean(
            [cramer_rao_px(recording, 0, with_angle=kind == "aruco", time_s=t)[0] ** 2 for t in (0.0, 0.007)]
        )
    )
    found = position_bound_px(marker, recording.camera, np.zeros(1))[0]
    # The two bounds average over two and three subpixel positions: they differ by 1 to 2 %.
    assert found == pytest.approx(expected, rel=0.03)


def test_bound_scales_with_noise_and_scale():
    dot = DotMarker(diameter_mm=12.0)
    one = position_bound_px(dot, camera(read_noise_sd=4.0, noise_gain=0.0), np.zeros(1))[0]
    double = position_bound_px(dot, camera(read_noise_sd=8.0, noise_gain=0.0), np.zeros(1))[0]
    # The rounding variance of 1/12 is 0.5 % of 16 and 0.13 % of 64.
    assert double / one == pytest.approx(2.0, rel=0.003)
    finer = position_bound_px(DotMarker(diameter_mm=6.0), camera(mm_per_px=0.5), np.zeros(1))[0]
    assert finer == pytest.approx(position_bound_px(dot, camera(), np.zeros(1))[0], rel=1e-9)


def test_blur_raises_the_bound_along_the_motion():
    dot = DotMarker(diameter_mm=12.0)
    along = position_bound_px(dot, camera(), np.array([0.0, 3.0, 6.0, 12.0]))
    assert np.all(np.diff(along) > 0.0)
    tilted = position_bound_px(dot, camera(), np.array([6.0]), direction_rad=0.5 * np.pi)[0]
    assert tilted == pytest.approx(along[2], rel=0.02)

"""Films drawn without noise: tracked where their edges have gray levels, else refused with what to draw or record."""

import cv2
import numpy as np
import pytest
from kit import films as media
from kit.identified import quick

from modal_id import IdentifySettings, identify
from tracker import TrackerSettings, displacement_series, track

FPS, HZ, ZETA = 200.0, 10.0, 0.004
COLUMNS_PX, SHAPE, ROW_PX, RADIUS_PX = (60, 160, 250), (0.1, 0.5, 1.0), 60.0, 8
# OpenCV takes coordinates in whole sixteenths of a px with this shift.
SHIFT = 4


def film(folder, amplitude_px, *, background, smooth, frames=600):
    """Dark discs that vibrate at HZ, their edges with gray levels where `smooth`; a lossless file."""
    t = np.arange(frames) / FPS
    motion = amplitude_px * np.exp(-ZETA * 2.0 * np.pi * HZ * t) * np.cos(2.0 * np.pi * HZ * t)
    images = np.full((frames, 120, 310), background, np.uint8)
    line, one = (cv2.LINE_AA if smooth else cv2.LINE_8), 1 << SHIFT
    for image, u in zip(images, motion, strict=True):
        for column, share in zip(COLUMNS_PX, SHAPE, strict=True):
            centre = (column * one, round((ROW_PX + share * u) * one))
            cv2.circle(image, centre, RADIUS_PX * one, 20, -1, line, SHIFT)
    path = folder / "drawn.mkv"
    media.write(path, images, codec="ffv1")
    return track(path, TrackerSettings(kind="blob", fps=FPS, exposure_s=1e-5))


@pytest.mark.parametrize("background", [pytest.param(200, marks=pytest.mark.slow), 255])
def test_smooth_edges_are_tracked_to_a_sixteenth_of_a_px(tmp_path, background):
    """Rounding to 1/16 px has an sd of 0.018 px; it makes steps of the amplitude, which are small beside 4 px."""
    series = displacement_series(film(tmp_path, 4.0, background=background, smooth=True))
    found = quick(series)
    assert found, found
    assert found.target.frequency_hz == pytest.approx(HZ, abs=4.0 * found.target.frequency_sd_hz)
    assert found.target.damping_ratio == pytest.approx(ZETA, abs=4.0 * found.target.damping_ratio_sd)
    assert found.target.damping_ratio_sd < 0.05 * ZETA


def test_discs_at_whole_pixels_on_white_are_refused_with_the_cause(tmp_path):
    tracks = film(tmp_path, 6.0, background=255, smooth=False, frames=80)
    assert not tracks
    assert "pixels around them are at the white level, 255" in tracks.reason
    assert "use a darker white or edges with gray levels between" in tracks.reason


def test_a_drawn_film_without_motion_has_none(tmp_path):
    """Registration of equal images converges to within 1e-7 px: that is no vibration, however small the noise."""
    series = displacement_series(film(tmp_path, 0.0, background=200, smooth=True, frames=200))
    found = identify(series, IdentifySettings())
    assert not found
    words = "no channel has a usable signal: Channels m1, m2, m3 were left out: no motion"
    assert found.reason.startswith(words)

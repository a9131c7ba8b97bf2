"""Regions in which no markers are sought: how they are filled, and what is still found."""

import numpy as np
import pytest
from kit.scenes import FPS, Recording

from tracker import MarkerTracks, TrackerSettings, track
from tracker.markers import SimilarMarkerDetector, detect_markers, filled, leaving_out, marker_kind

POSITIONS = ((30.0, 50.0), (80.0, 52.0), (130.0, 49.0))


def row(kind, **options):
    recording = Recording(kind, markers=3, width_px=180, height_px=100, frames=20, **options)
    recording.x0, recording.y0 = np.array(POSITIONS).T
    return recording


def around(x, y, half=16.0):
    return ((x - half, y + half), (x + half, y - half))


def test_a_plane_of_gray_levels_is_continued_exactly():
    """Linear interpolation reproduces a linear function; rounding leaves half a gray level."""
    y, x = np.mgrid[:60, :90]
    plane = (20 + 1.5 * x + 0.7 * y).astype(np.uint8)
    damaged = plane.copy()
    damaged[20:31, 40:71] = 255
    found = filled(damaged, [((70, 30), (40, 20))])
    assert found.dtype == plane.dtype
    assert np.abs(found.astype(int) - plane).max() <= 1
    assert np.array_equal(damaged[20:31, 40:71], np.full((11, 31), 255)), "the image itself is not changed"


@pytest.mark.parametrize(
    "region", [((0, 0), (10, 10)), ((-9, 50), (200, 70)), ((80, 10), (300, 20)), ((-5, -5), (500, 500))]
)
def test_regions_at_the_border_take_what_is_beside_them(region):
    image = np.full((60, 90), 90, np.uint16)
    assert np.array_equal(filled(image, [region]), image)


@pytest.mark.parametrize("kind", ["blob", "aruco"])
def test_a_marker_in_a_region_is_not_found_and_the_others_are_where_they_were(kind):
    images = row(kind).images()
    settings = TrackerSettings(fps=FPS, kind=kind, dictionary="DICT_4X4_50")
    _, everything = detect_markers(images, settings, kind)
    _, rest = detect_markers(
        images, settings.model_copy(update={"leave_out_px": (around(*POSITIONS[1]),)}), kind
    )
    assert len(everything.detections) == 3
    kept = [(d.x_px, d.y_px) for d in rest.detections]
    # The level between dark and light differs a little without the marker; detection is accurate to a pixel.
    assert kept == [
        pytest.approx((d.x_px, d.y_px), abs=0.1)
        for d in everything.detections
        if abs(d.x_px - POSITIONS[1][0]) > 20.0
    ]


def test_a_left_out_marker_is_not_taken_for_a_lost_one():
    """Neither the candidates for lost dots nor the reading of lost codes look into the region."""
    images = row("blob").images()
    region = around(*POSITIONS[1])
    dots = leaving_out(marker_kind("blob").detector(TrackerSettings(fps=FPS), auto=False), (region,))
    assert isinstance(dots, SimilarMarkerDetector)
    sought = dots.detect(images).detections
    beside = tuple(d.at(np.array(POSITIONS[1])) for d in sought[:1])
    seen = dots.candidates(images[5], (*sought, *beside)).centres_px
    assert all(np.hypot(*(centre - POSITIONS[1])) > 16.0 for centre in seen)
    codes = row("aruco").images()
    printed = TrackerSettings(fps=FPS, kind="aruco", dictionary="DICT_4X4_50")
    plain = marker_kind("aruco").detector(printed, auto=False)
    three = plain.detect(codes).detections
    assert len(plain.redetect(codes[5], three)) == 3
    assert len(leaving_out(plain, (region,)).redetect(codes[5], three)) == 2


def test_the_track_has_the_other_markers(tmp_path):
    path = row("aruco").write(tmp_path / "row.mkv")
    region = [list(corner) for corner in around(*POSITIONS[0])]
    tracks = track(
        path, TrackerSettings(fps=FPS, leave_out_px=[region], dictionary="DICT_4X4_50", exposure_s=1e-5)
    )
    assert isinstance(tracks, MarkerTracks)
    assert len(tracks.markers) == 2
    assert np.nanmin(tracks.x_px) > 60.0


def test_a_region_outside_the_picture_is_a_mistake():
    settings = TrackerSettings(fps=FPS, kind="blob", leave_out_px=[[[500, 10], [600, 20]]])
    refused = detect_markers(row("blob").images(), settings, "blob")
    assert "lies outside the image of 180 x 100 px" in refused.reason

"""Marker detectors: detections, their order and names, and the reasons of failures."""

from fractions import Fraction

import cv2
import numpy as np
import pytest
from kit.scenes import FPS, Recording

from tracker import TrackerSettings, track
from tracker.markers import (
    DOT,
    ArucoDetector,
    DotDetector,
    FoundMarkers,
    PatchDetector,
    Spot,
    aruco,
    detect_markers,
    dictionary_of,
    dots,
    find_spots,
    likeness,
    opencv_detector,
    order_along_beam,
    read_codes,
)
from tracker.template import disc_values, from_values, grid_px, template

COLUMN = {"width_px": 120, "height_px": 480, "frames": 3}


def column(kind="blob", y=(40.0, 120.0, 200.0, 280.0, 360.0), **options):
    """Markers one above the other, as on a hanging beam."""
    recording = Recording(kind, markers=len(y), **COLUMN, **options)
    recording.x0 = np.full(len(y), 60.3)
    recording.y0 = np.array(y)
    return recording


def blobs(frames, positions_mm=None, side=None):
    return DotDetector(positions_mm, side).detect(frames)


@pytest.mark.parametrize("size", [5.5, 9.0, 20.0, 40.0])
def test_dots_of_all_sizes_in_order_from_the_top(size):
    recording = column(size_px=size)
    found = blobs(recording.images())
    truth = recording.truth_px()[0]
    assert [s.name for s in found.detections] == ["m1", "m2", "m3", "m4", "m5"]
    for detection, (x, y) in zip(found.detections, truth, strict=True):
        assert np.hypot(detection.x_px - x, detection.y_px - y) < 0.5
        assert detection.size_px == pytest.approx(size, rel=0.05, abs=1.5)


def test_light_dots_on_dark():
    images = [255 - image for image in column().images()]
    assert len(blobs(images).detections) == 5


def test_positions_are_assigned_from_the_clamp_side():
    images = column().images()
    positions = (10.0, 110.0, 210.0, 310.0, 410.0)
    top = blobs(images, positions)
    assert [s.position_mm for s in top.detections] == list(positions)
    assert top.detections[0].y_px < top.detections[-1].y_px
    assert any("top" in note for note in top.notes)
    bottom = blobs(images, positions, "bottom")
    assert bottom.detections[0].y_px > bottom.detections[-1].y_px


def test_the_clamp_side_is_found_from_uneven_spacing():
    recording = column(y=(40.0, 80.0, 160.0, 280.0, 440.0))
    images = recording.images()
    down = blobs(images, (0.0, 40.0, 120.0, 240.0, 400.0))
    assert down.detections[0].y_px < 60
    up = blobs(images, (0.0, 160.0, 280.0, 360.0, 400.0))
    assert up.detections[0].y_px > 400
    assert any("opposite" in note for note in up.notes)


def test_a_false_dot_is_excluded_by_the_spacing():
    images = [image.copy() for image in column().images()]
    y, x = np.indices(images[0].shape)
    for image in images:
        image[np.hypot(x - 100, y - 230) < 6] = 30
    found = blobs(images, (0.0, 80.0, 160.0, 240.0, 320.0))
    assert isinstance(found, FoundMarkers)
    assert max(abs(s.x_px - 60.3) for s in found.detections) < 5


def with_still_dots(recording, positions_px):
    """Images of the recording with stationary dots of the markers' size added."""
    images = [image.copy() for image in recording.images()]
    y, x = np.indices(images[0].shape)
    for image in images:
        for centre in positions_px:
            image[np.hypot(x - centre[0], y - centre[1]) < 6] = 30
    return images


@pytest.mark.parametrize("positions_mm", [None, (0.0, 80.0)])
def test_stationary_dots_off_the_beam_are_background(positions_mm):
    y = (40.0, 120.0, 200.0, 280.0, 360.0) if positions_mm is None else (40.0, 120.0)
    recording = column(y=y)
    recording.time_s = np.arange(40) / 1000
    images = with_still_dots(recording, [(100.0, 230.0), (20.0, 420.0)])
    found = blobs(images, positions_mm)
    assert len(found.detections) == len(y)
    assert max(abs(s.x_px - 60.3) for s in found.detections) < 5
    assert "2 other round spots stand still beside the moving ones" in found.notes[0]
    kept = DotDetector(None, None, keep_still=True).detect(images)
    assert len(kept.detections) == len(y) + 2


def test_a_stationary_dot_at_the_clamped_end_is_kept():
    recording = column(y=(120.0, 200.0, 280.0, 360.0))
    recording.time_s = np.arange(40) / 1000
    assert len(blobs(with_still_dots(recording, [(60.0, 30.0)])).detections) == 5


def noisy(image):
    values = image + np.random.default_rng(5).normal(0.0, 1.5, image.shape)
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def disc(image, x, y, diameter, level):
    v, u = np.indices(image.shape)
    cover = np.clip(0.5 * diameter - np.hypot(u - x, v - y) + 0.5, 0.0, 1.0)
    return image + cover * (level - image)


def test_a_ball_is_detected_instead_of_the_reflection_on_it():
    ball = disc(np.full((300, 300), 220.0), 150.3, 140.7, 130.0, 40.0)
    reflecting = disc(ball, 165.0, 120.0, 30.0, 230.0)
    (found,) = find_spots(noisy(reflecting))
    assert not found.light
    assert (found.x_px, found.y_px) == pytest.approx((150.3, 140.7), abs=0.3)


def test_dots_on_a_plate_and_on_a_round_background_are_detected():
    plate = disc(np.full((300, 300), 60.0), 150.0, 150.0, 220.0, 220.0)
    two = disc(disc(plate, 110.0, 150.0, 20.0, 30.0), 190.0, 150.0, 20.0, 30.0)
    assert [s.diameter_px for s in find_spots(noisy(two))] == pytest.approx([20.0, 20.0], abs=1.0)
    sticker = disc(disc(np.full((300, 300), 60.0), 150.0, 150.0, 110.0, 220.0), 150.4, 149.8, 30.0, 30.0)
    assert min(s.diameter_px for s in find_spots(noisy(sticker))) == pytest.approx(30.0, abs=1.0)


def test_without_motion_no_dot_is_background():
    recording = column(amplitude_px=0.0, rotation_rad=0.0)
    recording.time_s = np.arange(20) / 1000
    assert len(blobs(with_still_dots(recording, [(100.0, 230.0)])).detections) == 6


def test_failures_contain_the_positions_of_candidates(tmp_path):
    path = column().write(tmp_path / "a.mkv")
    failed = track(
        path, TrackerSettings(fps=FPS, kind="blob", positions_mm=(0.0, 55.0, 300.0)), recording="a"
    )
    assert not failed
    assert failed.seen_px == pytest.approx(column().truth_px()[0], abs=0.6)
    # One frame: all dictionaries are searched in each.
    codes = column("aruco", y=(60.0, 200.0), dictionary="DICT_5X5_100", size_px=28.0)
    codes.time_s = codes.time_s[:1]
    wrong = codes.write(tmp_path / "b.mkv")
    named = track(wrong, TrackerSettings(fps=FPS, kind="aruco", dictionary="DICT_4X4_50"), recording="b")
    assert "DICT_5X5_50" in named.reason
    assert named.seen_px == pytest.approx(np.array([[60.3, 60.0], [60.3, 200.0]]), abs=1.5)


def test_a_wrong_count_lists_the_detected_dots():
    failed = blobs(column().images(), (0.0, 55.0, 100.0, 300.0))
    assert not failed
    assert "4 dots" in failed.reason
    assert "5 similar ones were detected" in failed.reason
    assert "at x, y = (60, 39), (6" in failed.reason


def test_aruco_ids_and_positions_in_order_of_id():
    found = ArucoDetector("DICT_4X4_50", (1.0, 2.0, 3.0)).detect(
        column("aruco", y=(60.0, 200.0, 340.0)).images()
    )
    assert [s.name for s in found.detections] == ["id0", "id1", "id2"]
    assert [s.position_mm for s in found.detections] == [1.0, 2.0, 3.0]


def test_a_wrong_dictionary_gives_a_suggestion():
    images = column("aruco", y=(60.0, 200.0, 340.0), dictionary="DICT_5X5_100", size_px=28.0).images()[:1]
    failed = ArucoDetector("DICT_4X4_50", None).detect(images)
    assert not failed
    assert "ids 0, 1, 2 of DICT_5X5_50" in failed.reason
    assert "did you mean" in failed.reason
    auto = ArucoDetector("auto", None).detect(images)
    assert [s.name for s in auto.detections] == ["id0", "id1", "id2"]


def test_a_wrong_number_of_positions_for_aruco_fails():
    failed = ArucoDetector("DICT_4X4_50", (1.0, 2.0)).detect(column("aruco", y=(60.0, 200.0, 340.0)).images())
    assert "names 2 markers, but 3 were detected" in failed.reason
    assert "0, 1, 2" in failed.reason


@pytest.mark.parametrize("kind", ["aruco", "blob"])
def test_markers_get_the_names_that_are_given(kind):
    """The first from the clamp, and of the codes the one with the lowest number, gets the first name."""
    images = column(kind, y=(60.0, 200.0, 340.0)).images()
    printed = {"clamp_side": "top", "dictionary": "DICT_4X4_50"}
    detector, named = detect_markers(
        images, TrackerSettings(names=("root", "middle", "tip"), **printed), kind
    )
    _, plain = detect_markers(images, TrackerSettings(**printed), kind)
    assert [d.name for d in named.detections] == ["root", "middle", "tip"]
    assert [(d.x_px, d.y_px) for d in named.detections] == [(d.x_px, d.y_px) for d in plain.detections]
    # A code is recognised by its number, whatever its name.
    again = detector.redetect(images[0], named.detections[1:])
    assert [d.name for d in again] == (["middle", "tip"] if kind == "aruco" else [])
    refused = detect_markers(images, TrackerSettings(names=("root", "tip"), **printed), kind)
    assert "names has 2 entries, but 3 markers were detected" in refused.reason


def test_patch_points_outside_or_without_texture_fail():
    images = column().images()
    assert "outside the image" in PatchDetector(((500.0, 10.0),), None, None).detect(images).reason
    flat = [np.full((100, 100), 90, np.uint8)]
    flat[0][0, 0] = 255
    assert "no texture" in PatchDetector(((50.0, 50.0),), None, None).detect(flat).reason


def test_order_along_a_horizontal_beam_starts_at_the_left():
    points = np.array([[300.0, 50.0], [100.0, 52.0], [200.0, 49.0]])
    beam = order_along_beam(points, None, None)
    assert beam.order.tolist() == [1, 2, 0]
    assert "left" in beam.notes[0]


@pytest.mark.parametrize("kind", ["aruco", "blob"])
def test_auto_selects_the_kind_that_is_present(kind, tmp_path):
    recording = column(kind, y=(60.0, 200.0, 340.0))
    # One frame: all dictionaries are searched in each.
    recording.time_s = recording.time_s[:1]
    path = recording.write(tmp_path / "a.mkv")
    tracks = track(path, TrackerSettings(fps=FPS), recording="a")
    assert tracks.markers == (("id0", "id1", "id2") if kind == "aruco" else ("m1", "m2", "m3"))


def test_a_hidden_marker_is_nan(tmp_path):
    recording = Recording("blob", frames=60, markers=2, width_px=200, height_px=120, amplitude_px=2.0)
    images = recording.images()
    for image in images[30:40]:
        image[:, :100] = 200
    # FFV1 is lossless.
    from kit import films as media

    path = media.write(tmp_path / "a.mkv", images, codec="ffv1")
    tracks = track(path, TrackerSettings(fps=Fraction(1000), kind="blob"), recording="a")
    hidden = np.isnan(tracks.x_px[:, 0])
    assert np.flatnonzero(hidden).tolist() == list(range(30, 40))
    assert np.all(np.isfinite(tracks.x_px[:, 1]))
    truth = recording.truth_px()[:, 0, 0]
    assert np.nanmax(np.abs(tracks.x_px[:, 0] - truth)) < 0.2


# A quarter of the pixels of the default scene: codes of every dictionary are searched for in all of them.
SMALL = {"width_px": 320, "height_px": 240}


def with_code(image, centre, side_px=28):
    """The image with an ArUco marker (DICT_4X4_50, id 7) of this size within a white rim of 5 px."""
    drawn = cv2.aruco.generateImageMarker(
        cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50), 7, side_px
    )
    half, out = side_px // 2, image.copy()
    rows, columns = (
        slice(centre[1] - half - 5, centre[1] + half + 5),
        slice(centre[0] - half - 5, centre[0] + half + 5),
    )
    out[rows, columns] = 210
    out[rows.start + 5 : rows.stop - 5, columns.start + 5 : columns.stop - 5] = 25 + 0.7 * drawn
    return out


@pytest.fixture
def own_family(monkeypatch):
    """Codes of the markers' own family only; all families are read in the tests of single frames above."""
    own = tuple(family for family in aruco.FAMILIES if "DICT_4X4_50" in family)
    monkeypatch.setattr(aruco, "FAMILIES", own)


@pytest.mark.usefixtures("own_family")
def test_auto_does_not_take_a_code_of_a_single_frame_among_dots_for_a_marker():
    recording = Recording("blob", markers=10, frames=21, **SMALL)
    images = recording.images()
    images[0] = with_code(images[0], (160, 120))
    detector, found = detect_markers(images, TrackerSettings())
    assert isinstance(detector, DotDetector)
    assert len(found.detections) == 10
    assert any("id 7 of DICT_4X4_50" in note and "too few frames" in note for note in found.notes)
    # Shown in all frames it is a marker, and auto prefers it to dots.
    shown = [with_code(image, (160, 120)) for image in images]
    assert [d.name for d in detect_markers(shown, TrackerSettings())[1].detections] == ["id7"]


@pytest.mark.usefixtures("own_family")
def test_a_code_of_a_single_frame_beside_markers_is_noted_once():
    recording = Recording("aruco", markers=4, frames=21, width_px=240, height_px=140)
    images = recording.images()
    y, x = images[0].shape
    images[0] = with_code(images[0], (x // 2, y // 5))
    detector, found = detect_markers(images, TrackerSettings())
    assert isinstance(detector, ArucoDetector)
    assert "id7" not in [d.name for d in found.detections]
    noted = [note for note in found.notes if "id 7 of" in note]
    assert len(noted) == 1, f"one reason for the rejected code, not {noted}"
    assert "read in too few frames" in noted[0]


@pytest.mark.parametrize("all_families", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_texture_with_the_bits_of_a_code_is_not_a_marker_for_auto(all_families, request):
    """Bricks, shadows: each cell has the right brightness in its middle, but no cell looks like print."""
    if not all_families:
        request.getfixturevalue("own_family")
    rng = np.random.default_rng(4)
    images = []
    for image in Recording("blob", markers=10, frames=8, **SMALL).images():
        false = with_code(image, (160, 120), side_px=48).astype(float)
        # Bright and dark stains of a third of the contrast everywhere but in the middle of the cells.
        part = false[96:144, 136:184]
        middle = (np.abs(np.arange(48) % 8 - 3.5) < 1.6)[:, None] & (np.abs(np.arange(48) % 8 - 3.5) < 1.6)[
            None, :
        ]
        part[~middle] = np.where(
            rng.random(np.count_nonzero(~middle)) < 0.35, 235.0 - part[~middle], part[~middle]
        )
        images.append(false.clip(0, 255).astype(np.uint8))
    detector, found = detect_markers(images, TrackerSettings())
    assert isinstance(detector, DotDetector)
    assert len(found.detections) == 10
    assert any("does not look like its print" in note for note in found.notes), "the code is not read at all"


@pytest.mark.parametrize("size", [12.0, 18.0, 24.0])
def test_true_codes_look_like_their_print_even_when_small(size):
    images = Recording("aruco", size_px=size, markers=6, frames=2, read_noise=3.0).images()
    detector = opencv_detector(dictionary_of("DICT_4X4_50"), strict=True)
    found = [
        likeness(images[0], code, detector.getDictionary())
        for code in read_codes(images[0], detector, upscaling=2)
    ]
    assert len(found) >= 5
    assert min(found) > aruco.TUNING.least_likeness


@pytest.mark.parametrize("diameter", [90.0, pytest.param(180.0, marks=pytest.mark.slow)])
def test_dots_of_up_to_200_px_are_detected(diameter):
    image = np.full((260, 700), 220.0)
    for x in (130.4, 440.7):
        image = disc(image, x, 130.2, diameter, 40.0)
    found = blobs([noisy(image)])
    assert [d.size_px for d in found.detections] == pytest.approx([diameter] * 2, abs=1.5)
    assert [d.x_px for d in found.detections] == pytest.approx([130.4, 440.7], abs=0.3)


def test_the_ideal_image_of_a_large_dot_is_fitted_to_its_pixels():
    image = noisy(disc(np.full((220, 220), 220.0), 110.37, 108.81, 160.0, 40.0))
    (detection,) = blobs([image]).detections
    y, x = np.indices(image.shape)
    points = np.stack([x.ravel() - detection.x_px, y.ravel() - detection.y_px])
    near = np.hypot(*points) < 95.0
    fit = DOT.fit_pixels(detection, points[:, near], image.ravel()[near].astype(float))
    centre = np.array([detection.x_px, detection.y_px]) + fit.centre_uv
    # About 70 of 4000 points lie on the edge: 1.5 gray levels of noise on a step of 180 determine it to 0.01 px.
    assert centre == pytest.approx([110.37, 108.81], abs=0.01)
    assert fit.size_px == pytest.approx(160.0, abs=0.05)
    assert fit.matrix == pytest.approx(np.eye(2), abs=5e-4)
    assert (fit.dark, fit.light) == pytest.approx((220.0, 40.0), abs=0.5)


def test_a_disc_fitted_to_what_is_no_dot_stays_small(monkeypatch):
    """The time of a disc grows with the cube of its radius, and an edge fits a disc of any size."""
    radii = []

    def recorded(u, v, radius, blur):
        radii.append(abs(float(radius)))
        return disc_values(u, v, radius, blur)

    monkeypatch.setattr(dots, "disc_values", recorded)
    size = 12.0
    u, v = grid_px(9.0, 9.0, template.TUNING.printed_oversampling)
    edge = 40.0 + 160.0 * np.clip(0.5 + u[None, :] + 0.02 * v[:, None] ** 2, 0.0, 1.0)
    learned = from_values(edge, np.ones(edge.shape, np.uint8), template.TUNING.printed_oversampling)
    detection = dots._detection("m1", 0, Spot(50.0, 50.0, size, light=False, levels=3), float("nan"))
    assert DOT.fit_learned(detection, learned) is None
    assert max(radii) <= dots.TUNING.beyond * size

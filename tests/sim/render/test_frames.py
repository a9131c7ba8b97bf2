"""Rendered frames, compared with independent calculations of the same image and with the specified noise."""

import cv2
import numpy as np
import pytest
from support.render_truth import centroid, convex_pixel, disc_pixel, rectangle_corners, still

from sim.render import (
    ArucoMarker,
    Camera,
    DotMarker,
    Poses,
    Scene,
    Strip,
    aruco_cells,
    render_frames,
    render_ideal,
    true_centres_px,
)

# 0.001 counts of 8 bit: half from the quadrature, the rest from the marker's lookup table.
GRAY_TOLERANCE = 1.0e-3


def camera(**changes):
    settings = {"width_px": 37, "height_px": 43, "mm_per_px": 0.8, "origin_px": (15.0, 20.0)}
    return Camera(**(settings | changes))


def single(marker, x_mm=0.0, y_mm=0.0, angle_rad=0.0):
    return Scene(markers=(marker,), motion=still(x_mm, y_mm, angle_rad))


def ideal(scene, cam, time_s=0.0):
    return next(render_ideal(scene, cam, np.array([time_s])))


@pytest.mark.parametrize("sigma", [0.2, 0.6, 1.3])
def test_dot_agrees_with_an_integral_over_the_disc(sigma):
    rng = np.random.default_rng(1)
    cam = camera(lens_blur_px=sigma)
    x_mm, y_mm = rng.uniform(-1, 1, 2)
    image = ideal(single(DotMarker(diameter_mm=9.0, foreground=20.0), x_mm, y_mm), cam)
    x, y = cam.to_px(x_mm, y_mm)
    rows, columns = np.nonzero(np.abs(image - 200.0) > 0.01)
    for k in rng.choice(rows.size, 60, replace=False):
        row, column = rows[k], columns[k]
        truth = 200.0 - 180.0 * disc_pixel(column, row, x, y, 4.5 / 0.8, sigma)
        assert abs(image[row, column] - truth) < GRAY_TOLERANCE, (row, column, image[row, column] - truth)


@pytest.mark.parametrize(("sigma", "angle"), [(0.25, 0.4), (0.6, -0.05), (1.0, 1.1)])
def test_rotated_aruco_agrees_with_an_integral_over_its_cells(sigma, angle):
    rng = np.random.default_rng(2)
    cam = camera(lens_blur_px=sigma, background=120.0)
    marker = ArucoMarker(dictionary="DICT_4X4_50", marker_id=7, size_mm=12.0, quiet_zone_mm=2.0)
    image = ideal(single(marker, 0.33, -0.71, angle), cam)
    x, y = cam.to_px(0.33, -0.71)
    cells = aruco_cells("DICT_4X4_50", 7)
    side = 12.0 / 0.8 / 6
    card = rectangle_corners(x, y, 8.0 / 0.8, 8.0 / 0.8, angle)
    for _ in range(20):
        column, row = (rng.integers(np.ceil(v) - 11, np.floor(v) + 11) for v in (x, y))
        truth = 120.0 + 80.0 * convex_pixel(column, row, card, sigma)
        for i, j in np.argwhere(~cells):
            u, v = (j - 2.5) * side, (2.5 - i) * side
            cx = x + u * np.cos(angle) - v * np.sin(angle)
            cy = y - (u * np.sin(angle) + v * np.cos(angle))
            if np.hypot(cx - column, cy - row) < side + 1 + 8 * sigma:
                corners = rectangle_corners(cx, cy, side / 2, side / 2, angle)
                truth -= 170.0 * convex_pixel(column, row, corners, sigma)
        assert abs(image[row, column] - truth) < GRAY_TOLERANCE, (row, column, image[row, column] - truth)


def test_strip_agrees_with_an_integral_and_is_covered_by_the_card():
    cam = camera(lens_blur_px=0.5)
    strip = Strip(width_mm=0.5, gray=50.0, motion=still([-3.0, 3.0], [9.0, -12.0], [0.0, 0.0]))
    image = ideal(Scene(markers=(), motion=still([], [], []), strip=strip), cam)
    (x0, x1), (y0, y1) = cam.to_px(np.array([-3.0, 3.0]), np.array([9.0, -12.0]))
    angle = np.arctan2(y0 - y1, x1 - x0)
    corners = rectangle_corners(
        (x0 + x1) / 2, (y0 + y1) / 2, np.hypot(x1 - x0, y1 - y0) / 2, 0.25 / 0.8, angle
    )
    rows, columns = np.nonzero(image < 199.9)
    for k in np.random.default_rng(3).choice(rows.size, 50, replace=False):
        truth = 200.0 - 150.0 * convex_pixel(columns[k], rows[k], corners, 0.5)
        assert abs(image[rows[k], columns[k]] - truth) < GRAY_TOLERANCE
    dot = DotMarker(diameter_mm=6.0, foreground=30.0, background=180.0, quiet_zone_mm=2.0)
    with_strip = ideal(Scene(markers=(dot,), motion=still(0.0, -1.5, 0.0), strip=strip), cam)
    alone = ideal(single(dot, 0.0, -1.5), cam)
    x, y = cam.to_px(0.0, -1.5)
    rows, columns = np.indices(image.shape)
    inside = np.hypot(columns - x, rows - y) < 5.0 / 0.8 - 5.0 * 0.5
    assert np.max(np.abs(with_strip - alone)[inside]) < GRAY_TOLERANCE
    assert np.max(np.abs(with_strip - alone)) > 30.0


def test_strip_is_visible_between_two_cards_that_cover_parts_of_one_segment():
    cam = camera(lens_blur_px=0.5, width_px=30, height_px=60, origin_px=(15.0, 5.0))
    strip = Strip(width_mm=0.5, gray=50.0, motion=still([0.0, 0.0], [0.0, -40.0], [0.0, 0.0]))
    # The cards have the gray level of the background: only the strip between them is visible.
    dot = DotMarker(diameter_mm=4.0, foreground=200.0)
    positions = still([0.0, 0.0], [-20.0, -8.0], [0.0, 0.0])
    image = ideal(Scene(markers=(dot, dot), motion=positions, strip=strip), cam)
    visible = []
    for top_mm, end_mm in [(0.0, -6.0), (-10.0, -18.0), (-22.0, -40.0)]:
        _, (y0, y1) = cam.to_px(np.zeros(2), np.array([top_mm, end_mm]))
        visible.append(rectangle_corners(15.0, 0.5 * (y0 + y1), 0.25 / 0.8, 0.5 * (y1 - y0), 0.0))
    # Along the centre and next to it, where a missing or duplicated part would change tens of counts.
    for row, column in [*((row, 15) for row in range(60)), *((row, 16) for row in range(0, 60, 7))]:
        truth = 200.0 - 150.0 * sum(convex_pixel(column, row, corners, 0.5) for corners in visible)
        assert abs(image[row, column] - truth) < GRAY_TOLERANCE, (row, column)


@pytest.mark.parametrize("card", [None, 230.0])
def test_centroid_of_a_noise_free_dot_is_the_true_centre(card):
    rng = np.random.default_rng(4)
    cam = camera(lens_blur_px=0.6)
    dot = DotMarker(diameter_mm=8.0, background=card, quiet_zone_mm=1.5)
    for x_mm, y_mm in rng.uniform(-2, 2, (20, 2)):
        scene = single(dot, x_mm, y_mm)
        truth = true_centres_px(scene, cam, np.zeros(1))[0, 0]
        found = centroid(ideal(scene, cam), cam.background)
        assert np.max(np.abs(found - truth)) < 1.0e-4, found - truth


def moving(x_of_t):
    def motion(time_s):
        x = x_of_t(time_s)[:, None]
        return Poses(x, 0.4 * x, 0.05 * x)

    return motion


@pytest.mark.parametrize("speed_mm_s", [30.0, 600.0, 6000.0])
def test_exposure_is_the_mean_over_many_instants(speed_mm_s):
    exposure = 1.0e-3
    scene = Scene(
        markers=(ArucoMarker(dictionary="DICT_4X4_50", marker_id=3, size_mm=12.0),),
        motion=moving(lambda t: speed_mm_s * t),
    )
    blurred = ideal(scene, camera(exposure_s=exposure))
    count = 1000
    instants = (np.arange(count) + 0.5) / count * exposure - exposure / 2
    mean = sum(render_ideal(scene, camera(), instants)) / count
    # The error of the midpoint rule over the path d is at most d^2 / (24 n^2) times the image curvature: below 1e-3.
    assert np.max(np.abs(blurred - mean)) < 2 * GRAY_TOLERANCE


def test_centroid_of_an_accelerated_dot_is_the_mean_over_the_exposure():
    exposure, acceleration = 2.0e-3, 4.0e6
    cam = camera(exposure_s=exposure)
    scene = Scene(markers=(DotMarker(diameter_mm=6.0),), motion=moving(lambda t: acceleration * t**2 / 2))
    found = centroid(ideal(scene, cam), cam.background)
    shift_px = acceleration * exposure**2 / 24 / cam.mm_per_px
    truth = true_centres_px(scene, cam, np.zeros(1))[0, 0] + shift_px * np.array([1.0, -0.4])
    assert shift_px > 0.5
    assert np.max(np.abs(found - truth)) < 2.0e-4


def test_wider_lens_blur_is_an_additional_convolution():
    dot = DotMarker(diameter_mm=7.0)
    sharp = ideal(single(dot, 0.3, 0.2), camera(lens_blur_px=0.9))
    wide = ideal(single(dot, 0.3, 0.2), camera(lens_blur_px=1.5))
    # Sampled at 1 px, an image blurred by 0.9 px is band-limited to exp(-pi^2 0.81 / 2) = 2 %, and the second Gaussian
    # attenuates the aliased part: discrete and continuous convolution agree to about 1e-4 of the contrast.
    offsets = np.arange(-9, 10)
    kernel = np.exp(-0.5 * offsets**2 / (1.5**2 - 0.9**2))
    kernel /= kernel.sum()
    further = cv2.sepFilter2D(sharp - 200.0, -1, kernel, kernel, borderType=cv2.BORDER_CONSTANT) + 200.0
    assert np.max(np.abs(further - wide)) < 2.0e-4 * 170.0


def test_aruco_marker_is_detected_at_the_given_angle():
    size, quiet, angle = 24.0, 4.0, 0.3
    cam = Camera(width_px=90, height_px=110, mm_per_px=0.5, origin_px=(40.2, 50.7))
    scene = single(
        ArucoMarker(dictionary="DICT_5X5_100", marker_id=42, size_mm=size, quiet_zone_mm=quiet),
        1.0,
        -2.0,
        angle,
    )
    frame = next(render_frames(scene, cam, np.zeros(1), np.random.default_rng(5)))
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100))
    corners, ids, _ = detector.detectMarkers(frame)
    assert ids.ravel().tolist() == [42]
    x, y = true_centres_px(scene, cam, np.zeros(1))[0, 0]
    truth = rectangle_corners(x, y, size, size, angle)
    # Unrefined corners of an undistorted marker are accurate to about half a pixel.
    assert np.max(np.abs(corners[0][0] - truth)) < 1.0


@pytest.mark.parametrize(("bits", "level"), [(8, 30.0), (8, 180.0), (12, 2500.0)])
def test_noise_has_the_stated_variance(bits, level):
    cam = camera(
        width_px=200, height_px=150, background=level, read_noise_sd=1.5, noise_gain=0.05, bit_depth=bits
    )
    scene = Scene(markers=(), motion=still([], [], []))
    frames = np.stack(list(render_frames(scene, cam, np.zeros(8), np.random.default_rng(6))))
    assert frames.dtype == (np.uint8 if bits == 8 else np.uint16)
    variance = 1.5**2 + 0.05 * level + 1.0 / 12.0  # rounding adds 1/12
    n = frames.size
    assert abs(frames.mean() - level) < 5.0 * np.sqrt(variance / n)
    assert abs(frames.var() / variance - 1.0) < 5.0 * np.sqrt(2.0 / n)
    residual = frames - frames.mean()
    neighbours = np.mean(residual[:, :, 1:] * residual[:, :, :-1]) / frames.var()
    assert abs(neighbours) < 5.0 / np.sqrt(n)


def test_flicker_scales_frames_with_the_given_sd():
    cam = camera(flicker_sd=0.02, background=100.0)
    scene = Scene(markers=(), motion=still([], [], []))
    n = 400
    means = np.array([f.mean() for f in render_frames(scene, cam, np.zeros(n), np.random.default_rng(7))])
    assert abs(means.std() / 2.0 - 1.0) < 5.0 / np.sqrt(2 * n)


def test_uneven_illumination_follows_the_model():
    cam = camera(background=100.0, light_gradient=(0.6, -0.2), vignetting=0.3)
    frame = next(render_ideal(Scene(markers=(), motion=still([], [], [])), cam, np.zeros(1)))
    h, w = frame.shape
    x, y = (0 - (w - 1) / 2) / w, (0 - (h - 1) / 2) / h
    attenuation = 0.3 * ((w - 1) ** 2 + (h - 1) ** 2) / (w**2 + h**2)
    assert frame[0, 0] == pytest.approx(100.0 * (1 + 0.6 * x - 0.2 * y) * (1 - attenuation), rel=1e-12)
    # Opposite pixels have equal vignetting and opposite gradients.
    even = 0.5 * (frame + frame[::-1, ::-1])
    assert even.max() <= 100.0
    assert np.all(np.diff((frame / even)[h // 2]) > 0)


@pytest.mark.parametrize("wrong", [{"vignetting": 1.0}, {"vignetting": -0.1}, {"light_gradient": (1.5, 0.6)}])
def test_invalid_illumination_is_refused(wrong):
    with pytest.raises(ValueError, match=r"vignetting|light_gradient"):
        camera(**wrong)


def test_counts_are_rounded_and_clipped():
    cam = camera(background=254.0, read_noise_sd=20.0)
    scene = single(DotMarker(diameter_mm=9.0, foreground=2.0))
    frame = next(render_frames(scene, cam, np.zeros(1), np.random.default_rng(8)))
    assert frame.dtype == np.uint8
    assert frame.max() == 255
    assert frame.min() == 0
    assert np.mean(frame == 255) > 0.3


def test_same_seed_gives_same_frames_for_any_duration():
    cam = camera(read_noise_sd=1.0, noise_gain=0.03, exposure_s=5e-4, flicker_sd=0.01)
    scene = Scene(
        markers=(DotMarker(diameter_mm=6.0),), motion=moving(lambda t: 3.0 * np.sin(2 * np.pi * 40 * t))
    )
    times = np.arange(150) / 500.0
    long = list(render_frames(scene, cam, times, np.random.default_rng(9)))
    short = list(render_frames(scene, cam, times[:70], np.random.default_rng(9)))
    assert all(np.array_equal(a, b) for a, b in zip(short, long[:70], strict=True))
    other = list(render_frames(scene, cam, times[:1], np.random.default_rng(10)))
    assert not np.array_equal(other[0], long[0])


def test_marker_is_clipped_at_the_frame_border():
    dot = DotMarker(diameter_mm=9.0)
    large = camera(width_px=137, height_px=143, origin_px=(65.0, 70.0))
    full = ideal(single(dot, -13.0, 14.0), large)
    clipped = ideal(single(dot, -13.0, 14.0), camera())
    assert np.array_equal(clipped, full[50:93, 50:87])
    assert np.all(ideal(single(dot, 1000.0, 0.0), camera()) == 200.0)


def test_invalid_scenes_are_refused():
    dot = DotMarker(diameter_mm=6.0)
    with pytest.raises(ValueError, match="markers 0 and 1 overlap"):
        ideal(Scene(markers=(dot, dot), motion=still([0.0, 3.0], [0.0, 0.0], [0.0, 0.0])), camera())
    with pytest.raises(ValueError, match="2 markers, but its motion 1"):
        ideal(Scene(markers=(dot, dot), motion=still(0.0, 0.0, 0.0)), camera())
    with pytest.raises(ValueError, match="not finite"):
        ideal(single(dot, np.nan), camera())
    with pytest.raises(ValueError, match="shorten the exposure"):
        ideal(Scene(markers=(dot,), motion=moving(lambda t: 1e6 * t)), camera(exposure_s=1e-3))
    with pytest.raises(ValueError, match="DICT_4X4_50 has ids 0 to 49"):
        ArucoMarker(dictionary="DICT_4X4_50", marker_id=50, size_mm=10.0)
    with pytest.raises(ValueError, match="no predefined ArUco dictionary"):
        ArucoMarker(dictionary="DICT_4X4", marker_id=0, size_mm=10.0)
    with pytest.raises(ValueError, match="lens_blur_px must be finite and at least"):
        camera(lens_blur_px=0.0)

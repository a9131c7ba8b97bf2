"""Lens, oblique view and rolling shutter: against OpenCV, against warped views and against theory."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from kit.tracks import tracks_of

from tracker import Scale, TrackerSettings, displacement_series
from tracker.geometry import (
    Lens,
    plane_from_metrics,
    plane_from_points,
    plane_jacobian,
    resolve_scale,
    row_delay_s,
    to_common_time,
    to_plane,
    undistort,
    undistortion_jacobian,
)


def distort(lens, x_px, y_px):
    """Distorted position of an ideal one, by the model of Brown and Conrady."""
    (fx, fy), (cx, cy), (k1, k2, p1, p2, k3) = lens.focal_px, lens.centre_px, lens.distortion
    x, y = (x_px - cx) / fx, (y_px - cy) / fy
    r2 = x * x + y * y
    radial = 1.0 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    dx, dy = 2 * p1 * x * y + p2 * (r2 + 2 * x * x), p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return cx + fx * (radial * x + dx), cy + fy * (radial * y + dy)


LENS = Lens(640, 480, (700.0, 705.0), (318.0, 243.0), (-0.25, 0.08, 4e-4, -3e-4, 0.0))
GRID_PX = np.stack(np.meshgrid(np.linspace(0, 639, 9), np.linspace(0, 479, 7)), axis=-1).reshape(-1, 2)
# A camera with a focal length of 800 px, rotated by 30 degrees about the vertical and 10 about the horizontal.
ROTATION = (
    cv2.Rodrigues(np.array([0.0, np.radians(30), 0.0]))[0]
    @ cv2.Rodrigues(np.array([np.radians(10), 0, 0]))[0]
)


def oblique_px(points_mm):
    """Pixels of points in a plane (x right, y up) 900 mm from the camera."""
    space = np.column_stack([points_mm[:, 0], -points_mm[:, 1], np.zeros(len(points_mm))])
    ray = space @ ROTATION.T + np.array([5.0, -8.0, 900.0])
    return 800.0 * ray[:, :2] / ray[:, 2:] + np.array([320.0, 240.0])


def tracks(x_px, y_px, **more):
    return tracks_of(x_px, y_px, **({"scale": Scale(1.0, 0.01, "as given")} | more))


def test_undistortion_matches_opencv_and_inverts_the_distortion():
    camera = np.array([[700.0, 0, 318], [0, 705, 243], [0, 0, 1]])
    x, y = undistort(LENS, GRID_PX[:, 0], GRID_PX[:, 1])
    rays = np.column_stack([(x - 318) / 700, (y - 243) / 705, np.ones(len(x))])
    opencv = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), camera, np.array(LENS.distortion))[0][:, 0]
    assert opencv == pytest.approx(GRID_PX, abs=1e-6)
    assert np.stack(distort(LENS, x, y), axis=1) == pytest.approx(GRID_PX, abs=1e-6)
    assert np.max(np.hypot(x - GRID_PX[:, 0], y - GRID_PX[:, 1])) > 10.0


def test_the_jacobian_is_the_slope_and_missing_values_stay_nan():
    slope = undistortion_jacobian(LENS, GRID_PX[:, 0], GRID_PX[:, 1])
    step = np.array([0.5, -0.3])
    moved = np.array(undistort(LENS, *(GRID_PX + step).T)) - np.array(undistort(LENS, *GRID_PX.T))
    assert np.einsum("kij,j->ki", slope, step) == pytest.approx(moved.T, abs=2e-3)
    assert np.isnan(undistort(LENS, np.array([np.nan]), np.array([5.0]))).all()
    extreme = Lens(640, 480, (100.0, 100.0), (320.0, 240.0), (-2.0, 0.0, 0.0, 0.0, 0.0))
    assert np.isnan(undistort(extreme, np.array([2000.0]), np.array([2000.0]))).all()
    with pytest.raises(ValueError, match="five finite numbers"):
        Lens(640, 480, (1.0, 1.0), (0.0, 0.0), (0.1,))


def test_lens_distortion_is_removed_from_displacements():
    t = np.arange(400) / 1000
    true_x = np.array([60.0, 320.0, 600.0]) + 4.0 * np.sin(2 * np.pi * 20 * t)[:, None]
    true_y = np.broadcast_to([40.0, 240.0, 440.0], true_x.shape)
    x, y = distort(LENS, true_x, true_y)
    series = displacement_series(tracks(x, y, lens=LENS), direction=(1.0, 0.0))
    truth = true_x - np.median(true_x, axis=0)
    assert series.values == pytest.approx(truth, abs=1e-6)
    plain = displacement_series(tracks(x, y), direction=(1.0, 0.0))
    assert np.max(np.abs(plain.values - truth)) > 0.2
    assert series.notes == ()
    other = displacement_series(tracks(x, y, lens=replace(LENS, width_px=1280)), direction=(1.0, 0.0))
    assert "needs its own calibration" in other.notes[0]
    # The lens shrinks the corners: there a pixel and its sd are larger in mm.
    assert series.sd[0, 0] > 1.05 * series.sd[0, 1] > 0.0


@pytest.mark.parametrize("count", [4, 9])
def test_known_positions_rectify_an_oblique_view(count):
    grid = np.stack(np.meshgrid([-150.0, 20.0, 170.0], [-100.0, 10.0, 120.0]), axis=-1).reshape(-1, 2)
    positions = grid if count == 9 else grid[[0, 2, 6, 8]]
    rng = np.random.default_rng(1)
    noise_px = 0.02 if count == 9 else 0.0
    plane, rms_mm = plane_from_points(
        oblique_px(positions) + noise_px * rng.standard_normal(positions.shape), positions
    )
    found = np.stack(to_plane(plane, *oblique_px(grid).T), axis=1)
    # A pixel is about 1.2 mm: errors of 0.02 px are 0.024 mm; the limit is about three times that.
    assert found == pytest.approx(grid, abs=0.08 if noise_px else 1e-6)
    assert np.isnan(rms_mm) if count == 4 else 0.01 < rms_mm < 0.05
    slope = plane_jacobian(plane, np.array([300.0]), np.array([200.0]))[0]
    h = 0.01
    ahead = np.array(to_plane(plane, np.array([300.0 + h, 300.0]), np.array([200.0, 200.0 + h])))
    here = np.array(to_plane(plane, np.array([300.0]), np.array([200.0])))
    assert (ahead - here) / h == pytest.approx(slope, rel=1e-3)


def test_collinear_positions_give_no_plane():
    line = np.column_stack([np.zeros(6), np.linspace(0, 250, 6)])
    assert plane_from_points(oblique_px(line), line) is None
    assert plane_from_points(oblique_px(line[:3]), line[:3]) is None


def test_the_shapes_of_collinear_squares_rectify_the_view():
    positions = np.column_stack([np.zeros(6), np.linspace(-120, 130, 6)])
    pixels = oblique_px(positions)
    angles = np.radians([0, 20, -35, 5, 90, 12])
    jacobians = []
    for position, angle in zip(positions, angles, strict=True):
        h = 1e-3
        steps = [oblique_px(position[None] + h * e) - oblique_px(position[None] - h * e) for e in np.eye(2)]
        forward = np.stack([step[0] / (2 * h) for step in steps], axis=1)
        rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        jacobians.append(rotation @ np.linalg.inv(forward))
    plane, residual = plane_from_metrics(pixels, np.array(jacobians))
    assert np.abs(residual).max() < 1e-6
    # Displacements at each marker have their true length in every direction.
    for k, position in enumerate(positions):
        for step in ([0.5, 0.0], [0.0, 0.5], [0.4, -0.3]):
            both = oblique_px(np.array([position, position + step]))
            x, y = to_plane(plane, *both.T)
            assert np.hypot(*np.diff([x, y], axis=1).ravel()) == pytest.approx(0.5, rel=2e-3), k
    spans = np.hypot(*np.diff(np.array(to_plane(plane, *pixels.T)), axis=1))
    assert spans == pytest.approx(np.full(5, 50.0), rel=1e-4)


def test_plane_mm_gives_scale_and_plane():
    positions = ((-100.0, -80.0), (120.0, -70.0), (0.0, 0.0), (-90.0, 90.0), (110.0, 100.0))
    pixels = oblique_px(np.array(positions))
    found = resolve_scale(TrackerSettings(plane_mm=positions), [None] * 5, pixels, np.full(5, np.nan))
    assert found.plane is not None
    assert found.scale.mm_per_px == pytest.approx(1.22, abs=0.1)
    assert "rectified by the positions of 5 markers" in found.notes[0]
    few = resolve_scale(TrackerSettings(plane_mm=positions[:4]), [None] * 5, pixels, np.full(5, np.nan))
    assert few.plane is None
    assert "has 4 positions, but 5 markers" in few.notes[0]
    n = 50
    swing = 3.0 * np.sin(0.4 * np.arange(n))
    moving = np.array([oblique_px(np.array(positions) + np.array([s, 0.0])) for s in swing])
    series = displacement_series(
        tracks(moving[..., 0], moving[..., 1], plane=found.plane, scale=found.scale), direction=(1.0, 0.0)
    )
    assert series.unit == "mm"
    assert series.values == pytest.approx(np.tile((swing - np.median(swing))[:, None], 5), abs=1e-6)


def test_an_implausible_scale_gives_a_note():
    rest = np.array([[50.0, 0.0], [50.0, 400.0]])
    found = resolve_scale(TrackerSettings(mm_per_px=0.001), [None] * 2, rest, np.full(2, np.nan))
    assert "implausible for a beam" in found.notes[0]
    assert resolve_scale(TrackerSettings(mm_per_px=0.5), [None] * 2, rest, np.full(2, np.nan)).notes == ()


@pytest.mark.parametrize(("mm_per_px", "unit"), [(0.0005, "metres"), (500.0, "micrometres")])
def test_a_scale_in_another_unit_is_named(mm_per_px, unit):
    rest = np.array([[50.0, 0.0], [50.0, 400.0]])
    found = resolve_scale(TrackerSettings(mm_per_px=mm_per_px), [None] * 2, rest, np.array([0.0, 200.0]))
    assert f"If lengths as given are in {unit}, it is 0.5 mm/px." in found.notes[0]
    assert f"in {unit}, it is 0.5 mm/px" in found.notes[1]


def test_a_rolling_shutter_is_corrected():
    readout_s, f = 9e-4, 60.0
    t = np.arange(500) / 1000
    y = np.array([20.0, 240.0, 460.0])
    delay = row_delay_s(y, 480, readout_s)
    assert delay == pytest.approx(readout_s * (y - 239.5) / 479)
    delayed = 3.0 * np.sin(2 * np.pi * f * (t[:, None] + delay))
    rolling = tracks(300.0 + delayed, np.broadcast_to(y, delayed.shape), scale=None, readout_s=readout_s)
    series = displacement_series(rolling, direction=(1.0, 0.0))
    truth = 3.0 * np.sin(2 * np.pi * f * t)
    error = series.values[2:-2] - truth[2:-2, None]
    # The error of degree 4 is x^(5) h^5 prod|s - k| / 5!, with a product of at most 1.42 at s = 0.43: 9e-5 of
    # 3 px, doubled by the medians.
    assert np.max(np.abs(error)) < 3.0 * 2e-4
    plain = displacement_series(replace(rolling, readout_s=None), direction=(1.0, 0.0))
    assert np.max(np.abs(plain.values - truth[:, None])) > 0.4
    assert np.isnan(series.values[:2]).all()
    assert "Rows are read over 0.9 ms" in series.notes[0]


def test_the_sd_after_rolling_shutter_correction_matches_the_scatter():
    rng = np.random.default_rng(2)
    noise = rng.standard_normal((20_000, 2))
    time_s = np.arange(20_000) / 1000
    values, sd = to_common_time(time_s, noise, np.ones_like(noise), np.array([4e-4, -2e-4]))
    # The sd of the ratio is 1 / sqrt(2 n) = 0.5 %: four of these.
    assert np.nanstd(values, axis=0) == pytest.approx(sd[0], rel=0.02)


def test_rolling_shutter_correction_with_uneven_times_and_gaps():
    rng = np.random.default_rng(3)
    time_s = np.cumsum(rng.uniform(0.8e-3, 1.2e-3, 200))
    line = 5.0 * time_s[:, None] + np.zeros((1, 1))
    line[50] = np.nan
    values, _ = to_common_time(time_s, line, np.ones_like(line), np.array([3e-4]))
    assert np.flatnonzero(np.isnan(values[:, 0])).tolist() == [49, 50, 51]
    assert np.nanmax(np.abs(values - (line - 5.0 * 3e-4))) < 1e-12

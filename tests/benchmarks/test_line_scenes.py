"""Drawn lines against the definition of their drawing, computed at many points of each pixel."""

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import ndtr

from benchmarks.line_scenes import LineScene, mode_shape

SHAKEN = {"modes": (5,), "tip_px": (4.0,), "cycles_per_frame": (0.0913,)}
SCENE = LineScene(length_px=180.0, shape=(220, 76), clamp_px=(38.3, 16.6), **SHAKEN)


def test_pixels_are_the_area_under_the_profile_at_the_distance_from_the_curve():
    """The mean over 12 x 12 points of a pixel, each with its own distance from a curve of points at 0.002 px."""
    image, (s, points, angle) = SCENE.image(0.0), SCENE.curve(0.0)
    fine = np.arange(0.0, SCENE.length_px, 0.002)
    curve = np.stack([np.interp(fine, s, c) for c in points.T], axis=1)
    tree, direction = cKDTree(curve), np.interp(fine, s, angle)
    sub = (np.arange(12) + 0.5) / 12.0 - 0.5
    rows = np.arange(60, 150, 9)
    worst = 0.0
    for row in rows:
        middle = int(np.interp(row, points[:, 1], points[:, 0]))
        for column in range(middle - 5, middle + 7):
            at = np.stack(np.meshgrid(column + sub, row + sub), axis=-1).reshape(-1, 2)
            nearest = tree.query(at)[1]
            off = at - curve[nearest]
            v = np.cos(direction[nearest]) * off[:, 1] - np.sin(direction[nearest]) * off[:, 0]
            half = 0.5 * SCENE.width_px
            cover = np.mean(ndtr((v + half) / SCENE.blur_px) - ndtr((v - half) / SCENE.blur_px))
            worst = max(worst, abs(image[row, column] - SCENE.bright - cover * (SCENE.dark - SCENE.bright)))
    # The curve is a polyline of 0.5 px in both: a sagitta of 0.0005 px, of 85 gray levels per px.
    assert worst < 0.1, f"{worst:.3f} gray levels"


def test_material_points_move_across_by_the_mode_at_any_amplitude():
    scene = LineScene(length_px=180.0, modes=(2,), tip_px=(25.0,), cycles_per_frame=(0.05,), decay=0.01)
    arc = np.linspace(10.0, 170.0, 9)
    normal = np.array([-np.sin(scene.angle_rad), np.cos(scene.angle_rad)])
    shape = mode_shape(2, arc / scene.length_px)
    for time in (0.0, 7.0, 23.0):
        across = (scene.points(time, arc)[0] - scene.clamp_px) @ normal
        drawn = 25.0 * np.exp(-0.01 * time) * np.cos(2.0 * np.pi * 0.05 * time) * shape
        # Trapezoids of 0.5 px: (k h)^2 / 12 of the displacement, k of the mode being 0.026 per px.
        assert np.abs(across - drawn).max() < 25.0 * (0.026 * 0.5) ** 2 / 12.0 * 3.0

"""Stations of drawn strips and edges against the truth and the Cramer-Rao bound of the drawn pixels."""

from dataclasses import replace

import numpy as np
import pytest
from kit.lines import SMALL, followed

from benchmarks.line_scenes import LineScene, bound_px
from tracker.line import calibrate

FRAMES = 20
CASES = {
    "strip of 4 px": LineScene(**SMALL),
    "strip of 2 px, slanted, noise 8": LineScene(
        **SMALL | {"clamp_px": (12.3, 16.6)}, width_px=2.0, angle_rad=1.2, noise=8.0
    ),
    "edge": LineScene(**SMALL, feature="edge"),
    # Without a model of the background: 2.5 times the bound.
    "background texture": LineScene(**SMALL, texture=6.0),
}


@pytest.mark.parametrize("name", CASES)
def test_errors_are_at_the_bound_and_as_stated(name):
    scene = CASES[name]
    found = followed(scene, scene.frames(FRAMES))
    # The first and the last window include the ends.
    error = (found.across_px - found.across_px.mean(axis=0))[:, 1:-1]
    reach = calibrate.TUNING.edge_flank_px if scene.feature == "edge" else 0.5 * scene.width_px + 4.0
    bounds = [bound_px(scene, k, found.arc_px[1:-1], found.model.line.spacing_px, reach) for k in (0, 7)]
    bound = np.sqrt(np.mean(np.square(bounds)))
    # The mean over the frames takes a share of the variance.
    rms = np.sqrt(np.mean(error**2) * FRAMES / (FRAMES - 1))
    # The rms of n errors has the relative sd (2 n)^-1/2: 3.6 % here; the rest is the error of the learned profile.
    spread = 1.0 / np.sqrt(2.0 * error.size)
    assert rms / bound < 1.05 + 2.5 * spread, f"{rms / bound:.3f} times the bound of {bound:.4f} px"
    ratio = rms / np.sqrt(np.mean(found.sd_px[:, 1:-1] ** 2))
    assert abs(ratio - 1.0) < 0.05 + 2.5 * spread, f"errors are {ratio:.3f} times the stated sd"
    # Locking to pixels: the error over the position within the pixel, with the sd of its amplitude.
    wave = 2.0 * abs(np.mean(error * np.exp(2j * np.pi * found.x_px[:, 1:-1])))
    chance = rms * np.sqrt(2.0 / error.size)
    assert wave < 0.1 * bound + 3.0 * chance, f"{wave / bound:.3f} times the bound at the period of a pixel"
    # Not only changes but also places: the line is the middle of the strip, or its half level. Next to the clamp,
    # where the strip moves by a tenth of the size of a grain or less, the texture behind it is never seen alone.
    known = (scene.texture == 0.0) | (np.ptp(found.x_px, axis=0)[1:-1] > 0.3)
    assert np.count_nonzero(known) > 0.8 * known.size
    assert np.abs(found.across_px.mean(axis=0)[1:-1][known]).max() < 4.0 * bound / np.sqrt(FRAMES) + 0.005


def test_neighbouring_stations_have_independent_errors():
    scene = CASES["strip of 4 px"]
    found = followed(scene, scene.frames(FRAMES))
    error = (found.across_px - found.across_px.mean(axis=0))[:, 1:-1]
    pairs = error[:, 1:] * error[:, :-1]
    correlation = np.mean(pairs) / np.mean(error**2)
    # Of independent errors: zero with an sd of n^-1/2.
    assert abs(correlation) < 3.5 / np.sqrt(pairs.size), f"correlation {correlation:.3f}"


def test_material_points_follow_the_bent_beam():
    """A tip displaced by 0.4 of the length moves towards the clamp by a tenth of it: the stations move with it."""
    scene = replace(CASES["strip of 4 px"], tip_px=(44.0, 0.0), shape=(150, 130), clamp_px=(64.3, 16.6))
    found = followed(scene, scene.frames(16))
    points = [scene.points(k, found.arc_px[-1:])[0][0] for k in range(16)]
    assert np.ptp([p[1] for p in points]) > 8.0, "the scene has no foreshortening"
    # Errors across the line are those of a station; along it, they grow with the errors of the slope, second order.
    assert np.abs(found.along_px).max() < 0.1
    assert np.abs(found.across_px).max() < 5.0 * found.sd_px.max()


def test_blurred_lines_are_at_the_bound_with_a_known_exposure():
    scene = replace(CASES["strip of 4 px"], tip_px=(8.0, 0.0), cycles_per_frame=(0.07, 0.2), exposure=0.9)
    frames = scene.frames(16)
    found = followed(scene, frames)
    assert np.all(np.isfinite(found.across_px))
    steps = np.abs(np.diff(found.x_px, axis=0)).max()
    assert steps * scene.exposure > 2.5, "the scene has little blur"
    # The last frames: at first no velocity is known.
    error = (found.across_px - found.across_px.mean(axis=0))[4:, 1:-1]
    ratio = np.sqrt(np.mean(error**2) / np.mean(found.sd_px[4:, 1:-1] ** 2))
    spread = 1.0 / np.sqrt(2.0 * error.size)
    assert abs(ratio - 1.0) < 0.1 + 2.5 * spread, f"errors are {ratio:.3f} times the stated sd"

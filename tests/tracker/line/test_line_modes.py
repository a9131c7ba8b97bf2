"""What a profile learned from too smooth a motion, or a window placed by its prediction, would show."""

from dataclasses import replace

import numpy as np
import pytest
from kit.lines import SMALL, followed

from benchmarks.line_scenes import LineScene
from tracker.line import LineFollower, calibrate_line

SCENE = LineScene(**SMALL)
LONGER = replace(SCENE, length_px=180.0, shape=(220, 76))


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.mark.parametrize(("mode", "noise"), [(3, 0.5), (5, 2.0)])
def test_stations_are_at_their_sd_in_high_modes(mode, noise):
    """A profile learned about a line that is too smooth for the mode is too wide, or the line is lost."""
    motion = {"modes": (mode,), "tip_px": (5.0,), "cycles_per_frame": (0.0913,)}
    scene = replace(LONGER, noise=noise, **motion)
    found = followed(scene, scene.frames(24))
    error = (found.across_px - found.across_px.mean(axis=0))[:, 1:-1]
    ratio = rms(error) / rms(found.sd_px[:, 1:-1]) * np.sqrt(24 / 23)
    # The relative sd of an rms is (2 n)^-1/2; the learned profile adds some percent.
    spread = 1.0 / np.sqrt(2.0 * error.size)
    assert abs(ratio - 1.0) < 0.05 + 3.0 * spread, f"errors are {ratio:.3f} times the stated sd"


def test_a_line_along_the_pixels_that_moves_does_not_lock_to_them():
    """All stations are at about the same place within the pixel: only their motion tells the profile."""
    motion = {"modes": (1,), "tip_px": (5.6,), "cycles_per_frame": (0.0913,)}
    scene = replace(LONGER, angle_rad=0.5 * np.pi + 0.006, noise=0.5, **motion)
    found = followed(scene, scene.frames(33))
    moving = np.ptp(found.x_px, axis=0) > 4.0
    moving[-1] = False
    error = (found.across_px - found.across_px.mean(axis=0))[:, moving]
    # Locked to the pixels, errors are five times their sd; the rest as above.
    spread = 1.0 / np.sqrt(2.0 * error.size)
    ratio = rms(error) / rms(found.sd_px[:, moving]) * np.sqrt(33 / 32)
    assert abs(ratio - 1.0) < 0.1 + 3.0 * spread, f"errors are {ratio:.3f} times the stated sd"


def test_the_result_does_not_depend_on_the_prediction():
    """The mean over a window of a line that is turned against its prediction is not the value at the station."""
    # Without noise: pixels that change to the neighbouring station would change its error.
    levels = replace(SCENE, noise=0.0).frames(8)
    ends = SCENE.points(0.0, np.array([0.0, SCENE.length_px]))[0]
    model = calibrate_line(levels, ends, np.array([0.1, 0.0, 255.0]))
    assert model, model.reason
    follower = LineFollower(model)
    follower.step(levels[0])
    start = follower.fit.moved
    share = model.line.arc_px / model.line.length_px
    points = []
    for off_px in (0.0, 0.35):
        # Below the miss from which the registration is repeated, in a shape with slopes of both signs.
        off = model.line.smoothed(off_px * np.sin(2.5 * np.pi * share), np.ones(share.size, dtype=bool))
        fit = LineFollower(model)._register(levels[0], follower.moved(start, off))
        assert fit.accepted.all()
        points.append(follower._output(fit, follower._rest(fit)).out[:2])
    apart_px = np.hypot(*(points[1] - points[0]))[1:-1]
    # The slope, 2.5 pi 0.35 px / 106 px, times the mean place of a window's pixels about its station, up to half a px,
    # is 0.013 px, 0.005 px rms. Rounding to gray levels has errors of 0.001 px.
    assert rms(apart_px) < 0.0015, f"{rms(apart_px):.5f} px"


@pytest.mark.parametrize(("mode", "tip_px"), [(1, 1.2), (2, 2.0)])
def test_the_largest_step_is_that_of_the_line_and_not_of_its_prediction(mode, tip_px):
    """To 0.1 px: the note on the exposure asks whether it is above 1 px; predictions are off by 0.4 px and more."""
    motion = {"modes": (mode,), "tip_px": (tip_px,), "cycles_per_frame": (0.0913,)}
    scene = replace(SCENE, **motion)
    ends = scene.points(0.0, np.array([0.0, scene.length_px]))[0]
    model = calibrate_line(scene.frames(24), ends, np.array([1.0, 0.0, 255.0]))
    at = np.array([scene.points(float(k), model.from_clamp_px)[0] for k in range(24)])
    true_px = np.linalg.norm(np.diff(at, axis=0), axis=2).max()
    assert model.largest_step_px == pytest.approx(true_px, abs=0.1)

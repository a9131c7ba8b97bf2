"""Ends given by hand to some px are moved to where the strip is seen to end, and distances along it are right."""

import numpy as np
import pytest
from kit.lines import SMALL

from benchmarks.line_scenes import LineScene
from tracker.line import calibrate_line
from tracker.line import model as line_model
from tracker.markers import line

CAMERA = np.array([4.0, 0.0, 255.0])


def ends_off_px(scene, given_px):
    """Distances along the line of the ends of the model from those of the scene, and the model."""
    true, normals = scene.points(0.0, np.array([0.0, scene.length_px]))
    tangents = np.stack([normals[:, 1], -normals[:, 0]], axis=1) / np.hypot(*normals.T)[:, None]
    model = calibrate_line(scene.frames(16), true + given_px[:, None] * tangents, CAMERA)
    assert model, model.reason
    curve = model.line.fine(model.start)
    first = curve.points[0] - line_model.TUNING.inset_px * curve.tangents[0]
    last = curve.points[-1] + line_model.TUNING.inset_px * curve.tangents[-1]
    return np.sum((np.stack([first, last]) - true) * tangents, axis=1), model


@pytest.mark.parametrize(
    "scene",
    [
        LineScene(**SMALL),
        LineScene(**SMALL, width_px=2.5, angle_rad=0.5 * np.pi + 0.1, texture=4.0),
        LineScene(**(SMALL | {"clamp_px": (38.3, 18.2)}), width_px=9.0, bend_rad=0.2),
    ],
)
@pytest.mark.parametrize("given_px", [(-3.0, 2.5), (1.2, -3.0)])
def test_ends_of_a_strip_are_found_to_a_fraction_of_a_pixel(scene, given_px):
    off, model = ends_off_px(scene, np.array(given_px))
    assert model.ends_seen == (True, True)
    assert np.all(np.abs(off) < 3.0 * line.TUNING.seen_sd_px), (
        f"{off} px for ends given {given_px} px off, 3 sd"
    )
    length = model.length_px - scene.length_px
    assert abs(length) < 3.0 * np.sqrt(2.0) * line.TUNING.seen_sd_px, f"length {length:.2f} px off"


def test_an_end_that_is_not_seen_stays_as_given():
    """Below the picture's border, the strip goes on: the last visible point is given."""
    scene = LineScene(**(SMALL | {"length_px": 150.0}))
    true = scene.points(0.0, np.array([0.0, 100.0]))[0]
    model = calibrate_line(scene.frames(16), true, CAMERA)
    assert model, model.reason
    assert model.ends_seen == (True, False)
    curve = model.line.fine(model.start)
    last = curve.points[-1] + line_model.TUNING.inset_px * curve.tangents[-1]
    # What the steps of a path known to a px add to its length of 100 px.
    assert np.hypot(*(last - true[1])) < 1.0

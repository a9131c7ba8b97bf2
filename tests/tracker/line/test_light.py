"""Positions of an edge with the light of its neighbours against the truth and the Cramer-Rao bounds."""

from dataclasses import replace

import numpy as np
import pytest
from kit.lines import SMALL, calibrated, followed

from benchmarks.line_scenes import LineScene, bound_px
from tracker.line import UNKNOWN_LIGHT, Centreline, LineFollower, calibrate, kernel, learned_light

FRAMES = 48
SCENE = LineScene(**SMALL, feature="edge")


@pytest.fixture(scope="module")
def frames():
    return SCENE.frames(FRAMES)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


def positions(model, frames):
    """Displacement of each station across the line at rest, px, and its sd; both (n, stations)."""
    follower = LineFollower(model)
    out = np.stack([follower.step(frame).out for frame in frames])[:, :, 1:-1]
    return out[:, 0], np.hypot(out[:, 2], out[:, 3])


def test_the_light_of_the_neighbours_is_worth_what_the_bounds_say(frames):
    found = followed(SCENE, frames)
    model = replace(found.model, light=UNKNOWN_LIGHT)
    alone, alone_sd = positions(model, frames)
    together, together_sd = positions(found.model, frames)
    true = np.array([SCENE.points(float(k), found.arc_px[1:-1])[0][:, 0] for k in range(FRAMES)])
    errors = [values - true - np.mean(values - true, axis=0) for values in (alone, together)]
    at = (0, found.arc_px[1:-1], found.model.line.spacing_px, calibrate.TUNING.edge_flank_px)
    expected = rms(bound_px(SCENE, *at, light_known=True)) / rms(bound_px(SCENE, *at))
    assert expected < 0.95, "the scene says little about the light"
    gained = rms(errors[1]) / rms(errors[0])
    # Displacement for known light and the effect of the light's error e are independent. Relative to the sum, e has
    # the variance 1 - expected^2: its product with the rest has a mean of 0, sd sqrt(that / n). A ninth of e is left,
    # because of the scatter of the mean square of eleven stations and of the polynomial.
    spread = np.sqrt((1.0 - expected**2) / alone.size)
    assert abs(gained - expected) < 0.015 + 3.0 * spread, f"{gained:.3f} of the error, bounds: {expected:.3f}"
    assert rms(together_sd) / rms(alone_sd) == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize("feature", ["half", "few"])
def test_light_that_changes_along_a_part_of_the_line_moves_no_station(frames, feature):
    """By a tenth: with the light taken as known, 0.1 px at the steps; alone, the stations do not see it."""
    model = calibrated(SCENE, frames)
    lit = slice(0, 70) if feature == "half" else slice(60, 80)
    changed = []
    for frame in frames[24:]:
        levels = frame.astype(np.float64)
        levels[lit] *= 1.1
        changed.append(np.rint(levels).astype(np.uint8))
    before, _ = positions(model, frames)
    after, sd = positions(model, [*frames[:24], *changed])
    moved = (after - before)[24:].mean(axis=0)
    # The pixels of a station that the step divides have two gains, which no fit has.
    rows = np.array([SCENE.points(0.0, model.from_clamp_px[1:-1])[0][:, 1]])[0]
    whole = np.min(np.abs(rows[:, None] - np.array([lit.start, lit.stop]) + 0.5), axis=1) > 4.0
    # Where the neighbours scatter q times their errors, a station trusts them by 1/q: the largest bias is half the sd
    # of what the light adds, which has sqrt(0.12) of the variance of a station. Another 0.2 sd: the mean of 24 frames.
    assert np.abs(moved[whole]).max() < (0.5 * np.sqrt(0.12) + 0.2) * rms(sd), (
        f"{np.abs(moved[whole]).max():.4f} px"
    )


def synthetic(scatter, seed, n=64, m=40):
    """Results of stations whose light scatters by `scatter` times its error, with its effect on the displacement."""
    rng = np.random.default_rng(seed)
    results = np.zeros((n, m, kernel.RESULT))
    # For known light, sd 1; an error of the gain moves the displacement by minus itself.
    error = 0.4 * rng.normal(size=(n, m))
    results[:, :, kernel.SHIFT] = rng.normal(size=(n, m)) - error
    results[:, :, kernel.GAIN] = 1.0 + error + scatter * 0.4 * rng.normal(size=(n, m))
    results[:, :, kernel.BY_GAIN] = 1.0
    results[:, :, kernel.SD], results[:, :, kernel.SD_KNOWN] = np.sqrt(1.16), 1.0
    return results, np.ones((n, m), dtype=bool)


@pytest.mark.parametrize("scatter", [0.0, 1.0, 3.0])
def test_the_share_is_that_of_the_error_in_the_scatter_of_the_light(scatter):
    light = learned_light(*synthetic(scatter, 1), Centreline(200.0, 40).off_smooth)
    # Regression of n values with noise of 1 on ones with an sd of 0.4 (1 + scatter^2)^1/2; of 40, 16 are smooth.
    sd = 1.0 / np.sqrt(64 * 24 * 0.16 * (1.0 + scatter**2))
    assert light.share == pytest.approx(min(1.0 / (1.0 + scatter**2), 1.0), abs=3.0 * sd)
    # Three terms of 40 follow the light.
    assert light.scatter == pytest.approx((1.0 + scatter**2) * 37 / 40, rel=0.1)

"""Positions where the light on a marker changes: errors against a known motion, and against the stated sd."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from tracker import FloatArray
from tracker.register import Camera, kernel, poor_fit, register
from tracker.template import NoiseModel, Template, from_values, grid_px

NOISE_SD = 1.5
CAMERA = Camera(NoiseModel(NOISE_SD**2, 0.0), 255.0)
MIDDLE, HALF = 35.0, 20.0
FRAMES, TAKEN = 140, 60


def prong(x: FloatArray, y: FloatArray) -> FloatArray:
    """A curved bright edge with little texture along it, like the prong of a tuning fork; gray levels."""
    edge = 1.0 / (1.0 + np.exp(-(x - 0.006 * y**2) / 0.9))
    texture = np.sin(0.9 * x + 0.4) * np.sin(0.7 * y) + np.sin(0.31 * x - 0.53 * y)
    return np.asarray(80.0 + 70.0 * edge + 2.0 * texture)


@pytest.fixture(scope="module")
def template() -> Template:
    u, v = grid_px(HALF, HALF, 2.0)
    x, y = np.meshgrid(u, v)
    return from_values(prong(x, y), (np.maximum(np.abs(x), np.abs(y)) <= HALF).astype(np.uint8), 2.0)


def errors_and_fits(template: Template, disturbance, *, light: float | None) -> tuple[FloatArray, FloatArray]:
    """Errors of x and y, shape (frames, 2), and the fits, of frames with disturbed light."""
    rng = np.random.default_rng(20)
    errors, fits = np.empty((FRAMES, 2)), np.empty((FRAMES, kernel.RESULT))
    y, x = np.indices((71, 71)).astype(np.float64) - MIDDLE
    start = np.array([MIDDLE, MIDDLE, 0.0, 1.0, 0.0])
    for k in range(FRAMES):
        moved = rng.uniform(-0.5, 0.5, 2)
        image = prong(x - moved[0], y - moved[1]) + disturbance(rng, x, y)
        frame = np.clip(np.rint(image + rng.normal(0.0, NOISE_SD, image.shape)), 0, 255).astype(np.uint8)
        fits[k] = register(
            frame, start, np.eye(2), template, CAMERA, with_angle=True, max_shift_px=8.0, light=light
        )
        errors[k] = fits[k, :2] - MIDDLE - moved
        light = None if light is None else fits[k, kernel.LIGHT]
    return errors, fits


def stated(fits: FloatArray) -> FloatArray:
    """Standard deviations as tracks state them, shape (frames, 2)."""
    return fits[:, [kernel.SD_X, kernel.SD_Y]] * np.sqrt(np.maximum(fits[:, [kernel.CHI2]], 1.0))


def rms(values: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))


def shadow(rng: np.random.Generator, x: FloatArray, y: FloatArray) -> FloatArray:
    """A soft shadow across the marker: no polynomial, and not alike on both sides of the edge."""
    along = np.exp(-0.5 * ((y - rng.uniform(-15, 15)) / rng.uniform(7, 12)) ** 2)
    return rng.uniform(15, 30) * along * (1.0 + rng.uniform(-0.3, 0.3) * x / HALF)


def none(_rng: np.random.Generator, x: FloatArray, _y: FloatArray) -> FloatArray:
    """No disturbance."""
    return np.zeros_like(x)


def speckle(rng: np.random.Generator, x: FloatArray, _y: FloatArray) -> FloatArray:
    """Random light of standard deviation 8 gray levels that is alike over two pixels, as compression leaves it."""
    field = ndimage.gaussian_filter(rng.normal(size=x.shape), 0.6)
    return np.asarray(8.0 * field / np.std(field))


def blobs(rng: np.random.Generator, x: FloatArray, _y: FloatArray) -> FloatArray:
    """Random light of standard deviation 5 gray levels that is alike over 5 px: no polynomial of the window."""
    field = ndimage.gaussian_filter(rng.normal(size=x.shape), 2.5)
    return np.asarray(5.0 * field / np.std(field))


def test_a_soft_shadow_along_an_edge_does_not_move_the_position(template: Template) -> None:
    """Known motion: fitting the light must reduce the error along the edge to a third, and its sd must be true.

    60 frames determine an rms of z to 9 %; blocks of pixels that share a shadow leave the sd uncertain by 20 %.
    """
    plain, alone = errors_and_fits(template, shadow, light=None)
    errors, fits = errors_and_fits(template, shadow, light=0.0)
    assert np.all(fits[-TAKEN:, kernel.LIGHT] > 0.8), "the share of uneven light"
    assert rms(errors[-TAKEN:])[1] < rms(plain)[1] / 3.0, (
        f"rms along the edge {rms(errors[-TAKEN:])[1]:.3f} px, plain {rms(plain)[1]:.3f}"
    )
    z = rms(errors / stated(fits))
    assert np.all(z < 1.3), f"errors are {z} stated sd in x and y, for a known motion"
    # Across the edge the position is that without, but for the edge's slope.
    np.testing.assert_allclose(fits[:, 0], alone[:, 0], atol=0.02)


def test_the_position_does_not_jump_when_the_light_changes(template: Template) -> None:
    """From one frame to the next the share of uneven light changes by a twentieth at most."""
    _, fits = errors_and_fits(template, shadow, light=0.0)
    steps = np.abs(np.diff(fits[:, kernel.LIGHT], prepend=0.0))
    assert np.max(steps) <= 1.0 / poor_fit.TUNING.memory + 1e-12


def test_a_poor_fit_states_a_larger_sd_where_no_polynomial_explains_it(template: Template) -> None:
    """Light that is alike over 5 px: sums over blocks tell what independent pixels do not."""
    plain, alone = errors_and_fits(template, blobs, light=None)
    errors, fits = errors_and_fits(template, blobs, light=0.0)
    assert rms(plain / stated(alone))[1] > 2.0, (
        "the sd for independent residuals is right, or the test shows nothing"
    )
    z = rms(errors / stated(fits))[1]
    assert 0.5 < z < 1.4, f"errors along the edge are {z:.2f} stated sd, for a known motion"


@pytest.mark.parametrize("disturbance", [none, speckle])
def test_fits_without_uneven_light_keep_their_position(template: Template, disturbance) -> None:
    """A polynomial explains neither noise nor a fine residual: the position is the same, to the last bit."""
    _, first = errors_and_fits(template, disturbance, light=None)
    _, again = errors_and_fits(template, disturbance, light=0.0)
    same = kernel.SD_X if disturbance is speckle else kernel.LIGHT
    np.testing.assert_array_equal(first[:, :same], again[:, :same], "fits without uneven light")
    if disturbance is speckle:
        assert np.all(first[:, kernel.CHI2] > 3.0), "the fits must be poor, or the test shows nothing"

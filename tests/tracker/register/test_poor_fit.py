"""Positions where the light on a marker changes: errors against a known motion, and against the stated sd."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from tracker.arrays import FloatArray
from tracker.register import kernel
from tracker.register.marker import Camera, register
from tracker.template.noise import NoiseModel
from tracker.template.spline import Template, from_values, grid_px

NOISE_SD = 1.5
CAMERA = Camera(NoiseModel(NOISE_SD**2, 0.0), 255.0)
MIDDLE, HALF = 35.0, 20.0
FRAMES = 60


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


def errors_and_fits(template: Template, disturbance, *, reconsidered: bool) -> tuple[FloatArray, FloatArray]:
    """Errors of x and y, shape (frames, 2), and the fits, of frames with disturbed light."""
    rng = np.random.default_rng(20)
    errors, fits = np.empty((FRAMES, 2)), np.empty((FRAMES, kernel.RESULT))
    y, x = np.indices((71, 71)).astype(np.float64) - MIDDLE
    for k in range(FRAMES):
        moved = rng.uniform(-0.5, 0.5, 2)
        image = prong(x - moved[0], y - moved[1]) + disturbance(rng, x, y)
        frame = np.clip(np.rint(image + rng.normal(0.0, NOISE_SD, image.shape)), 0, 255).astype(np.uint8)
        start = np.array([MIDDLE, MIDDLE, 0.0, 1.0, 0.0])
        fits[k] = register(
            frame,
            start,
            np.eye(2),
            template,
            CAMERA,
            with_angle=True,
            max_shift_px=8.0,
            reconsidered=reconsidered,
        )
        errors[k] = fits[k, :2] - MIDDLE - moved
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


def test_a_soft_shadow_along_an_edge_does_not_move_the_position(template: Template) -> None:
    """Known motion: fitting the light must reduce the error along the edge to a third, and its sd must be true.

    60 frames determine an rms of z to 9 %; blocks of pixels that share a shadow leave the sd uncertain by 20 %.
    """
    plain, _ = errors_and_fits(template, shadow, reconsidered=False)
    errors, fits = errors_and_fits(template, shadow, reconsidered=True)
    assert rms(errors)[1] < rms(plain)[1] / 3.0, (
        f"rms along the edge {rms(errors)[1]:.3f} px, plain {rms(plain)[1]:.3f}"
    )
    z = rms(errors / stated(fits))
    assert np.all(z < 1.3), f"errors are {z} stated sd in x and y, for a known motion"


@pytest.mark.parametrize("disturbance", [none, speckle])
def test_fits_without_uneven_light_are_the_same_bytes(template: Template, disturbance) -> None:
    """A polynomial explains neither noise nor a fine residual: the position stays where it was."""
    _, first = errors_and_fits(template, disturbance, reconsidered=False)
    _, again = errors_and_fits(template, disturbance, reconsidered=True)
    np.testing.assert_array_equal(first, again, "fits without uneven light")
    if disturbance is speckle:
        assert np.all(first[:, kernel.CHI2] > 3.0), "the fits must be poor, or the test shows nothing"

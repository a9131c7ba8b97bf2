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


def clouds(rng: np.random.Generator, x: FloatArray, _y: FloatArray) -> FloatArray:
    """Random light that is alike over 3.5 px, of standard deviation 8 gray levels."""
    field = ndimage.gaussian_filter(rng.normal(size=x.shape), 1.0)
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


def test_residuals_that_are_alike_in_neighbouring_pixels_widen_the_sd(template: Template) -> None:
    """Known motion under random light: errors over the stated sd have an rms of 1.

    Of 60 frames this is determined to 9 %. The sd across the edge comes from the six blocks along it, of which two
    unknowns take their share, and is determined to 35 %: three times both, from 1, is 2. Independent residuals must
    be far beyond, or the test would show nothing.
    """
    plain, first = errors_and_fits(template, clouds, reconsidered=False)
    errors, fits = errors_and_fits(template, clouds, reconsidered=True)
    independent, z = rms(plain / stated(first)), rms(errors / stated(fits))
    assert np.all(independent > 2.5), f"rms of z {independent} without regard to the correlation"
    assert np.all((z > 0.5) & (z < 2.0)), f"rms of z {z} for a known motion; 0.5 to 2 expected"


def test_fits_that_noise_explains_are_the_same_bytes(template: Template) -> None:
    """Nothing is reconsidered where chi-square is that of noise."""

    def none(_rng: np.random.Generator, x: FloatArray, _y: FloatArray) -> FloatArray:
        return np.zeros_like(x)

    _, first = errors_and_fits(template, none, reconsidered=False)
    _, again = errors_and_fits(template, none, reconsidered=True)
    np.testing.assert_array_equal(first, again, "fits with a chi-square of 1")

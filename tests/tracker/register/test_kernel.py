"""The registration kernel with invalid inputs, and its template values against scipy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from tracker.register import Camera, kernel, register, sampling
from tracker.template import NoiseModel, disc_template

CAMERA = Camera(NoiseModel(2.0, 0.05), 255.0)


@pytest.mark.parametrize("column", range(kernel.STATE))
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_non_finite_start_gives_a_failed_fit(column: int, bad: float) -> None:
    """A non-finite state is rejected: the kernel would read outside the template, which can end the process."""
    template = disc_template(6.0, 0.8)
    start = np.array([20.0, 20.0, 0.0, -100.0, 160.0])
    start[column] = bad
    image = np.full((40, 40), 120, dtype=np.uint8)
    result = register(image, start, np.eye(2), template, CAMERA, with_angle=False, max_shift_px=4.0)
    assert result[kernel.CONVERGED] == 0.0, f"a start with {bad} in column {column} was reported as converged"
    assert np.all(np.isnan(result[:2])), "a failed fit has no position"


@pytest.mark.parametrize("noise", [(np.nan, 0.0), (0.0, 0.0)])
def test_invalid_noise_gives_a_failed_fit(noise: tuple[float, float]) -> None:
    """NaN or infinite weights give a NaN step, which must not be applied."""
    template = disc_template(6.0, 0.8)
    image = np.random.default_rng(1).integers(0, 255, (40, 40)).astype(np.uint8)
    result = register(
        image,
        np.array([20.0, 20.0, 0.0, -100.0, 160.0]),
        np.eye(2),
        template,
        Camera(NoiseModel(*noise), 255.0),
        with_angle=True,
        max_shift_px=4.0,
    )
    assert result[kernel.CONVERGED] == 0.0, f"noise {noise} was reported as converged"


@pytest.mark.parametrize("corner", [(20.3, 19.6), (3.2, 37.9), (-60.0, 20.0)])
@pytest.mark.parametrize(("stride", "pixel"), [(1, np.uint8), (3, np.uint8), (1, np.uint16), (3, np.uint16)])
def test_sampled_template_is_scipys_spline(corner: tuple[float, float], stride: int, pixel: type) -> None:
    """Value, slopes and support of each pixel against scipy, inside, at the edge of and outside the image.

    The kernel uses single precision for values up to 1, with about ten roundings of 6e-8 each: 2e-6. The
    rounding of the position, 6e-8 of a step, is multiplied by slopes of less than 1. scipy's slopes are central
    differences with step 1e-4; their error of h^2 / 6 times the third derivative plus eps / h is below 1e-7.
    """
    template = disc_template(6.0, 0.8)
    coefs, support = template.grid
    angle, scale = 0.3, template.oversampling
    matrix = scale * np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    centre = np.array([*corner, 0.0])
    box = np.array([int(corner[0]) - 11, 23 // stride, int(corner[1]) - 11, 22 // stride, stride])
    image = np.random.default_rng(3).integers(0, np.iinfo(pixel).max, (40, 40)).astype(pixel)
    pixels = int(box[1] * box[3])
    table, cell, nearest, columns, mask = sampling.make_pixel_buffers(pixels)
    sampling.fill_positions(centre, matrix, box, support.shape, table, cell, nearest)
    sampling.fill_pixels(sampling.picture(image), box, table)
    sampling.fill_template(coefs, support, cell, nearest, pixels, columns, mask, table)
    down, across = np.meshgrid(np.arange(box[3]), np.arange(box[1]), indexing="ij")
    x, y = (box[0] + stride * across).ravel(), (box[2] + stride * down).ravel()
    rows, cols = template.coefs.shape
    u, v = matrix @ np.stack([x - corner[0], y - corner[1]]) + 0.5 * np.array([[cols - 1], [rows - 1]])

    def spline(dv: float, du: float) -> np.ndarray:
        return ndimage.map_coordinates(template.coefs, [v + dv, u + du], order=3, prefilter=False)

    inside = ndimage.map_coordinates(template.support, [np.floor(v + 0.5), np.floor(u + 0.5)], order=0) > 0
    h = 1e-4
    np.testing.assert_array_equal(
        table[sampling.WANTED] > 0, inside, "pixels of the support, by scipy with nearest neighbour"
    )
    in_image = (x >= 0) & (x < 40) & (y >= 0) & (y < 40)
    np.testing.assert_array_equal(table[sampling.SEEN] > 0, in_image, "pixels in the image")
    np.testing.assert_array_equal(
        table[sampling.PIXEL][in_image], image[y[in_image], x[in_image]], "pixel values"
    )
    for row, expected in (
        (sampling.VALUE, spline(0, 0)),
        (sampling.SLOPE_U, (spline(0, h) - spline(0, -h)) / (2 * h)),
        (sampling.SLOPE_V, (spline(h, 0) - spline(-h, 0)) / (2 * h)),
    ):
        worst = np.abs(table[row] - expected)[inside].max()
        assert worst < 2e-6, (
            f"table row {row} is off by {worst:.1e} from scipy's spline; rounding allows 2e-6"
        )


def test_sums_over_bands_are_those_over_the_whole_marker() -> None:
    """Sums over bands of rows against numpy's over the whole table; both in double precision, so 1e-10 relative."""
    template = disc_template(30.0, 0.8)
    coefs, support = template.grid
    image = np.random.default_rng(4).integers(20, 200, (90, 90)).astype(np.uint8)
    state, noise = np.array([44.3, 45.1, 0.0, -100.0, 160.0]), np.array([2.0, 0.05])
    buffers = sampling.make_pixel_buffers(90 * 90)
    box = np.array([5, 80, 6, 79, 1])
    assert box[1] * box[3] > sampling.BAND_PIXELS, "the marker must need more than one band for this test"
    matrix = template.oversampling * np.eye(2)
    table, cell, nearest, columns, mask = buffers
    n = int(box[1] * box[3])
    sampling.fill_positions(state, matrix, box, support.shape, table, cell, nearest)
    sampling.fill_pixels(sampling.picture(image), box, table)
    sampling.fill_template(coefs, support, cell, nearest, n, columns, mask, table)
    rows = table[:, :n].astype(np.float64)
    model = state[3] * rows[sampling.VALUE] + state[4]
    weight = np.where(rows[sampling.WANTED] > 0, 1.0 / (noise[0] + noise[1] * model), 0.0)
    residual = rows[sampling.PIXEL] - model
    normal, rhs = np.zeros((5, 5)), np.zeros(10)
    grid, camera = kernel.Grid(coefs, support, template.oversampling, 100.0, 1), kernel.Pixels(noise, 255.0)
    sums = kernel._accumulate(
        sampling.picture(image), state, np.eye(2), grid, camera, kernel.make_workspace(), normal, rhs
    )
    expected = np.count_nonzero(rows[sampling.WANTED])
    assert sums[sampling.USED] == expected, (
        f"{sums[sampling.USED]} pixels used, the whole table has {expected}"
    )
    # A weight is a single-precision quotient: 6e-8 each.
    np.testing.assert_allclose(
        sums[0], np.sum(weight * residual**2), rtol=1e-7, err_msg="chi-square over bands"
    )
    np.testing.assert_allclose(normal[3, 3], np.sum(weight), rtol=1e-7, err_msg="weights over bands")

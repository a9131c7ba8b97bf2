"""The registration kernel at the edges of what it may be given."""

from __future__ import annotations

import numpy as np
import pytest

from tracker.registration import kernel
from tracker.registration.model import Camera, reach_px, register
from tracker.registration.noise import NoiseModel
from tracker.registration.parametric import disc_template

CAMERA = Camera(NoiseModel(2.0, 0.05), 255.0)


@pytest.mark.parametrize("column", range(kernel.STATE))
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_start_that_is_no_number_is_a_failed_fit(column: int, bad: float) -> None:
    """Reading the template at NaN once ended the process: a state that is not finite is refused."""
    template = disc_template(6.0, 0.8)
    start = np.array([20.0, 20.0, 0.0, -100.0, 160.0])
    start[column] = bad
    image = np.full((40, 40), 120, dtype=np.uint8)
    result = register(
        image,
        start,
        np.eye(2),
        template,
        CAMERA,
        reach=reach_px(template, np.eye(2)),
        with_angle=False,
        max_shift_px=4.0,
    )
    assert result[kernel.CONVERGED] == 0.0, f"a start with {bad} in column {column} was said to be fitted"
    assert np.all(np.isnan(result[:2])), "a failed fit has no position"


@pytest.mark.parametrize("noise", [(np.nan, 0.0), (0.0, 0.0)])
def test_noise_that_is_no_number_is_a_failed_fit(noise: tuple[float, float]) -> None:
    """Weights of NaN or infinity make a step of NaN, which must not be walked."""
    template = disc_template(6.0, 0.8)
    image = np.random.default_rng(1).integers(0, 255, (40, 40)).astype(np.uint8)
    result = register(
        image,
        np.array([20.0, 20.0, 0.0, -100.0, 160.0]),
        np.eye(2),
        template,
        Camera(NoiseModel(*noise), 255.0),
        reach=reach_px(template, np.eye(2)),
        with_angle=True,
        max_shift_px=4.0,
    )
    assert result[kernel.CONVERGED] == 0.0, f"noise {noise} was said to give a fit"

"""A template as it looks when it moves during the exposure."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from tracker.registration.template import Template, from_values
from tracker.series import FloatArray

# Motion below this during the exposure changes the picture less than a lens does.
SMALLEST_PX = 0.5
STEP_PX = 0.5
DIRECTIONS = 24


class BlurBank:
    """Templates of one marker blurred along straight motion, made when first needed.

    Length is rounded to half a pixel and direction to 7.5 degrees: the residual blur is a tenth of a pixel.
    The position that registration then gives is that of the middle of the exposure.
    """

    def __init__(self, template: Template) -> None:
        self._still = template
        self._made: dict[tuple[int, int], Template] = {}

    def get(self, motion_uv: FloatArray) -> Template:
        """Template for a motion during the exposure, given as a vector in px of the marker's frame."""
        length = float(np.hypot(motion_uv[0], motion_uv[1]))
        steps = round(length / STEP_PX)
        if length < SMALLEST_PX or steps == 0:
            return self._still
        angle = np.arctan2(motion_uv[1], motion_uv[0]) % np.pi
        key = (steps, round(angle / np.pi * DIRECTIONS) % DIRECTIONS)
        if key not in self._made:
            direction = np.pi * key[1] / DIRECTIONS
            vector = steps * STEP_PX * np.array([np.cos(direction), np.sin(direction)])
            self._made[key] = blurred(self._still, vector)
        return self._made[key]


def blurred(template: Template, motion_uv: FloatArray) -> Template:
    """Mean of the template along a straight line of motion, centred; the support stays.

    A trapezium rule with points a quarter of a pixel apart or closer.
    """
    rows, cols = np.indices(template.coefs.shape, dtype=np.float64)
    points = 2 * max(2, int(np.ceil(2.0 * np.hypot(*motion_uv)))) + 1
    shares = np.linspace(-0.5, 0.5, points)
    weights = np.full(points, 1.0)
    weights[[0, -1]] = 0.5
    total = np.zeros(template.coefs.shape)
    for share, weight in zip(shares, weights / weights.sum(), strict=True):
        du, dv = share * motion_uv * template.oversampling
        total += weight * ndimage.map_coordinates(
            template.coefs, [rows + dv, cols + du], order=3, mode="nearest", prefilter=False
        )
    return from_values(total, template.support, template.oversampling)

"""Point of a marker that its tracked position follows where the scale of the image changes."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from tracker.arrays import FloatArray
from tracker.register.marker import MarkerModel


def fixed_point_px(model: MarkerModel) -> FloatArray:
    """Where a marker that grows is registered, as if it grew about this point; x and y from its centre, shape (2,).

    The template keeps its size. Least squares of the change of the image by growth on its changes by all parameters of
    the registration: a dot has its centre there, a code or a piece of texture the point about which its edges balance.
    """
    template = model.template
    # Values and derivatives of a cubic spline at the points of its grid.
    value, slope = np.array([1.0, 4.0, 1.0]) / 6.0, np.array([-0.5, 0.0, 0.5])
    along = [
        ndimage.correlate1d(ndimage.correlate1d(template.coefs, rows, axis=0), columns, axis=1)
        for rows, columns in ((value, value), (value, slope), (slope, value))
    ]
    inside = template.support > 0
    gray, by_u, by_v = (image[inside] for image in along)
    rows, columns = np.nonzero(inside)
    u, v = (
        (at - 0.5 * (size - 1)) for at, size in zip((columns, rows), template.coefs.shape[::-1], strict=True)
    )
    others = [gray, np.ones_like(gray), *([u * by_v - v * by_u] if model.with_angle else [])]
    found = np.linalg.lstsq(np.column_stack([by_u, by_v, *others]), u * by_u + v * by_v, rcond=None)[0]
    return np.asarray(np.linalg.solve(model.warp, found[:2] / template.oversampling - model.centre_uv))

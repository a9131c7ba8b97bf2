"""Standard deviation of the stations of a line in lossily compressed footage."""

from __future__ import annotations

import numpy as np

from tracker.arrays import FloatArray, GrayImage
from tracker.line import kernel
from tracker.line.follower import Fit, LineFollower
from tracker.line.model import LineModel
from tracker.line.profile import spline_values
from tracker.template import FRAMES, LARGEST_FACTOR, LARGEST_LAG_PX, autocovariance


def line_sd_factor(images: list[GrayImage], model: LineModel) -> float:
    """Factor on the sd of the stations due to the spatial correlation of the residuals; 1 to 6.

    As `tracker.template.compression.sd_factors`, pooled over the stations, for the gradient along the normal.
    """
    follower = LineFollower(model)
    side = 2 * LARGEST_LAG_PX + 1
    totals = np.zeros((2, side, side))
    for image in images[:FRAMES]:
        follower.step(image)
        if follower.fit is None:
            continue
        for k in np.flatnonzero(follower.fit.accepted)[::3]:
            residual, slope = _residual_and_slope(image, model, follower.fit, int(k))
            totals += np.stack([autocovariance(residual), autocovariance(slope)])
    centre = LARGEST_LAG_PX
    if np.any(totals[:, centre, centre] <= 0.0):
        return 1.0
    rho, slope = (total / total[centre, centre] for total in totals)
    return min(float(np.sqrt(max(np.sum(rho * slope), 1.0))), LARGEST_FACTOR)


def _residual_and_slope(
    image: GrayImage, model: LineModel, fit: Fit, k: int
) -> tuple[FloatArray, FloatArray]:
    """Residual and derivative by the displacement of the pixels of one station; 0 outside its window."""
    stations, state = fit.stations, fit.results[k, : kernel.STATE]
    tangent = stations.tangents[k]
    normal = np.array([-tangent[1], tangent[0]])
    centre = stations.points[k] + state[kernel.SHIFT] * normal
    along, across = stations.half_along[k], stations.half_across[k]
    half = np.abs(tangent) * along + np.abs(normal) * across
    low = np.maximum(np.ceil(centre - half), 0).astype(int)
    high = np.minimum(np.floor(centre + half), np.array(image.shape[::-1]) - 1).astype(int)
    y, x = np.mgrid[low[1] : high[1] + 1, low[0] : high[0] + 1]
    u = (x - centre[0]) * tangent[0] + (y - centre[1]) * tangent[1]
    v = (x - centre[0]) * normal[0] + (y - centre[1]) * normal[1]
    inside = (np.abs(u) <= along) & (np.abs(v) <= across)
    coefs, _, first, step = model.profiles()
    values, ahead, behind = (spline_values(coefs[k], first, v + d) for d in (0.0, step, -step))
    window = np.s_[low[1] : high[1] + 1, low[0] : high[0] + 1]
    levels = image[window].astype(np.float64)
    texture, uncovered = model.background
    if texture.size:
        values = values + texture[window] * (uncovered[0] + uncovered[1] * values)
    residual = levels - state[kernel.GAIN] * values - state[kernel.OFFSET]
    return residual * inside, (ahead - behind) * inside

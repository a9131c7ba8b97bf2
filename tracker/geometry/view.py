"""Positions in the plane of the beam from positions in the image: lens, oblique view and scale."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tracker.arrays import FloatArray
from tracker.geometry.lens import Lens, undistort, undistortion_jacobian
from tracker.geometry.plane import PlaneMap, plane_jacobian, to_plane


@dataclass(frozen=True)
class Positions:
    """Positions of m markers in n frames, x right and y up, and their standard deviations; shapes (n, m).

    ``correlation`` is that of the errors of x and y; None where they are independent.
    """

    x: FloatArray
    y: FloatArray
    sd_x: FloatArray
    sd_y: FloatArray
    correlation: FloatArray | None = None

    def covariance(self) -> FloatArray:
        """Covariance of the errors of x and y; shape (n, m)."""
        if self.correlation is None:
            return np.zeros_like(self.sd_x)
        return self.correlation * self.sd_x * self.sd_y


def rectified(
    positions_px: Positions, lens: Lens | None, plane: PlaneMap | None, mm_per_px: float
) -> Positions:
    """Positions corrected for distortion, in mm, from those in the image, y **down**.

    Without a lens or a plane there is no such correction. The plane includes the scale; `mm_per_px` is used without a
    plane, and 1 keeps pixels. The standard deviations are propagated with the derivative at each marker's median
    position, without the correlation of x and y that a rotated or skewed map causes where they are independent.
    """
    x, y = positions_px.x, positions_px.y
    slope = np.tile(np.eye(2), (x.shape[1], 1, 1))
    rest_x, rest_y = median_over_time(x), median_over_time(y)
    if lens is not None:
        slope = undistortion_jacobian(lens, rest_x, rest_y)
        x, y = undistort(lens, x, y)
        rest_x, rest_y = undistort(lens, rest_x, rest_y)
    if plane is not None:
        slope = np.matmul(plane_jacobian(plane, rest_x, rest_y), slope)
        x, y = to_plane(plane, x, y)
    else:
        slope = slope * mm_per_px
        x, y = x * mm_per_px, -y * mm_per_px
    if plane is None:
        slope = slope * np.array([[1.0], [-1.0]])
    variance = np.stack([positions_px.sd_x**2, positions_px.sd_y**2])
    squared = np.einsum("kij,jnk->ink", slope**2, variance)
    if positions_px.correlation is None:
        return Positions(x, y, *np.sqrt(squared))
    covariance = positions_px.covariance()
    squared += 2.0 * np.moveaxis(slope[:, :, 0] * slope[:, :, 1], 0, 1)[:, None, :] * covariance
    sd = np.sqrt(np.maximum(squared, 0.0))
    mixed = np.einsum("kj,jnk->nk", slope[:, 0] * slope[:, 1], variance)
    mixed += (slope[:, 0, 0] * slope[:, 1, 1] + slope[:, 0, 1] * slope[:, 1, 0]) * covariance
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = np.where(sd[0] * sd[1] > 0.0, mixed / (sd[0] * sd[1]), 0.0)
    return Positions(x, y, sd[0], sd[1], np.clip(correlation, -1.0, 1.0))


def median_over_time(values: FloatArray) -> FloatArray:
    """Median of the finite values along the first axis; NaN where there is none."""

    def median(column: FloatArray) -> float:
        seen = column[np.isfinite(column)]
        return float(np.median(seen)) if seen.size else float("nan")

    return np.asarray(np.apply_along_axis(median, 0, values))

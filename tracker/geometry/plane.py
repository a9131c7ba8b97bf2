"""Positions in the plane of the beam from positions in the image: homography, lens and scale."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy  # its parts are loaded when they are used

from tracker.arrays import FloatArray
from tracker.geometry.lens import Lens, undistort, undistortion_jacobian


@dataclass(frozen=True)
class Tuning:
    """When points determine a plane."""

    #: [1] points closer to a line than this share of their extent do not determine the plane
    least_breadth: float = 0.05


TUNING = Tuning()

LEAST_POINTS = 4


@dataclass(frozen=True)
class PlaneMap:
    """Homography from pixels (free of distortion) to mm in the plane, x right and y up; the last entry is 1.

    ``matrix`` holds the nine numbers row by row, ``source`` describes the data.
    """

    matrix: tuple[float, ...]
    source: str


def to_plane(plane: PlaneMap, x_px: FloatArray, y_px: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Positions in the plane, in mm; NaN stays NaN, shapes are kept."""
    h = plane.matrix
    w = h[6] * x_px + h[7] * y_px + h[8]
    return (h[0] * x_px + h[1] * y_px + h[2]) / w, (h[3] * x_px + h[4] * y_px + h[5]) / w


def plane_jacobian(plane: PlaneMap, x_px: FloatArray, y_px: FloatArray) -> FloatArray:
    """Derivative of `to_plane` in mm per px at positions of shape (k,): array of shape (k, 2, 2)."""
    h = np.array(plane.matrix).reshape(3, 3)
    x_mm, y_mm = to_plane(plane, x_px, y_px)
    w = h[2, 0] * x_px + h[2, 1] * y_px + h[2, 2]
    rows = [(h[r, :2] - at[..., None] * h[2, :2]) / w[..., None] for r, at in enumerate((x_mm, y_mm))]
    return np.stack(rows, axis=-2)


def plane_from_points(points_px: FloatArray, points_mm: FloatArray) -> tuple[PlaneMap, float] | None:
    """Least-squares homography through four or more known positions, shape (k, 2), and its rms residual in mm.

    None for fewer than four points or points on one line. The residual is corrected for the eight fitted parameters,
    and NaN for four points. Pixels are free of distortion; in the plane x is right and y up.
    """
    if len(points_px) < LEAST_POINTS or min(_breadth(points_px), _breadth(points_mm)) < TUNING.least_breadth:
        return None
    centre, span = points_px.mean(axis=0), float(np.ptp(points_px, axis=0).max())
    u = (points_px - centre) / span
    mm_centre, mm_span = points_mm.mean(axis=0), float(np.ptp(points_mm, axis=0).max())
    v = (points_mm - mm_centre) / mm_span

    def residual(h: FloatArray) -> FloatArray:
        w = u @ h[6:] + 1.0
        found = np.stack([u @ h[:2] + h[2], u @ h[3:5] + h[5]], axis=1) / w[:, None]
        return np.asarray((found - v).ravel())

    fit = scipy.optimize.least_squares(residual, _direct(u, v), method="lm", xtol=1e-14, ftol=1e-14)
    inner = np.append(fit.x, 1.0).reshape(3, 3)
    before = np.array([[1, 0, -centre[0]], [0, 1, -centre[1]], [0, 0, span]]) / span
    after = np.array([[mm_span, 0, mm_centre[0]], [0, mm_span, mm_centre[1]], [0, 0, 1]])
    dof = 2 * len(u) - 8
    rms_mm = mm_span * float(np.sqrt(2.0 * np.sum(fit.fun**2) / (2 * dof))) if dof else float("nan")
    return _normalised(after @ inner @ before, "from plane_mm"), rms_mm


def plane_from_metrics(rest_px: FloatArray, jacobians: FloatArray) -> tuple[PlaneMap, FloatArray] | None:
    """Homography from the foreshortening of markers of known size, in any arrangement, even on one line.

    Parameters
    ----------
    rest_px : array, shape (m, 2)
        Centres, without distortion.
    jacobians : array, shape (m, 2, 2)
        From px about each centre to mm in the marker's own frame, which may be rotated.

    Returns
    -------
    PlaneMap and array of shape (m, 3), or None
        Residuals of the three entries of the symmetric root of J'J, relative to its size; only J'J is used, so that
        each marker may have its own orientation. None for fewer than two markers, which give no redundancy for the five
        parameters: the map is X = A u / (1 + v.u) with a symmetric A, whose rotation and shift remain those of the
        image.
    """
    if len(rest_px) < 2:
        return None
    centre = rest_px.mean(axis=0)
    span = max(float(np.ptp(rest_px, axis=0).max()), 1.0)
    u = (rest_px - centre) / span
    roots = np.array([_symmetric_root(j.T @ j) for j in jacobians])
    size = float(np.mean(np.trace(roots, axis1=1, axis2=2))) / 2.0
    measured = _three(roots) / size

    def modelled(p: FloatArray) -> FloatArray:
        a = np.array([[p[0], p[1]], [p[1], p[2]]])
        w = 1.0 + u @ p[3:]
        j = (a[None] * w[:, None, None] - (u @ a)[:, :, None] * p[3:][None, None, :]) / (w**2)[:, None, None]
        return _three(np.array([_symmetric_root(x.T @ x) for x in j]))

    fit = scipy.optimize.least_squares(
        lambda p: (modelled(p) - measured).ravel(), [1.0, 0.0, 1.0, 0.0, 0.0], method="lm"
    )
    a = size * span * np.array([[fit.x[0], fit.x[1]], [fit.x[1], fit.x[2]]])
    inner = np.zeros((3, 3))
    # The plane's y points up, the image's down.
    inner[:2, :2] = np.array([[1.0, 0.0], [0.0, -1.0]]) @ a
    inner[2] = (*fit.x[3:], 1.0)
    before = np.array([[1, 0, -centre[0]], [0, 1, -centre[1]], [0, 0, span]]) / span
    return _normalised(inner @ before, "from the shape of the markers"), np.asarray(fit.fun).reshape(-1, 3)


def foreshortening(jacobian: FloatArray) -> float:
    """Smaller over larger scale of a map's derivative: the cosine of the viewing angle from a large distance."""
    large, small = np.linalg.svd(jacobian, compute_uv=False)
    return float(small / large)


def _breadth(points: FloatArray) -> float:
    values = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return float(values[1] / max(values[0], 1e-300))


def _direct(u: FloatArray, v: FloatArray) -> FloatArray:
    """Start of the fit: linear equations, multiplied by their denominator."""
    zero = np.zeros(len(u))
    one = np.ones(len(u))
    top = np.column_stack([u, one, zero, zero, zero, -u * v[:, :1]])
    bottom = np.column_stack([zero, zero, zero, u, one, -u * v[:, 1:]])
    start, *_ = np.linalg.lstsq(np.vstack([top, bottom]), np.concatenate([v[:, 0], v[:, 1]]), rcond=None)
    return np.asarray(start, dtype=np.float64)


def _symmetric_root(matrix: FloatArray) -> FloatArray:
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)


def _three(roots: FloatArray) -> FloatArray:
    return np.stack([roots[:, 0, 0], roots[:, 0, 1], roots[:, 1, 1]], axis=1)


def _normalised(matrix: FloatArray, source: str) -> PlaneMap:
    return PlaneMap(tuple(float(value) for value in (matrix / matrix[2, 2]).ravel()), source)


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

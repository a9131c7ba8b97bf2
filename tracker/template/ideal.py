"""The ideal marker behind a learned picture: dictionary bits or a disc, with size, blur and gray levels fitted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from tracker.arrays import FloatArray
from tracker.register.marker import MarkerModel
from tracker.template.blur import widened
from tracker.template.parametric import aruco_template, aruco_values, disc_template, disc_values
from tracker.template.spline import Template

POINTS_FOR_SHAPE = 1500


def _grid_of(template: Template) -> tuple[FloatArray, FloatArray]:
    rows, cols = template.coefs.shape
    u = (np.arange(cols) - 0.5 * (cols - 1)) / template.oversampling
    v = (np.arange(rows) - 0.5 * (rows - 1)) / template.oversampling
    return u, v


def fit_aruco(learned: MarkerModel) -> tuple[MarkerModel, float, float, FloatArray] | None:
    """The ideal marker that the learned picture shows."""
    u, v = _grid_of(learned.template)
    inside = learned.template.support > 0
    points = np.stack([a[inside] for a in np.meshgrid(u, v)])
    fitted = ideal_aruco(learned, points, learned.template.values()[inside])
    if fitted is None:
        return None
    model, dark, light, shift = fitted
    matrix = model.warp @ np.linalg.inv(learned.warp)
    return _with_support_of(model, learned, matrix, shift), dark, light, shift


def ideal_aruco(
    model: MarkerModel, points_uv: FloatArray, picture: FloatArray
) -> tuple[MarkerModel, float, float, FloatArray] | None:
    """Affine map, blur and the two gray levels of the ideal marker behind scattered gray levels.

    Parameters
    ----------
    points_uv : array, shape (2, n)
        In px of the model's frame.
    picture : array, shape (n,)

    Returns
    -------
    tuple or None
        The parametric model, dark and light gray level, and its centre in the frame of `model`; None when
        the fit left the marker's neighbourhood.
    """
    detection = model.detection
    if detection.bits is None:
        return None
    bits = detection.bits
    every = max(1, points_uv.shape[1] // POINTS_FOR_SHAPE)
    points, gray = points_uv[:, ::every], picture[::every]
    low, high = np.percentile(gray, (10, 90))

    def residual(p: FloatArray) -> FloatArray:
        matrix = np.array([[1.0 + p[2], p[3]], [p[4], 1.0 + p[5]]])
        at = matrix @ (points - p[:2, None])
        ideal = aruco_values(at[0], at[1], bits, detection.size_px, np.exp(p[6]))
        return np.asarray((p[7] + (p[8] - p[7]) * ideal - gray) / max(high - low, 1e-9))

    start = np.array([0, 0, 0, 0, 0, 0, np.log(0.7), low, high])
    scales = [1, 1, 0.1, 0.1, 0.1, 0.1, 1, 50, 50]
    fit = least_squares(residual, start, method="lm", x_scale=scales, max_nfev=120, ftol=1e-6, xtol=1e-6)
    matrix = np.eye(2) + fit.x[2:6].reshape(2, 2)
    blur = float(np.exp(fit.x[6]))
    if not 0.6 < np.linalg.det(matrix) < 1.6 or blur > 0.3 * detection.size_px or fit.x[8] <= fit.x[7]:
        return None
    ideal = replace(
        model,
        template=aruco_template(bits, detection.size_px, blur),
        source="parametric",
        warp=matrix @ model.warp,
        refine=matrix @ model.refine,
        centre_uv=np.zeros(2),
    )
    return ideal, float(fit.x[7]), float(fit.x[8]), fit.x[:2]


def fit_disc(learned: MarkerModel) -> tuple[MarkerModel, float, float, FloatArray] | None:
    """Radius, blur and gray levels of the ideal dot that the learned picture shows."""
    u, v = _grid_of(learned.template)
    inside = learned.template.support > 0
    values = learned.template.values()
    picture = values[inside]
    middle = values[np.hypot(v[:, None], u[None, :]) < 0.25 * learned.detection.size_px]
    centre_level = float(np.median(middle))
    rim_level = float(np.percentile(picture, 90 if centre_level < np.median(picture) else 10))
    span = max(abs(centre_level - rim_level), 1e-9)

    def residual(p: FloatArray) -> FloatArray:
        ideal = disc_values(u - p[0], v - p[1], p[2], np.exp(p[3]))[inside]
        return np.asarray((p[4] + (p[5] - p[4]) * ideal - picture) / span)

    start = np.array([0, 0, 0.5 * learned.detection.size_px, np.log(0.7), rim_level, centre_level])
    fit = least_squares(
        residual, start, method="lm", x_scale=[1, 1, 1, 1, 50, 50], max_nfev=120, ftol=1e-6, xtol=1e-6
    )
    radius, blur = float(fit.x[2]), float(np.exp(fit.x[3]))
    if not 0.25 < radius / learned.detection.size_px < 1.0 or blur > radius:
        return None
    template = disc_template(radius, blur)
    detection = replace(learned.detection, size_px=2.0 * radius)
    model = replace(
        learned, detection=detection, template=template, source="parametric", centre_uv=np.zeros(2)
    )
    model = _with_support_of(model, learned, np.eye(2), fit.x[:2])
    return model, float(fit.x[4]), float(fit.x[5]), fit.x[:2]


def _with_support_of(
    model: MarkerModel, learned: MarkerModel, matrix: FloatArray, shift: FloatArray
) -> MarkerModel:
    """Parametric model that leaves out what the learned one had to leave out."""
    template, old = model.template, learned.template
    known = None
    if learned.known is not None:
        half = [(t.support.shape[0] - 1) / (2.0 * t.oversampling) for t in (old, template)]
        template = widened(template, max(half[0] - half[1], 0.0))
    u, v = _grid_of(template)
    points = np.linalg.inv(matrix) @ np.stack([a.ravel() for a in np.meshgrid(u, v)]) + shift[:, None]
    kept = _at_points(old, old.support if learned.known is None else learned.known, points)
    kept = kept.reshape(template.support.shape)
    if learned.known is not None:
        known = kept
    support = np.ascontiguousarray(template.support * kept)
    return replace(model, template=Template(template.coefs, support, template.oversampling), known=known)


def _at_points(template: Template, mask: NDArray[np.uint8], points: FloatArray) -> NDArray[np.uint8]:
    """A mask on the template's grid at points of its frame, shape (2, n); 0 beyond the grid."""
    rows, cols = mask.shape
    col = np.rint(points[0] * template.oversampling + 0.5 * (cols - 1)).astype(np.int64)
    row = np.rint(points[1] * template.oversampling + 0.5 * (rows - 1)).astype(np.int64)
    inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
    kept = np.zeros(points.shape[1], dtype=np.uint8)
    kept[inside] = mask[row[inside], col[inside]]
    return kept

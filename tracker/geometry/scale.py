"""Positions in the plane of the beam from those in the image: homography, lens, and millimetres per pixel.

The scale is given, or follows from a marker's printed size or from known distances along the beam.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import scipy  # its parts are loaded when they are used

from tracker.arrays import FloatArray
from tracker.geometry.lens import Lens, undistort, undistortion_jacobian


@dataclass(frozen=True)
class Tuning:
    """Errors of scales, when they are reported, and when points determine a plane."""

    #: [1] relative sd of a printed size
    #: convention: printers and calipers are no better
    size_relative_sd: float = 0.005
    #: [px] error of a fitted size where a model separates blur and size
    size_sd_px: float = 0.05
    #: [px] the same of a size measured by a detector alone
    rough_size_sd_px: float = 0.5
    #: [1] relative difference of two scales that is reported
    #: convention: chosen; a note changes no result
    disagreement: float = 0.1
    #: [1] relative difference of nominally equal markers that is reported
    #: convention: chosen; a note changes no result
    sizes_differ: float = 0.05
    #: [sd] and in standard deviations of a size
    #: statistics: noise alone exceeds it in one pair of 16 000
    sizes_differ_sd: float = 4.0
    #: [1] a view is oblique when scales differ by more than this share
    oblique: float = 0.01
    #: [sd] and by this many standard deviations
    #: statistics: noise alone never does
    oblique_sd: float = 5.0
    #: [mm] plausible extent of a beam in the image, at least
    #: convention: sizes given in metres fall outside
    least_view_mm: float = 5.0
    #: [mm] the same, at most
    #: convention: sizes given in micrometres fall outside
    largest_view_mm: float = 20_000.0
    #: [mm] accuracy of two markers' places along the beam
    #: convention: two leave no residual: that of a ruler and a hand is assumed
    placing_mm: float = 0.5
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


@dataclass(frozen=True)
class Scale:
    """Millimetres per pixel in the plane of the beam, with its standard deviation.

    The scale's error is common to all samples: it is not part of ``sd_x_mm``.
    """

    mm_per_px: float
    sd_mm_per_px: float
    source: str


@dataclass(frozen=True)
class ScaleResult:
    """The scale, None when nothing gives one, notes for the user, and the map of an oblique view."""

    scale: Scale | None
    notes: tuple[str, ...] = ()
    plane: PlaneMap | None = None


class ScaleSettings(Protocol):
    """The fields of `tracker.settings.TrackerSettings` that determine the scale."""

    mm_per_px: float | None
    sd_mm_per_px: float | None
    size_mm: float | None
    plane_mm: tuple[tuple[float, float], ...] | None
    lens: Lens | None


@dataclass(frozen=True)
class SizedMarker:
    """A marker of the nominal size as seen: its size in its own frame, and the map from the image to that frame.

    They are fitted where they come from a parametric template. Where the undistorted shape is known, the warp shows the
    obliquity of the view.
    """

    name: str
    size_px: float
    warp: FloatArray
    is_fitted: bool
    has_shape: bool


def resolve_scale(
    settings: ScaleSettings,
    markers: Sequence[SizedMarker | None],
    rest_px: FloatArray,
    positions_mm: FloatArray,
) -> ScaleResult:
    """Scale from the first available source: plane_mm, settings, marker size, distances along the beam.

    The others are compared with it; a disagreement of more than 10 % is reported, such as that of a size in metres or
    of a radius given as diameter. Lens distortion is corrected first. Where the view is oblique, by `plane_mm` or by
    the shape of markers of known shape and size, the result includes a map of the plane.

    Parameters
    ----------
    markers : sequence of SizedMarker or None, length m
        None for a marker without nominal size.
    rest_px : array, shape (m, 2)
        Position of each marker at rest in the image, uncorrected.
    positions_mm : array, shape (m,)
        NaN where unknown.
    """
    slopes = np.tile(np.eye(2), (len(rest_px), 1, 1))
    if settings.lens is not None:
        slopes = undistortion_jacobian(settings.lens, rest_px[:, 0], rest_px[:, 1])
        rest_px = np.stack(undistort(settings.lens, rest_px[:, 0], rest_px[:, 1]), axis=1)
    oblique = _from_plane(settings.plane_mm, rest_px)
    sized = _from_size(settings.size_mm, markers, slopes)
    given = None
    if settings.mm_per_px is not None:
        given = Scale(settings.mm_per_px, settings.sd_mm_per_px or float("nan"), "as given")
    sources = (oblique.scale, given, sized.scale, _from_distances(rest_px, positions_mm))
    candidates = [scale for scale in sources if scale is not None]
    if not candidates:
        return ScaleResult(None, oblique.notes)
    chosen = candidates[0]
    if chosen is sized.scale:
        oblique = _from_shapes(settings.size_mm, markers, slopes, rest_px, chosen)
        chosen = oblique.scale or chosen
    disagreements = tuple(
        f"The scale {chosen.source} is {chosen.mm_per_px:.5g} mm/px, but {other.source} it would be "
        f"{other.mm_per_px:.5g} mm/px: check sizes, positions and units (all are in mm)."
        + _other_unit(chosen, other.mm_per_px / chosen.mm_per_px)
        for other in candidates[1:]
        if abs(other.mm_per_px / chosen.mm_per_px - 1.0) > TUNING.disagreement
    )
    notes = (*oblique.notes, *sized.notes, *disagreements, *_implausible(chosen, rest_px))
    return ScaleResult(chosen, notes, oblique.plane)


def _from_plane(plane_mm: tuple[tuple[float, float], ...] | None, rest_px: FloatArray) -> ScaleResult:
    """Scale and map from known positions of the markers in the plane."""
    if plane_mm is None:
        return ScaleResult(None)
    if len(plane_mm) != len(rest_px):
        note = f"plane_mm has {len(plane_mm)} positions, but {len(rest_px)} markers are tracked: it was not used."
        return ScaleResult(None, (note,))
    seen = np.all(np.isfinite(rest_px), axis=1)
    known_mm = np.array(plane_mm)[seen]
    fitted = plane_from_points(rest_px[seen], known_mm)
    if fitted is None:
        note = "plane_mm was not used: it needs four or more markers that do not lie on one line."
        return ScaleResult(None, (note,))
    plane, rms_mm = fitted
    middle = plane_jacobian(plane, *rest_px[seen].mean(axis=0)[:, None])[0]
    extent = float(np.linalg.norm(np.ptp(known_mm, axis=0)))
    scale = _middle_scale(middle, rms_mm / extent, "from plane_mm")
    left = f", with a residual of {rms_mm:.2g} mm rms" if np.isfinite(rms_mm) else ", without redundancy"
    note = (
        f"The view is rectified by the positions of {np.count_nonzero(seen)} markers in the plane{left}; at the centre "
        f"one direction appears {100.0 * (1.0 - foreshortening(middle)):.2g} % shorter than the other."
    )
    return ScaleResult(scale, (note,), plane)


def _from_size(
    size_mm: float | None, markers: Sequence[SizedMarker | None], slopes: FloatArray
) -> ScaleResult:
    """Scale from the median size of the markers.

    Its sd includes that of the print, that of a fitted size (common to all, as lens blur is), and the scatter.
    """
    sized = [(m, j) for m, j in zip(markers, slopes, strict=True) if m is not None]
    if size_mm is None or not sized:
        return ScaleResult(None)
    areas = [abs(np.linalg.det(j)) / abs(np.linalg.det(m.warp)) for m, j in sized]
    sizes = np.array([m.size_px for m, _ in sized]) * np.sqrt(areas)
    size_sd = max(TUNING.size_sd_px if m.is_fitted else TUNING.rough_size_sd_px for m, _ in sized)
    size = float(np.median(sizes))
    scatter = float(np.std(sizes, ddof=1)) / np.sqrt(sizes.size) if sizes.size > 1 else 0.0
    relative = np.sqrt(TUNING.size_relative_sd**2 + (size_sd / size) ** 2 + (scatter / size) ** 2)
    notes: tuple[str, ...] = ()
    if float(np.ptp(sizes)) > max(TUNING.sizes_differ * size, TUNING.sizes_differ_sd * size_sd):
        small, large = sized[int(np.argmin(sizes))][0], sized[int(np.argmax(sizes))][0]
        note = (
            f"Markers with the same size_mm appear {sizes.min():.4g} px ({small.name}) to {sizes.max():.4g} px "
            f"({large.name}) large: they were printed differently or the view is oblique."
        )
        notes = (note,)
    mm_per_px = size_mm / size
    return ScaleResult(Scale(mm_per_px, float(mm_per_px * relative), "from the marker size"), notes)


def _from_shapes(
    size_mm: float | None,
    markers: Sequence[SizedMarker | None],
    slopes: FloatArray,
    rest_px: FloatArray,
    plain: Scale,
) -> ScaleResult:
    """Map of an oblique view from the foreshortening of the markers; None where the view is not oblique."""
    shaped = [
        (k, m)
        for k, m in enumerate(markers)
        if m is not None and m.has_shape and m.is_fitted and np.all(np.isfinite(rest_px[k]))
    ]
    if size_mm is None or len(shaped) < 2:
        return ScaleResult(None)
    centres = rest_px[[k for k, _ in shaped]]
    jacobians = np.array([size_mm / m.size_px * m.warp @ np.linalg.inv(slopes[k]) for k, m in shaped])
    fitted = plane_from_metrics(centres, jacobians)
    if fitted is None:
        return ScaleResult(None)
    plane, residual = fitted
    scales = np.linalg.svd(plane_jacobian(plane, *centres.T), compute_uv=False)
    spread = float(scales.max() / scales.min()) - 1.0
    size = float(np.median([m.size_px for _, m in shaped]))
    dof = max(residual.size - 5, 1)
    sd = max(TUNING.size_sd_px / size, float(np.sqrt(np.sum(residual**2) / dof)))
    if spread < max(TUNING.oblique, TUNING.oblique_sd * sd):
        return ScaleResult(None)
    middle = plane_jacobian(plane, *centres.mean(axis=0)[:, None])[0]
    relative = plain.sd_mm_per_px / plain.mm_per_px
    scale = _middle_scale(middle, relative, "from the size and shape of the markers")
    note = (
        f"The view is oblique: across the markers, a millimetre appears up to {100.0 * spread:.2g} % longer in one "
        "position and direction than in another. Positions in mm are rectified by the shape of the markers."
    )
    return ScaleResult(scale, (note,), plane)


def _middle_scale(jacobian: FloatArray, relative_sd: float, source: str) -> Scale:
    mm_per_px = float(np.sqrt(abs(np.linalg.det(jacobian))))
    return Scale(mm_per_px, mm_per_px * relative_sd, source)


def _from_distances(rest_px: FloatArray, positions_mm: FloatArray) -> Scale | None:
    known = np.isfinite(positions_mm) & np.all(np.isfinite(rest_px), axis=1)
    if np.count_nonzero(known) < 2:
        return None
    order = np.argsort(positions_mm[known])
    mm = positions_mm[known][order]
    steps = np.linalg.norm(np.diff(rest_px[known][order], axis=0), axis=1)
    along_px = np.concatenate([[0.0], np.cumsum(steps)])
    line = np.polyfit(along_px, mm, 1)
    if line[0] <= 0.0:
        return None
    residual = mm - np.polyval(line, along_px)
    spread = float(np.sum((along_px - along_px.mean()) ** 2))
    placing = float(np.sqrt(np.sum(residual**2) / (mm.size - 2))) if mm.size > 2 else TUNING.placing_mm
    return Scale(float(line[0]), placing / np.sqrt(spread), "from the positions along the beam")


def _implausible(scale: Scale, rest_px: FloatArray) -> tuple[str, ...]:
    """A note where the extent of the markers is implausible for a beam."""
    seen = rest_px[np.all(np.isfinite(rest_px), axis=1)]
    if len(seen) < 2:
        return ()
    extent = float(np.linalg.norm(np.ptp(seen, axis=0))) * scale.mm_per_px
    low, high = TUNING.least_view_mm, TUNING.largest_view_mm
    if low <= extent <= high:
        return ()
    note = (
        f"With {scale.mm_per_px:.3g} mm/px {scale.source} the markers span {extent:.3g} mm, which is "
        "implausible for a beam: check units (all are in mm)."
    )
    likely = next((f for f in (1e3, 1e-3) if low <= f * extent <= high), 1.0)
    return (note + _other_unit(scale, likely),)


def _other_unit(scale: Scale, factor: float) -> str:
    """The unit that a scale was given in, where it is wrong by this factor, and what to write; empty for any other."""
    for thousand, unit in ((1e3, "metres"), (1e-3, "micrometres")):
        if abs(factor / thousand - 1.0) < 2.0 * TUNING.disagreement:
            return f" If lengths {scale.source} are in {unit}, it is {thousand * scale.mm_per_px:.5g} mm/px."
    return ""

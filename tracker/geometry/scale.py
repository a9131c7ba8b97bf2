"""Millimetres per pixel: given, from a marker's printed size, or from known distances along the beam."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tracker.arrays import FloatArray
from tracker.geometry.lens import undistort, undistortion_jacobian
from tracker.geometry.plane import (
    PlaneMap,
    foreshortening,
    plane_from_metrics,
    plane_from_points,
    plane_jacobian,
)
from tracker.register.marker import MarkerModel
from tracker.settings import TrackerSettings

# A printed size is known to about this; printers and calipers are no better.
SIZE_RELATIVE_SD = 0.005
# What a fitted size may be off by, in px, when blur and size were told apart by a model.
SIZE_SD_PX = 0.05
# The same when only a detector has seen the size.
ROUGH_SIZE_SD_PX = 0.5
DISAGREEMENT = 0.10
# Sizes of markers that should be equal may differ by so much before it is said.
SIZES_DIFFER = 0.05
# A view is called oblique when scales differ by more, and by more than so many standard deviations.
OBLIQUE = 0.01
OBLIQUE_SD = 5.0
# What a beam and its picture can measure, in mm over the longer side: a size in metres falls out of it.
PLAUSIBLE_VIEW_MM = (5.0, 20_000.0)


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
    """The scale, None when nothing gives one, what the user should know, and the map of an oblique view."""

    scale: Scale | None
    notes: tuple[str, ...] = ()
    plane: PlaneMap | None = None


def resolve_scale(
    settings: TrackerSettings, models: tuple[MarkerModel, ...], rest_px: FloatArray, positions_mm: FloatArray
) -> ScaleResult:
    """Scale from the first source that exists: plane_mm, settings, marker size, distances along the beam.

    The others are compared with it; a disagreement of more than 10 % is reported, as a size in metres or a
    diameter that was meant as a radius would be. Distortion of the lens is taken out first. Where the view is
    oblique, by `plane_mm` or by the shape of ArUco markers of known size, the result has a map of the plane.

    Parameters
    ----------
    rest_px : array, shape (m, 2)
        Mean position of each marker, as seen.
    positions_mm : array, shape (m,)
        NaN where unknown.
    """
    slopes = np.tile(np.eye(2), (len(rest_px), 1, 1))
    if settings.lens is not None:
        slopes = undistortion_jacobian(settings.lens, rest_px[:, 0], rest_px[:, 1])
        rest_px = np.stack(undistort(settings.lens, rest_px[:, 0], rest_px[:, 1]), axis=1)
    oblique = _from_plane(settings, rest_px)
    sized = _from_size(settings.size_mm, models, slopes)
    candidates = [
        scale
        for scale in (oblique.scale, _given(settings), sized.scale, _from_distances(rest_px, positions_mm))
        if scale is not None
    ]
    if not candidates:
        return ScaleResult(None, oblique.notes)
    chosen = candidates[0]
    if chosen is sized.scale:
        oblique = _from_shapes(settings.size_mm, models, slopes, rest_px, chosen)
        chosen = oblique.scale or chosen
    disagreements = tuple(
        f"The scale {chosen.source} is {chosen.mm_per_px:.5g} mm/px, but {other.source} it would be "
        f"{other.mm_per_px:.5g} mm/px: check sizes, positions and units (all are in mm)."
        for other in candidates[1:]
        if abs(other.mm_per_px / chosen.mm_per_px - 1.0) > DISAGREEMENT
    )
    notes = (*oblique.notes, *sized.notes, *disagreements, *_implausible(chosen, rest_px))
    return ScaleResult(chosen, notes, oblique.plane)


def _given(settings: TrackerSettings) -> Scale | None:
    if settings.mm_per_px is None:
        return None
    sd = settings.sd_mm_per_px if settings.sd_mm_per_px is not None else float("nan")
    return Scale(settings.mm_per_px, sd, "as given")


def _from_plane(settings: TrackerSettings, rest_px: FloatArray) -> ScaleResult:
    """Scale and map from known places of the markers in the plane."""
    if settings.plane_mm is None:
        return ScaleResult(None)
    if len(settings.plane_mm) != len(rest_px):
        note = (
            f"plane_mm names {len(settings.plane_mm)} places, but {len(rest_px)} markers are followed: it was not "
            "used."
        )
        return ScaleResult(None, (note,))
    seen = np.all(np.isfinite(rest_px), axis=1)
    fitted = plane_from_points(rest_px[seen], np.array(settings.plane_mm)[seen])
    if fitted is None:
        note = "plane_mm was not used: it takes four or more markers that do not lie on one line."
        return ScaleResult(None, (note,))
    plane, rms_mm = fitted
    middle = plane_jacobian(plane, *rest_px[seen].mean(axis=0)[:, None])[0]
    extent = float(np.linalg.norm(np.ptp(np.array(settings.plane_mm)[seen], axis=0)))
    scale = Scale(*_size_of(middle, rms_mm / extent), "from plane_mm")
    left = f", which leaves {rms_mm:.2g} mm rms" if np.isfinite(rms_mm) else ", which nothing checks"
    note = (
        f"The view is rectified by the places of {np.count_nonzero(seen)} markers in the plane{left}; at the middle "
        f"one direction is seen {100.0 * (1.0 - foreshortening(middle)):.2g} % shorter than the other."
    )
    return ScaleResult(scale, (note,), plane)


def _from_size(size_mm: float | None, models: tuple[MarkerModel, ...], slopes: FloatArray) -> ScaleResult:
    """Scale from the median size of the markers.

    Its sd holds the print's (common to all), that of a fitted size (taken as common, since lens blur shifts all edges
    alike), and the scatter between markers.
    """
    sized = [(m, j) for m, j in zip(models, slopes, strict=False) if m.detection.kind in ("aruco", "blob")]
    if size_mm is None or not sized:
        return ScaleResult(None)
    # The refinement is the map from what the detector took for the marker's frame to its true frame.
    sizes = np.array(
        [m.detection.size_px * np.sqrt(abs(np.linalg.det(j)) / abs(np.linalg.det(m.warp))) for m, j in sized]
    )
    size_sd = max(SIZE_SD_PX if m.source == "parametric" else ROUGH_SIZE_SD_PX for m, _ in sized)
    size = float(np.median(sizes))
    scatter = float(np.std(sizes, ddof=1)) / np.sqrt(sizes.size) if sizes.size > 1 else 0.0
    relative = np.sqrt(SIZE_RELATIVE_SD**2 + (size_sd / size) ** 2 + (scatter / size) ** 2)
    notes: tuple[str, ...] = ()
    if float(np.ptp(sizes)) > max(SIZES_DIFFER * size, 4.0 * size_sd):
        small, large = sized[int(np.argmin(sizes))][0], sized[int(np.argmax(sizes))][0]
        note = (
            f"Markers of one size_mm are seen {sizes.min():.4g} px ({small.detection.name}) to {sizes.max():.4g} px "
            f"({large.detection.name}) large: they were printed differently or the view is oblique."
        )
        notes = (note,)
    mm_per_px = size_mm / size
    return ScaleResult(Scale(mm_per_px, float(mm_per_px * relative), "from the marker size"), notes)


def _from_shapes(
    size_mm: float | None,
    models: tuple[MarkerModel, ...],
    slopes: FloatArray,
    rest_px: FloatArray,
    plain: Scale,
) -> ScaleResult:
    """Map of an oblique view from how ArUco markers are foreshortened; without one where the view is not oblique."""
    squares = [
        k
        for k, m in enumerate(models)
        if m.detection.kind == "aruco" and m.source == "parametric" and np.all(np.isfinite(rest_px[k]))
    ]
    if size_mm is None or len(squares) < 2:
        return ScaleResult(None)
    jacobians = np.array(
        [size_mm / models[k].detection.size_px * models[k].warp @ np.linalg.inv(slopes[k]) for k in squares]
    )
    fitted = plane_from_metrics(rest_px[squares], jacobians)
    if fitted is None:
        return ScaleResult(None)
    plane, residual = fitted
    maps = plane_jacobian(plane, rest_px[squares, 0], rest_px[squares, 1])
    scales = np.linalg.svd(maps, compute_uv=False)
    spread = float(scales.max() / scales.min()) - 1.0
    size = float(np.median([models[k].detection.size_px for k in squares]))
    freedom = max(residual.size - 5, 1)
    sd = max(SIZE_SD_PX / size, float(np.sqrt(np.sum(residual**2) / freedom)))
    if spread < max(OBLIQUE, OBLIQUE_SD * sd):
        return ScaleResult(None)
    middle = plane_jacobian(plane, *rest_px[squares].mean(axis=0)[:, None])[0]
    relative = plain.sd_mm_per_px / plain.mm_per_px
    scale = Scale(*_size_of(middle, relative), "from the size and shape of the markers")
    note = (
        f"The view is oblique: across the markers a millimetre is seen {100.0 * spread:.2g} % longer in one place and "
        "direction than in another. Positions in mm are rectified by the shape of the markers."
    )
    return ScaleResult(scale, (note,), plane)


def _size_of(jacobian: FloatArray, relative_sd: float) -> tuple[float, float]:
    mm_per_px = float(np.sqrt(abs(np.linalg.det(jacobian))))
    return mm_per_px, mm_per_px * relative_sd


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
    # Two markers leave no residual: then a marker is taken to be placed to half a millimetre.
    placing = float(np.sqrt(np.sum(residual**2) / (mm.size - 2))) if mm.size > 2 else 0.5
    return Scale(float(line[0]), placing / np.sqrt(spread), "from the positions along the beam")


def _implausible(scale: Scale, rest_px: FloatArray) -> tuple[str, ...]:
    """A note where the markers' extent cannot be that of a beam before a camera."""
    seen = rest_px[np.all(np.isfinite(rest_px), axis=1)]
    if len(seen) < 2:
        return ()
    extent = float(np.linalg.norm(np.ptp(seen, axis=0))) * scale.mm_per_px
    low, high = PLAUSIBLE_VIEW_MM
    if low <= extent <= high:
        return ()
    note = (
        f"With {scale.mm_per_px:.3g} mm/px {scale.source} the markers span {extent:.3g} mm, which is hardly a beam: "
        "check units (all are in mm)."
    )
    return (note,)

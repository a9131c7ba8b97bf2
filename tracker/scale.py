"""Millimetres per pixel: given, from a marker's printed size, or from known distances along the beam."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tracker.registration.model import MarkerModel
from tracker.series import FloatArray, Scale
from tracker.settings import TrackerSettings

# A printed size is known to about this; printers and calipers are no better.
SIZE_RELATIVE_SD = 0.005
# What a fitted size may be off by, in px, when blur and size were told apart by a model.
SIZE_SD_PX = 0.05
# The same when only a detector has seen the size.
ROUGH_SIZE_SD_PX = 0.5
DISAGREEMENT = 0.10


@dataclass(frozen=True)
class ScaleResult:
    """The scale, None when nothing gives one, and what the user should know."""

    scale: Scale | None
    notes: tuple[str, ...] = ()


def resolve_scale(
    settings: TrackerSettings, models: tuple[MarkerModel, ...], rest_px: FloatArray, positions_mm: FloatArray
) -> ScaleResult:
    """Scale from the first source that exists: settings, marker size, distances along the beam.

    The others are compared with it; a disagreement of more than 10 % is reported, as a size in metres or a
    diameter that was meant as a radius would be.

    Parameters
    ----------
    rest_px : array, shape (m, 2)
        Mean position of each marker.
    positions_mm : array, shape (m,)
        NaN where unknown.
    """
    candidates = [
        scale
        for scale in (
            _given(settings),
            _from_size(settings.size_mm, models),
            _from_distances(rest_px, positions_mm),
        )
        if scale is not None
    ]
    if not candidates:
        return ScaleResult(None)
    chosen = candidates[0]
    notes = tuple(
        f"The scale {chosen.source} is {chosen.mm_per_px:.5g} mm/px, but {other.source} it would be "
        f"{other.mm_per_px:.5g} mm/px: check sizes, positions and units (all are in mm)."
        for other in candidates[1:]
        if abs(other.mm_per_px / chosen.mm_per_px - 1.0) > DISAGREEMENT
    )
    return ScaleResult(chosen, notes)


def _given(settings: TrackerSettings) -> Scale | None:
    if settings.mm_per_px is None:
        return None
    sd = settings.sd_mm_per_px if settings.sd_mm_per_px is not None else float("nan")
    return Scale(settings.mm_per_px, sd, "as given")


def _from_size(size_mm: float | None, models: tuple[MarkerModel, ...]) -> Scale | None:
    sized = [m for m in models if m.sighting.kind in ("aruco", "blob")]
    if size_mm is None or not sized:
        return None
    # The refinement is the map from what the finder took for the marker's frame to its true frame.
    sizes = np.array([m.sighting.size_px / np.sqrt(abs(np.linalg.det(m.warp))) for m in sized])
    size_sd = max(SIZE_SD_PX if m.source == "parametric" else ROUGH_SIZE_SD_PX for m in sized)
    size = float(np.median(sizes))
    scatter = float(np.std(sizes, ddof=1)) / np.sqrt(sizes.size) if sizes.size > 1 else 0.0
    relative = np.sqrt(SIZE_RELATIVE_SD**2 + (size_sd / size) ** 2 + (scatter / size) ** 2)
    mm_per_px = size_mm / size
    return Scale(mm_per_px, float(mm_per_px * relative), "from the marker size")


def _from_distances(rest_px: FloatArray, positions_mm: FloatArray) -> Scale | None:
    known = np.isfinite(positions_mm) & np.all(np.isfinite(rest_px), axis=1)
    if np.count_nonzero(known) < 2:
        return None
    order = np.argsort(positions_mm[known])
    mm = positions_mm[known][order]
    steps = np.linalg.norm(np.diff(rest_px[known][order], axis=0), axis=1)
    along_px = np.concatenate([[0.0], np.cumsum(steps)])
    (slope, _), residual = np.polyfit(along_px, mm, 1), None
    if slope <= 0.0:
        return None
    residual = mm - np.polyval(np.polyfit(along_px, mm, 1), along_px)
    freedom = max(mm.size - 2, 1)
    spread = float(np.sum((along_px - along_px.mean()) ** 2))
    # Two markers leave no residual: then a marker is taken to be placed to half a millimetre.
    placing = float(np.sqrt(np.sum(residual**2) / freedom)) if mm.size > 2 else 0.5
    return Scale(float(slope), placing / np.sqrt(spread), "from the positions along the beam")

"""Which detector a recording gets."""

from __future__ import annotations

from tracker.arrays import FloatArray, GrayImage
from tracker.markers.aruco import ArucoDetector
from tracker.markers.base import FoundMarkers, MarkerDetector, NothingFound
from tracker.markers.dots import DotDetector
from tracker.markers.patch import PatchDetector
from tracker.settings import TrackerSettings


def detect_markers(
    frames: list[GrayImage], settings: TrackerSettings
) -> tuple[MarkerDetector, FoundMarkers] | NothingFound:
    """Markers of the kind that the settings name; "auto" tries ArUco, dots and given points in this order."""
    detectors: list[MarkerDetector] = []
    auto = settings.kind == "auto"
    if auto or settings.kind == "aruco":
        detectors.append(ArucoDetector(settings.dictionary, settings.positions_mm, other_dictionaries=auto))
    if settings.kind == "blob" or (auto and not settings.points_px):
        detectors.append(
            DotDetector(settings.positions_mm, settings.clamp_side, keep_still=bool(settings.reference))
        )
    if settings.points_px and (auto or settings.kind == "patch"):
        detectors.append(PatchDetector(settings.points_px, settings.positions_mm, settings.size_px))
    reasons: list[str] = []
    seen_px: FloatArray | None = None
    for detector in detectors:
        found = detector.detect(frames)
        if isinstance(found, FoundMarkers):
            return detector, found
        reasons.append(found.reason)
        # Of several kinds the one that came nearest to being found is shown.
        if found.seen_px is not None and (seen_px is None or len(found.seen_px) > len(seen_px)):
            seen_px = found.seen_px
    return NothingFound("; ".join(reasons), seen_px)

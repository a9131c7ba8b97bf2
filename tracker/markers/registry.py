"""Registry of the kinds of markers, and detection of whichever kind a recording shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tracker.arrays import FloatArray, GrayImage
from tracker.markers.aruco import ARUCO
from tracker.markers.assignment import leaving_out
from tracker.markers.dots import DOT
from tracker.markers.kind import DetectionSettings, FoundMarkers, MarkerDetector, MarkerKind, NothingFound
from tracker.markers.line import LINE
from tracker.markers.patch import PATCH

AUTO = "auto"


class UnknownKind(MarkerKind):
    """A kind of which nothing is known but what all have in common."""

    name = ""

    def detector(self, settings: DetectionSettings, *, auto: bool) -> None:
        """None: there is nothing to detect it by."""


class AutoKind(UnknownKind):
    """Any of the kinds with an `auto_rank`: what settings with ``kind = "auto"`` say of the markers."""

    name = AUTO
    takes_points = True


AUTO_KIND, UNKNOWN = AutoKind(), UnknownKind()
MARKER_KINDS: dict[str, MarkerKind] = {kind.name: kind for kind in (ARUCO, DOT, PATCH, LINE)}


def register_marker_kind(kind: MarkerKind) -> None:
    """Make a kind of marker available under its name, in settings, configuration files and for "auto".

    Raises
    ------
    ValueError
        If the name is already taken by another kind, or is "auto".
    """
    if kind.name == AUTO or MARKER_KINDS.get(kind.name, kind) is not kind:
        msg = f"the marker kind {kind.name!r} is already registered; choose another name"
        raise ValueError(msg)
    MARKER_KINDS[kind.name] = kind


def marker_kind(name: str) -> MarkerKind:
    """The registered kind of this name; the error where there is none lists the names."""
    if name not in MARKER_KINDS:
        msg = f"expected a marker kind, one of {', '.join((*MARKER_KINDS, AUTO))}; found {name!r}"
        raise ValueError(msg)
    return MARKER_KINDS[name]


def kind_of(name: str) -> MarkerKind:
    """The kind of this name in settings or tracks; `UNKNOWN` for that of a plugin that is not loaded."""
    return AUTO_KIND if name == AUTO else MARKER_KINDS.get(name, UNKNOWN)


def noun_of(kind: str) -> str:
    """What one marker of a kind is called."""
    return kind_of(kind).noun


def detect_markers(
    frames: list[GrayImage], settings: DetectionSettings, kind: str = AUTO
) -> tuple[MarkerDetector, FoundMarkers] | NothingFound:
    """Markers of the named kind; "auto" tries the kinds with an `auto_rank` in that order.

    What was read as a marker and rejected, also of an earlier kind, is added to the notes.
    """
    auto = kind == AUTO
    ranked = sorted((k.auto_rank, k.name) for k in MARKER_KINDS.values() if k.auto_rank is not None)
    kinds = [MARKER_KINDS[name] for _, name in ranked] if auto else [marker_kind(kind)]
    reasons: list[str] = []
    rejected: list[str] = []
    seen_px: FloatArray | None = None
    for tried in kinds:
        detector = tried.detector(settings, auto=auto)
        if detector is None:
            continue
        if tried.is_sought:
            detector = leaving_out(detector, settings.leave_out_px)
        found = _named(detector.detect(frames), settings.names, tried)
        if isinstance(found, FoundMarkers):
            notes = tuple(f"Not taken for a marker: {text}." for text in (*rejected, *found.rejected))
            return detector, replace(found, notes=(*found.notes, *notes))
        reasons.append(found.reason)
        rejected += found.rejected
        # Of several kinds, show the candidates of the one with most.
        if found.seen_px is not None and (seen_px is None or len(found.seen_px) > len(seen_px)):
            seen_px = found.seen_px
    return NothingFound("; ".join(reasons), seen_px=seen_px, rejected=tuple(rejected))


def _named(
    found: FoundMarkers | NothingFound, names: tuple[str, ...] | None, kind: MarkerKind
) -> FoundMarkers | NothingFound:
    """The markers with the names that the user gives those of a kind that is sought in the picture."""
    if isinstance(found, NothingFound) or names is None or not kind.is_sought:
        return found
    own = [one.name for one in found.detections]
    if len(names) != len(own):
        return NothingFound(
            f"names has {len(names)} entries, but {len(own)} markers were detected ({', '.join(own)}); give one name "
            "for each, in that order",
            seen_px=np.array([(one.x_px, one.y_px) for one in found.detections]),
        )
    pairs = zip(found.detections, names, strict=True)
    return replace(found, detections=tuple(replace(one, name=name) for one, name in pairs))

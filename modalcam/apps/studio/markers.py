"""Edits of the markers of one recording, as options of its configuration."""

from __future__ import annotations

from collections.abc import Container, Sequence
from typing import TYPE_CHECKING, Any

from modalcam.apps.studio.draft import Draft, Value
from modalcam.apps.studio.frames import Point, patch_names
from modalcam.common import ModalcamError
from modalcam.config import RecordingConfig
from tracker.markers import kind_of

if TYPE_CHECKING:
    from modalcam.apps.studio.trial import DetectedMarker


def add_point(draft: Draft, file: str, point: Point) -> None:
    """Add the centre of a patch; the kind becomes "patch"."""
    recording = draft.recording(file)
    points, names = recording.points_px or (), list(patch_names(recording))
    # The first name that no other has.
    names.append(
        next(name for k in range(len(names), 2 * len(names) + 1) if (name := f"m{k + 1}") not in names)
    )
    _set_points(draft, file, [*points, point], names)


def move_point(draft: Draft, file: str, index: int, point: Point) -> None:
    """Move the centre of a patch."""
    recording = draft.recording(file)
    points = list(recording.points_px or ())
    points[index] = point
    _set_points(draft, file, points, patch_names(recording))


def rename_point(draft: Draft, file: str, index: int, name: str) -> None:
    """Name a patch; an empty name is that by its place, m1 for the first."""
    names = list(patch_names(draft.recording(file)))
    names[index] = name.strip() or f"m{index + 1}"
    draft.set_for(file, {"names": _unless_usual(names)})


def delete_point(draft: Draft, file: str, index: int) -> None:
    """Remove a patch, with its position on the beam; without any left, markers are detected again."""
    recording = draft.recording(file)
    points, positions = list(recording.points_px or ()), recording.positions_mm
    names = _renumbered(recording, [k for k in range(len(points)) if k != index])
    del points[index]
    values: dict[str, Any] = {"points_px": [list(point) for point in points] or None, "names": names}
    if not points:
        values["kind"] = recording.kind if kind_of(recording.kind).is_sought else None
    if positions is not None and len(positions) == len(points) + 1:
        values["positions_mm"] = [p for k, p in enumerate(positions) if k != index] or None
    draft.set_for(file, values)


def move_earlier(draft: Draft, file: str, index: int) -> None:
    """Exchange a patch, not the first, with the one before it, each with its position on the beam."""
    recording = draft.recording(file)
    order = list(range(len(recording.points_px or ())))
    order[index - 1 : index + 1] = index, index - 1
    points, positions = recording.points_px or (), recording.positions_mm or ()
    values: dict[str, Any] = {
        "points_px": [list(points[k]) for k in order],
        "names": _renumbered(recording, order),
    }
    if len(positions) == len(points):
        values["positions_mm"] = [positions[k] for k in order]
    draft.set_for(file, values)


def add_region(draft: Draft, file: str, corner: Point, opposite: Point) -> None:
    """Leave out a region in which no markers are sought; ModalcamError if it is empty."""
    (left, right), (top, bottom) = (sorted(pair) for pair in zip(corner, opposite, strict=True))
    if right - left < 1.0 or bottom - top < 1.0:
        msg = "the two corners of the region are on one line; choose opposite corners"
        raise ModalcamError(msg)
    draft.set_for(file, _regions([*draft.recording(file).leave_out_px, ((left, top), (right, bottom))]))


def detected_names(recording: RecordingConfig, detected: Sequence[DetectedMarker]) -> tuple[str, ...]:
    """Name of each detected marker: those given, if there is one for each, or else those by their kind."""
    given = recording.names or ()
    return given if len(given) == len(detected) else tuple(one.name for one in detected)


def rename_detected(
    draft: Draft, file: str, detected: Sequence[DetectedMarker], index: int, name: str
) -> None:
    """Name a detected marker; an empty name is that by its kind."""
    usual = [one.name for one in detected]
    names = list(detected_names(draft.recording(file), detected))
    names[index] = name.strip() or usual[index]
    draft.set_for(file, {"names": None if names == usual else names})


def leave_out(draft: Draft, file: str, detected: Sequence[DetectedMarker], which: Container[int]) -> None:
    """Leave out detected markers by their indices, with their names and positions: the regions around them."""
    recording = draft.recording(file)
    regions = [_around((one.x_px, one.y_px), one.size_px) for k, one in enumerate(detected) if k in which]
    values = _regions([*recording.leave_out_px, *regions])
    for key in ("names", "positions_mm"):
        own = getattr(recording, key)
        if own is not None and len(own) == len(detected):
            values[key] = [value for k, value in enumerate(own) if k not in which] or None
    draft.set_for(file, values)


def delete_region(draft: Draft, file: str, index: int) -> None:
    """Seek markers in a region again."""
    regions = list(draft.recording(file).leave_out_px)
    del regions[index]
    draft.set_for(file, _regions(regions))


def set_line(draft: Draft, file: str, clamp: Point, free_end: Point) -> None:
    """Set the line of the beam; the kind becomes "line"."""
    draft.set_for(file, {"kind": "line", "line_px": [list(clamp), list(free_end)]})


def set_scale(draft: Draft, file: str, ends: tuple[Point, Point], length_mm: float) -> None:
    """Set the scale from two points of known distance; ModalcamError if they are the same."""
    (x0, y0), (x1, y1) = ends
    length_px = float(((x1 - x0) ** 2 + (y1 - y0) ** 2) ** 0.5)
    if length_px < 1.0:
        msg = "the two points of the scale are the same; choose two that are far apart"
        raise ModalcamError(msg)
    draft.set_for(file, {"mm_per_px": float(f"{length_mm / length_px:.6g}")})


def set_positions(draft: Draft, file: str, text: str) -> None:
    """Set the distances from the clamp, from numbers with commas or spaces between; none removes them."""
    parts = text.replace(",", " ").replace(";", " ").split()
    try:
        values: list[Any] = [float(part) for part in parts]
    except ValueError:
        msg = f"expected distances from the clamp in mm, such as 0 90.5 190; found {text!r}"
        raise ModalcamError(msg) from None
    draft.set_for(file, {"positions_mm": values or None})


def parse_rate(text: str) -> int | float | str | None:
    """Recorded rate as it is written into the configuration; None for an empty text, which removes it."""
    text = text.strip()
    if not text:
        return None
    for number in (int, float):
        try:
            return number(text)
        except ValueError:
            continue
    return text


def nearest_point(points: tuple[Point, ...], at: Point, within_px: float) -> int | None:
    """Index of the point nearest to a position, if it is close."""
    distances = [((x - at[0]) ** 2 + (y - at[1]) ** 2) ** 0.5 for x, y in points]
    best = min(range(len(points)), key=distances.__getitem__, default=None)
    return best if best is not None and distances[best] <= within_px else None


def _around(at: Point, size_px: float) -> tuple[Point, Point]:
    reach = round(0.75 * size_px + 3.0)
    x, y = round(at[0]), round(at[1])
    return (x - reach, y - reach), (x + reach, y + reach)


def _set_points(draft: Draft, file: str, points: list[Point], names: Sequence[str]) -> None:
    values = {"points_px": [list(point) for point in points], "names": _unless_usual(names)}
    draft.set_for(file, {"kind": "patch", **values})


def _unless_usual(names: Sequence[str]) -> list[Value] | None:
    """Names as they are written into the configuration: none where all are those by their place."""
    return None if all(name == f"m{k + 1}" for k, name in enumerate(names)) else [*names]


def _renumbered(recording: RecordingConfig, order: list[int]) -> list[Value] | None:
    """Names of the patches in another order; names by the place are those by the new place."""
    names = patch_names(recording)
    kept = [names[k] if names[k] != f"m{k + 1}" else "" for k in order]
    return _unless_usual([name or f"m{place + 1}" for place, name in enumerate(kept)])


def _regions(regions: Sequence[Sequence[Point]]) -> dict[str, Any]:
    return {"leave_out_px": [[list(corner) for corner in region] for region in regions] or None}

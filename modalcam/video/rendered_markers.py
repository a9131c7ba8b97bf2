"""Rendered markers of each kind that has an artwork."""

from __future__ import annotations

from collections.abc import Sequence

from sim.render import ArucoMarker, DotMarker, Marker
from tracker.markers import MARKER_KINDS, MarkerKind

_DEFAULT_DICTIONARY = "DICT_4X4_50"


def rendered_markers(
    kind: str | None,
    names: Sequence[str],
    *,
    size_mm: float | None,
    dictionary: str | None = None,
    any_dictionary: bool = False,
    gray_levels: tuple[float, float] = (30.0, 200.0),
) -> tuple[Marker, ...] | str:
    """Markers of one kind, or the reason why they cannot be rendered.

    The arguments are those of `[markers]`, but kind "auto". Names of markers of a code contain its number, "id7"; named
    otherwise, they show the codes 0, 1, ... in their order.

    Parameters
    ----------
    any_dictionary : bool
        Use DICT_4X4_50 if no dictionary is given: for markers that are not printed yet.
    gray_levels : tuple of float
        Foreground (dot, black cells) and background (white cells), in counts.
    """
    known = MARKER_KINDS.get(kind or "")
    if known is None or known.artwork is None:
        names_of_kinds = " or ".join(repr(name) for name, k in MARKER_KINDS.items() if k.artwork is not None)
        return f"markers.kind: expected {names_of_kinds} to render markers, found {kind!r}"
    if size_mm is None:
        return "to render markers, markers.size_mm is needed"
    foreground, background = gray_levels
    if known.artwork.shape == "disc":
        return tuple(DotMarker(diameter_mm=size_mm, foreground=foreground) for _ in names)
    if dictionary in (None, "auto"):
        if not any_dictionary:
            return "to render ArUco markers, markers.dictionary is needed"
        dictionary = _DEFAULT_DICTIONARY
    try:
        return tuple(
            ArucoMarker(
                dictionary=str(dictionary),
                marker_id=marker_id,
                size_mm=size_mm,
                foreground=foreground,
                background=background,
            )
            for marker_id in _codes(known, names)
        )
    except ValueError as error:
        return f"the markers cannot be rendered: {error}"


def _codes(kind: MarkerKind, names: Sequence[str]) -> list[int]:
    found = [rank for name in names if (rank := kind.marker_rank(name)) is not None]
    # Positions are in order of the codes.
    return found if len(found) == len(names) and found == sorted(found) else list(range(len(names)))

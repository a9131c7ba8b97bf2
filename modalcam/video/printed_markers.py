"""Markers as the renderer films them, for each kind that is printed."""

from __future__ import annotations

from collections.abc import Sequence

from sim.render.markers import ArucoMarker, DotMarker, Marker
from tracker.markers.base import MarkerKind
from tracker.markers.registry import MARKER_KINDS

_DEFAULT_DICTIONARY = "DICT_4X4_50"


def _disc(
    _kind: MarkerKind, _name: str, size_mm: float, _dictionary: str, gray: tuple[float, float]
) -> Marker:
    return DotMarker(diameter_mm=size_mm, foreground=gray[0])


def _code(kind: MarkerKind, name: str, size_mm: float, dictionary: str, gray: tuple[float, float]) -> Marker:
    return ArucoMarker(
        dictionary=dictionary,
        marker_id=kind.marker_number(name),
        size_mm=size_mm,
        foreground=gray[0],
        background=gray[1],
    )


# Renderer of each shape of `tracker.markers.base.Artwork`.
_RENDERED = {"disc": _disc, "code": _code}


def printed_markers(
    kind: str,
    names: Sequence[str],
    *,
    size_mm: float | None,
    dictionary: str | None = None,
    any_dictionary: bool = False,
    gray_levels: tuple[float, float] = (30.0, 200.0),
) -> tuple[Marker, ...] | str:
    """Prints of markers of one kind, or why they cannot be rendered.

    Parameters
    ----------
    kind : str
        As markers.kind, but never "auto".
    names : sequence of str
        Of the markers; ArUco markers are named by their id: "id7".
    size_mm : float or None
        Diameter of a dot, side of an ArUco marker.
    dictionary : str or None
        Of ArUco markers.
    any_dictionary : bool
        Where no dictionary is given, take DICT_4X4_50: for markers that are not printed yet.
    gray_levels : tuple of float
        Foreground (dot, black cells) and background (card), in counts.
    """
    printed = MARKER_KINDS.get(kind)
    if printed is None or printed.artwork is None:
        printable = " or ".join(
            repr(name) for name, known in MARKER_KINDS.items() if known.artwork is not None
        )
        return f"markers.kind: expected {printable} to render markers, found {kind!r}"
    if size_mm is None:
        return "to render markers, markers.size_mm is needed"
    if dictionary in (None, "auto"):
        if printed.artwork.shape == "code" and not any_dictionary:
            return "to render ArUco markers, markers.dictionary is needed"
        dictionary = _DEFAULT_DICTIONARY
    render = _RENDERED[printed.artwork.shape]
    try:
        return tuple(render(printed, name, size_mm, str(dictionary), gray_levels) for name in names)
    except ValueError as error:
        return f"the markers cannot be rendered: {error}"

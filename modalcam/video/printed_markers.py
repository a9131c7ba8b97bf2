"""Prints with which the renderer films each kind of marker."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from sim.render.markers import ArucoMarker, DotMarker, Marker

_DEFAULT_DICTIONARY = "DICT_4X4_50"


@dataclass(frozen=True)
class PrintedKind:
    """A kind of marker that can be rendered.

    Attributes
    ----------
    make : callable
        Marker from marker name, size in mm, dictionary, and gray levels of foreground and background.
    gray_percentiles : tuple of float
        Percentiles of the gray levels inside a filmed marker that are its foreground and its background.
    """

    make: Callable[[str, float, str, float, float], Marker]
    gray_percentiles: tuple[float, float]


def _dot(_name: str, size_mm: float, _dictionary: str, foreground: float, _background: float) -> Marker:
    return DotMarker(diameter_mm=size_mm, foreground=foreground)


def _aruco(name: str, size_mm: float, dictionary: str, foreground: float, background: float) -> Marker:
    marker_id = int(name.removeprefix("id"))
    return ArucoMarker(
        dictionary=dictionary,
        marker_id=marker_id,
        size_mm=size_mm,
        foreground=foreground,
        background=background,
    )


PRINTED_KINDS = {
    "aruco": PrintedKind(_aruco, gray_percentiles=(5.0, 95.0)),
    "blob": PrintedKind(_dot, gray_percentiles=(50.0, 50.0)),
}


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
    printed = PRINTED_KINDS.get(kind)
    if printed is None:
        return f"markers.kind: expected {' or '.join(map(repr, PRINTED_KINDS))} to render markers, found {kind!r}"
    if size_mm is None:
        return "to render markers, markers.size_mm is needed"
    if dictionary in (None, "auto"):
        if kind == "aruco" and not any_dictionary:
            return "to render ArUco markers, markers.dictionary is needed"
        dictionary = _DEFAULT_DICTIONARY
    try:
        return tuple(printed.make(name, size_mm, str(dictionary), *gray_levels) for name in names)
    except ValueError as error:
        return f"the markers cannot be rendered: {error}"

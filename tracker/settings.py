"""Settings of the tracker for one recording; everything is optional."""

from __future__ import annotations

import difflib
import re
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from tracker.geometry import Lens, time_axis
from tracker.settings_base import Finite, Fps, Length, NonNegative, Options, Point, Positive, Settings


@dataclass(frozen=True)
class Tuning:
    """Limits of settings."""

    #: [characters] of a marker
    #: convention: names become headings of tables and labels in files of other programs
    longest_name: int = 24
    #: [px] side of a patch
    #: measurement: learning a template takes 2.3 kB for each px^2 of the window (from 480 to 1280 px): 0.6 GB, and 12 s
    largest_patch_px: float = 500.0


TUNING = Tuning()

ClampSide = Literal["top", "bottom", "left", "right"]
PatchShape = Literal["square", "round"]
LineFeature = Literal["strip", "edge", "auto"]
_NAME = re.compile(rf"[A-Za-z](?:[A-Za-z0-9 _.-]{{0,{TUNING.longest_name - 2}}}[A-Za-z0-9_.-])?")


def _kind(value: object) -> str:
    if value != "auto":
        # Detectors are slow to load, and few recordings name a kind.
        from tracker.markers import marker_kind  # noqa: PLC0415

        marker_kind(str(value))
    return str(value)


def _known_kinds(schema: dict[str, Any]) -> None:
    """Complete the JSON schema of `kind` with the registered kinds, from which the documentation is generated."""
    from tracker.markers import AUTO, MARKER_KINDS  # noqa: PLC0415

    schema["enum"] = [*MARKER_KINDS, AUTO]


def _dictionary(value: object) -> str:
    if value == "auto":
        return "auto"
    # OpenCV is slow to load, and few recordings name a dictionary.
    from tracker.markers import dictionary_names  # noqa: PLC0415

    names = dictionary_names()
    if value not in names:
        close = ", ".join(difflib.get_close_matches(str(value), names) or names[:3])
        msg = f"expected an ArUco dictionary of OpenCV such as {close}, or auto; found {value!r}"
        raise ValueError(msg)
    return str(value)


def _distinct(positions: tuple[float, ...]) -> tuple[float, ...]:
    if len(set(positions)) != len(positions):
        msg = f"positions must differ from each other, found {positions}"
        raise ValueError(msg)
    return positions


def _marker_names(names: tuple[str, ...]) -> tuple[str, ...]:
    if len(set(names)) != len(names):
        msg = f"names must differ from each other, found {names}"
        raise ValueError(msg)
    bad = next((name for name in names if not _NAME.fullmatch(name)), None)
    if bad is not None:
        msg = (
            f"expected a name of up to {TUNING.longest_name} letters, digits, spaces, '_', '-' and '.', which begins "
            f"with a letter; found {bad!r}"
        )
        raise ValueError(msg)
    return names


class CameraOptions(Options):
    """Camera: recorded rate, scale and exposure."""

    fps: Fps | None = Field(
        default=None,
        description="Frame rate at which the scene was RECORDED; it overrides the rate in the file. The rate in the "
        "file is usually the playback rate.",
        examples=[1000.0],
    )
    fps_tolerance_ppm: Annotated[float, Field(ge=0.0, le=time_axis.TUNING.max_rate_sd_ppm)] | None = Field(
        default=None,
        description="Relative standard deviation of the frame rate in parts per million, part of the interval of every "
        "frequency. Without it: 0 for a given fps and for a table, 50 for the rate of a camera's header, 1000 for the "
        "rate or the time stamps of another file.",
        examples=[20.0],
    )
    mm_per_px: Length | None = Field(
        default=None,
        description="Scale in the plane of the beam. Without it, it is determined from size_mm or positions_mm.",
        examples=[1.0],
    )
    sd_mm_per_px: Length | None = Field(
        default=None, description="Standard deviation of mm_per_px, if known.", examples=[0.002]
    )
    exposure_s: Positive | None = Field(
        default=None,
        description="Exposure time of a frame. Without it, it is estimated from the motion blur of markers that move "
        "by more than a pixel between frames.",
        examples=[0.0005],
    )
    readout_s: Finite | None = Field(
        default=None,
        description="Rolling shutter: time from the exposure of the first row to that of the last; negative when rows "
        "are read from the bottom up.",
        examples=[0.0],
    )


class MarkerOptions(Options):
    """Markers: their kind, size and position on the beam."""

    kind: Annotated[str, BeforeValidator(_kind)] = Field(
        default="auto",
        description='Kind of marker: "aruco" (printed codes), "blob" (round dots), "patch" (image regions at '
        'points_px, no marker needed), "line" (the beam itself, or an edge, along line_px, no marker needed), or '
        '"auto" (the first of the others that is detected).',
        json_schema_extra=_known_kinds,
    )
    dictionary: Annotated[str, BeforeValidator(_dictionary)] = Field(
        default="auto", description='Name of an OpenCV ArUco dictionary such as DICT_4X4_50, or "auto".'
    )
    size_mm: Length | None = Field(
        default=None,
        description="Side of an ArUco marker (outer edge of its black border), or diameter of a dot.",
        examples=[12.0],
    )
    size_px: Annotated[Positive, Field(le=TUNING.largest_patch_px)] | None = Field(
        default=None,
        description="Side or diameter of the window of a patch; chosen from the local texture when not given.",
        examples=[31.0],
    )
    patch_shape: PatchShape = Field(
        default="square",
        description='Shape of the window of a patch: "square", or "round" for a round object in front of a background '
        "that does not move with it.",
    )
    positions_mm: Annotated[tuple[NonNegative, ...], AfterValidator(_distinct)] | None = Field(
        default=None,
        description="Distance of each marker from the clamp, in order along the beam; for ArUco in order of id; of "
        "both ends of a line.",
        examples=[[2.0, 90.0, 190.0, 290.0, 390.0, 490.0]],
    )
    plane_mm: tuple[Point, ...] | None = Field(
        default=None,
        description="Oblique view: position of each marker at rest in the plane of motion, x right and y up, in the "
        "order of positions_mm; four or more markers, not on one line.",
        examples=[[[0.0, 0.0], [200.0, 0.0], [200.0, 150.0], [0.0, 150.0]]],
    )
    points_px: tuple[Point, ...] | None = Field(
        default=None,
        description='Centres of the patches in the first frame, for kind "patch".',
        examples=[[[300.0, 120.0]]],
    )
    names: Annotated[tuple[str, ...], AfterValidator(_marker_names)] | None = Field(
        default=None,
        description="Names of the markers, in order along the beam; for ArUco in order of id, for patches in that of "
        "points_px. When not given, they are id0, id1, ... by the code, or m1, m2, ... by the place.",
        examples=[["tip"]],
    )
    line_px: Annotated[tuple[Point, ...], Field(min_length=2, max_length=2)] | None = Field(
        default=None,
        description='Clamped end and free end of the beam in the first frame, to a few px, for kind "line"; of an '
        "end outside the picture, the last visible point. When not given, the line is the thin strip that moves in the "
        "first frames.",
        examples=[[[320.0, 40.0], [325.0, 440.0]]],
    )
    stations: Annotated[int, Field(ge=6, le=1000)] | None = Field(
        default=None,
        description='Number of stations along the line, for kind "line"; one for each 5 px, at most 200, when not '
        "given.",
        examples=[100],
    )
    feature: LineFeature = Field(
        default="auto",
        description='What is followed along line_px: "strip" (a thin beam, dark or light on both sides), "edge" (one '
        'edge of a structure), or "auto".',
    )
    reference: tuple[str, ...] = Field(
        default=(),
        description="Names of markers that do not move: their motion is that of the camera and is subtracted from the "
        "displacement of the others.",
        examples=[["m1"]],
    )
    input: tuple[str, ...] = Field(
        default=(),
        description="Names of markers on the clamp: their motion is the measured input that drives the others, and the "
        "modes are those of the response to it. The motion may then be anything, such as a sweep or shaking by hand.",
        examples=[["m1"]],
    )
    leave_out_px: tuple[Annotated[tuple[Point, ...], Field(min_length=2, max_length=2)], ...] = Field(
        default=(),
        description="Regions in which no markers are sought, each by two opposite corners: reflections, scales, codes "
        "that are not on the beam. Patches may lie in them.",
        examples=[[[[0.0, 0.0], [120.0, 60.0]]]],
    )
    clamp_side: ClampSide | None = Field(
        default=None,
        description="Side of the image at which the beam is clamped; it determines the order of dots.",
        examples=["top"],
    )


class TrackerSettings(MarkerOptions, CameraOptions, Settings):
    """All settings of one recording.

    Raises
    ------
    ValueError
        For a value out of range, an unknown name, or settings that contradict each other.
    """

    lens: Lens | None = Field(
        default=None, description="Distortion of the camera's lens, from a calibration."
    )

    @model_validator(mode="after")
    def _kind_has_its_settings(self) -> Any:
        if self.kind != "auto":
            from tracker.markers import marker_kind  # noqa: PLC0415 - as above

            missing = marker_kind(self.kind).missing_setting(self)
            if missing is not None:
                raise ValueError(missing)
        return self

"""The beam itself as the marker: stations along its line, or along an edge of any structure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from tracker.arrays import FloatArray, GrayImage
from tracker.checks import Failure
from tracker.markers.kind import (
    Detection,
    DetectionSettings,
    FoundMarkers,
    JointCalibration,
    MarkerDetector,
    MarkerKind,
    NothingFound,
)

if TYPE_CHECKING:
    from tracker.line import LineModel


@dataclass(frozen=True)
class Tuning:
    """Ends of a line."""

    #: [px] of a line
    #: physics: six stations of 5 px
    least_length_px: float = 30.0
    #: [px] sd along the line of an end that is seen in the first frame
    #: measurement: 0.07 px of ten drawn strips
    seen_sd_px: float = 0.1
    #: [px] the same of one given by hand
    #: convention: a click
    given_sd_px: float = 1.0


TUNING = Tuning()

EXPOSURE_UNKNOWN = (
    "The line moves by more than a px between frames, and exposure_s is not given: set it, or the sd of fast "
    "motion may be too small and its strip may not be recognised."
)


@dataclass(frozen=True)
class LineMarkers:
    """Stations of a line, to be calibrated; see `tracker.line.calibrate.calibrate_line`."""

    kind: LineKind
    ends_px: FloatArray
    stations: int | None
    feature: Literal["strip", "edge", "auto"]
    positions_mm: tuple[float, ...] | None
    mm_per_px: float | None

    def calibrated(
        self, images: list[GrayImage], camera: FloatArray, exposure_share: float | None, *, lossy: bool
    ) -> JointCalibration | NothingFound:
        """Stations s1, s2, ... from the clamp."""
        # The kernels are slow to load, and most recordings have another kind of marker.
        from tracker.line import (  # noqa: PLC0415
            LineFollower,
            LineModel,
            calibrate_line,
            line_sd_factor,
        )

        model = calibrate_line(
            images,
            self.ends_px,
            camera,
            stations=self.stations,
            feature=self.feature,
            exposure_share=exposure_share or 0.0,
        )
        if not isinstance(model, LineModel):
            return NothingFound(model.reason)
        count = model.line.stations
        factor = line_sd_factor(images, model) if lossy else 1.0
        what = "an edge" if model.feature == "edge" else f"a strip of {model.width_px:.1f} px width"
        note = (
            f"The line is {what}, {model.length_px:.0f} px long, followed at {count} stations from the clamp: only "
            "their displacement across it is measured."
        )
        notes = [note, _ends_note(model)]
        if exposure_share is None and model.largest_step_px > 1.0:
            notes.append(EXPOSURE_UNKNOWN)
        positions_mm = self._positions_mm(model)
        mm_per_px = abs(positions_mm[-1] - positions_mm[0]) / np.ptp(model.from_clamp_px)
        clamp_sd_px, tip_sd_px = _ends_sd_px(model)
        return JointCalibration(
            LineFollower(model),
            tuple(self.kind.marker_name(k) for k in range(count)),
            positions_mm,
            np.full((2, count), factor),
            tuple(notes),
            (float(clamp_sd_px * mm_per_px), float(tip_sd_px * mm_per_px)),
        )

    def _positions_mm(self, model: LineModel) -> FloatArray:
        """Distance of each station from the clamp along the beam."""
        share = model.from_clamp_px / model.length_px
        if self.positions_mm is not None:
            return np.asarray(self.positions_mm[0] + share * (self.positions_mm[1] - self.positions_mm[0]))
        return np.asarray(model.from_clamp_px * (self.mm_per_px or np.nan))


def _ends_sd_px(model: LineModel) -> list[float]:
    return [TUNING.seen_sd_px if seen else TUNING.given_sd_px for seen in model.ends_seen]


def _ends_note(model: LineModel) -> str:
    """How well the distances of the stations from the clamp are known."""
    sd_px = _ends_sd_px(model)
    where = ["where the strip is seen to end" if seen else "as given" for seen in model.ends_seen]
    which = (
        f"Both ends are {where[0]}"
        if where[0] == where[1]
        else f"The clamp is {where[0]}, the free end {where[1]}"
    )
    return (
        f"{which}: distances along the line are known to {sd_px[0]:.1f} px at the clamp and {sd_px[1]:.1f} px at the "
        f"free end, its length to {np.linalg.norm(sd_px):.1f} px."
    )


class LineDetector:
    """The line between given ends, or the one that moves."""

    def __init__(self, kind: LineKind, settings: DetectionSettings) -> None:
        self._kind, self._settings = kind, settings

    def detect(self, frames: list[GrayImage]) -> FoundMarkers | NothingFound:
        """The line, to be calibrated."""
        from tracker.line import find_line  # noqa: PLC0415 - as above

        settings, (height, width) = self._settings, frames[0].shape
        if settings.positions_mm is not None and len(settings.positions_mm) != 2:
            return NothingFound(
                f"positions_mm has {len(settings.positions_mm)} entries; for a line give two, the distances of "
                "the ends in line_px from the clamp along the beam"
            )
        if settings.line_px is None:
            found = find_line(frames)
            if isinstance(found, Failure):
                return NothingFound(
                    f"no line was found by its motion: {found.reason}; set line_px to the clamped end and the free end "
                    "of the beam in the first frame"
                )
            (x0, y0), (x1, y1) = found
            note = (
                f"line_px was not given: the strip that moves reaches from its clamp at ({x0:.0f}, {y0:.0f}) to its "
                f"free end at ({x1:.0f}, {y1:.0f}); check this, and set line_px if it is wrong."
            )
            return FoundMarkers((), (note,), joint=self._markers(found))
        ends = np.array(settings.line_px)
        outside = [p for p in settings.line_px if not (0 <= p[0] <= width - 1 and 0 <= p[1] <= height - 1)]
        if outside:
            return NothingFound(
                f"line_px {outside[0]} lies outside the image of {width} x {height} px (x right, y down); give "
                "the last visible point of the line"
            )
        length = float(np.linalg.norm(ends[1] - ends[0]))
        if length < TUNING.least_length_px:
            return NothingFound(
                f"line_px is {length:.0f} px long; expected at least {TUNING.least_length_px:.0f} px between the "
                "clamped end and the free end"
            )
        return FoundMarkers((), joint=self._markers(ends))

    def _markers(self, ends_px: FloatArray) -> LineMarkers:
        settings = self._settings
        return LineMarkers(
            self._kind,
            ends_px,
            settings.stations,
            settings.feature,
            settings.positions_mm,
            settings.mm_per_px,
        )

    def redetect(self, image: GrayImage, sought: tuple[Detection, ...]) -> list[Detection]:  # noqa: ARG002 - protocol
        """None: the follower itself searches for the line."""
        return []


class LineKind(MarkerKind):
    """A thin beam seen from its edge, or an edge: nothing is attached to it."""

    name = "line"
    noun = "station"
    follows_line = True
    has_nominal_size = False
    has_outline = False

    def detector(self, settings: DetectionSettings, *, auto: bool) -> MarkerDetector | None:  # noqa: ARG002 - the same
        """The line between the given ends, or the one that moves."""
        return LineDetector(self, settings)

    def missing_setting(self, settings: DetectionSettings) -> str | None:
        """Stations have names of their own."""
        if settings.names is None:
            return None
        return "names are those of separate markers, and the stations of a line are s1, s2, ...: remove names"

    def marker_name(self, rank: int) -> str:
        """Stations are named s1, s2, ... from the clamp."""
        return f"s{rank + 1}"


LINE = LineKind()

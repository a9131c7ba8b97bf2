"""Protocol of a kind of marker: detection, templates, and everything else that differs from kind to kind."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, Protocol, runtime_checkable

import numpy as np
import scipy  # its parts are loaded when they are used

from tracker.arrays import BoolArray, FlagArray, FloatArray, GrayImage
from tracker.checks import Failure
from tracker.template import Template


@dataclass(frozen=True)
class Tuning:
    """Fits of ideal markers, and the contrast of a first fit."""

    #: [1] of a model of an ideal marker in its fit
    #: convention: limits time
    most_evaluations: int = 120
    #: [1] relative change that ends it
    #: convention: far below the noise of its parameters
    tolerance: float = 1e-6
    #: [px] around a marker, within which its contrast is sought
    rim_px: float = 3.0
    #: [%] of the pixels there that are darker than a marker's dark, and lighter than its light
    extreme_percent: float = 10.0


TUNING = Tuning()


class DetectionSettings(Protocol):
    """The fields of `tracker.settings.TrackerSettings` that detectors use."""

    dictionary: str
    size_px: float | None
    patch_shape: Literal["square", "round"]
    positions_mm: tuple[float, ...] | None
    points_px: tuple[tuple[float, float], ...] | None
    names: tuple[str, ...] | None
    line_px: tuple[tuple[float, float], ...] | None
    stations: int | None
    feature: Literal["strip", "edge", "auto"]
    mm_per_px: float | None
    reference: tuple[str, ...]
    input: tuple[str, ...]
    leave_out_px: tuple[tuple[tuple[float, float], ...], ...]
    clamp_side: Literal["top", "bottom", "left", "right"] | None


@dataclass(frozen=True)
class Detection:
    """A detected marker: accurate enough to start the registration.

    Attributes
    ----------
    frame : int
        Index of the frame, among those given, in which it was detected.
    x_px, y_px : float
        Centre, to about a pixel.
    warp : array, shape (2, 2)
        From the image to the marker's own frame, in px.
    size_px : float
        Side of a marker, diameter of a dot, side of a patch's window.
    template : Template
        First image of the marker; values from 0 (dark) to 1 (light), or gray levels for a patch.
    position_mm : float
        Distance from the clamp; NaN where unknown.
    path_px : array, shape (n, 2), or None
        Centres in the frames given, to about a pixel, NaN where unknown; None where the marker can be followed from
        frame to frame.
    first_px : tuple of float, or None
        Centre in the first of the frames given, where it was found there too.
    """

    name: str
    kind: MarkerKind
    frame: int
    x_px: float
    y_px: float
    warp: FloatArray
    size_px: float
    template: Template
    position_mm: float = float("nan")
    path_px: FloatArray | None = None
    first_px: tuple[float, float] | None = None

    def earliest(self) -> tuple[int, float, float]:
        """Frame and centre: those of the first frame where it was found there, so that markers belong together."""
        if self.first_px is None:
            return self.frame, self.x_px, self.y_px
        return 0, *self.first_px

    @property
    def code(self) -> str:
        """What the marker itself states, such as the number of a code and its dictionary; empty where it has none."""
        return ""

    def at(self, centre_px: FloatArray) -> Detection:
        """The same marker at another position."""
        return replace(self, x_px=float(centre_px[0]), y_px=float(centre_px[1]))


@dataclass(frozen=True)
class FoundMarkers:
    """Markers in order along the beam where that is known, and notes for the user.

    ``rejected`` lists what was read as a marker and rejected, each with the reason. ``joint`` replaces the detections
    for a kind whose markers are registered together instead of each with a template.
    """

    detections: tuple[Detection, ...]
    notes: tuple[str, ...] = ()
    rejected: tuple[str, ...] = ()
    joint: JointMarkers | None = None


@dataclass(frozen=True, eq=False)
class NothingFound(Failure):
    """No markers, or not the expected ones.

    ``seen_px``, shape (c, 2), holds the positions of candidates in the first frame; ``rejected`` is
    that of `FoundMarkers`.
    """

    seen_px: FloatArray | None = None
    rejected: tuple[str, ...] = ()


class FrameResult(Protocol):
    """Result of one frame for m markers."""

    @property
    def marks(self) -> FlagArray:
        """Bits of `tracker.flags`, shape (m,)."""

    @property
    def out(self) -> FloatArray:
        """x, y and their sd in px, shape (4, m); NaN where missing."""

    @property
    def correlation(self) -> FloatArray | None:
        """Of the errors of x and y, shape (m,); None, in each frame, for a kind whose errors are independent."""


class FrameFollower(Protocol):
    """Follows the markers of a recording from frame to frame."""

    @property
    def markers(self) -> int:
        """Number of markers."""

    def step(self, image: GrayImage) -> FrameResult:
        """Positions in the next frame; they may still change until the frame after it, or `finish`."""

    def missing(self, flag: int) -> FrameResult:
        """Result of a frame without image."""

    def finish(self) -> None:
        """Complete the last frame."""


@dataclass(frozen=True)
class JointCalibration:
    """Markers that are followed together, ready to follow.

    ``sd_factors`` (2, m) are factors on the sd of x and y from the spatial correlation of compression errors;
    ``ends_sd_mm`` is the sd of the clamped end and of the free end along the beam, to which `positions_mm` refer.
    """

    follower: FrameFollower
    names: tuple[str, ...]
    positions_mm: FloatArray
    sd_factors: FloatArray
    notes: tuple[str, ...]
    ends_sd_mm: tuple[float, float]


class JointMarkers(Protocol):
    """Markers of a kind that registers all of them together."""

    @property
    def kind(self) -> MarkerKind:
        """Their kind."""

    def calibrated(
        self, images: list[GrayImage], camera: FloatArray, exposure_share: float | None, *, lossy: bool
    ) -> JointCalibration | NothingFound:
        """Calibrate on consecutive first frames.

        `camera` holds the variance a + b I of a pixel of intensity I and the level of saturation; the exposed share of
        the time between frames is None where the exposure is unknown.
        """


class MarkerDetector(Protocol):
    """Detects the markers of one recording."""

    def detect(self, frames: list[GrayImage]) -> FoundMarkers | NothingFound:
        """Markers of a recording, from its first good frames."""

    def redetect(self, image: GrayImage, sought: tuple[Detection, ...]) -> list[Detection]:
        """Those of `sought` that are visible in one frame, with their names; ambiguous candidates are omitted."""


@dataclass(frozen=True)
class Candidates:
    """Everything in a part of an image that looks like a marker: centres, shape (c, 2), px.

    ``corners_px``, shape (2, 2), are the smallest and the largest x, y at which a marker would have been found.
    """

    centres_px: FloatArray
    corners_px: FloatArray


@runtime_checkable
class SimilarMarkerDetector(Protocol):
    """Detector of markers that cannot be told from each other: the tracker assigns its candidates jointly."""

    def candidates(self, image: GrayImage, sought: tuple[Detection, ...]) -> Candidates:
        """All candidates in one frame around `sought`, whichever marker they may be."""


@dataclass(frozen=True)
class IdealFit:
    """A parametric template, of values from 0 (dark) to 1 (light), fitted to an image of a marker.

    `matrix` leads from the frame of the fitted image to the ideal marker's frame, whose centre is at `centre_uv` px;
    `dark` and `light` are the gray levels of the template's 0 and 1 in the fitted image.
    """

    template: Template
    matrix: FloatArray
    centre_uv: FloatArray
    dark: float
    light: float
    size_px: float


def fitted(
    residual: Callable[[FloatArray], FloatArray], start: FloatArray, scales: Sequence[float]
) -> FloatArray:
    """Parameters of an ideal marker by least squares (Levenberg and Marquardt), each of about the size of its scale."""
    found = scipy.optimize.least_squares(
        residual,
        start,
        method="lm",
        x_scale=scales,
        max_nfev=TUNING.most_evaluations,
        ftol=TUNING.tolerance,
        xtol=TUNING.tolerance,
    )
    return np.asarray(found.x)


def part_around(
    image: GrayImage, x_px: float, y_px: float, reach_px: float, *, beyond: int = 1
) -> tuple[GrayImage, int, int]:
    """Part of an image within reach of a place, and the x and y of its first pixel."""
    left, top = max(int(x_px - reach_px), 0), max(int(y_px - reach_px), 0)
    return image[top : int(y_px + reach_px) + beyond, left : int(x_px + reach_px) + beyond], left, top


@dataclass(frozen=True)
class Artwork:
    """How the markers of a kind are rendered: as discs, or as codes of an ArUco dictionary with the marker's number.

    The percentiles are those of the gray levels inside a filmed marker that are its foreground and its background.
    """

    shape: Literal["disc", "code"]
    gray_percentiles: tuple[float, float]


class MarkerKind(Protocol):
    """One kind of marker; a kind subclasses this protocol and overrides what differs.

    Attributes
    ----------
    name : str
        Value of ``kind`` in the settings.
    auto_rank : int or None
        Rank among the kinds that "auto" tries; None for a kind that must be named.
    is_sought : bool
        Whether its markers are sought in the picture, but for regions to leave out; otherwise the user sets each.
    learning_rounds : int
        Rounds of registering and learning: more where the first template is a noisy image.
    angle_while_learning : bool
        Whether the angle is fitted during calibration.
    can_have_angle : bool
        Whether the angle is fitted afterwards, where the template determines it.
    noun : str
        What one of them is called.
    takes_points : bool
        Whether ``points_px`` set its markers.
    follows_line : bool
        Whether its markers are stations of one line, registered together and each measured across the line only.
    has_nominal_size : bool
        Whether ``size_mm`` refers to this kind and gives a scale.
    has_outline : bool
        Whether the marker's extent is known; otherwise its window may contain background, found because it rests.
    has_nominal_shape : bool
        Whether the undistorted shape is known, so that a fitted template gives the obliquity of the view.
    decodes_shape : bool
        Whether redetection identifies each marker with certainty and measures its warp, rotation included.
    largest_learned_px : float
        Above this size the template is fitted to one frame (`fit_pixels`) and not learned.
    artwork : Artwork or None
        How the markers are rendered; None for a kind that is not printed.
    """

    name: ClassVar[str]
    auto_rank: ClassVar[int | None] = None
    is_sought: ClassVar[bool] = True
    learning_rounds: ClassVar[int] = 2
    angle_while_learning: ClassVar[bool] = False
    can_have_angle: ClassVar[bool] = True
    noun: ClassVar[str] = "marker"
    takes_points: ClassVar[bool] = False
    follows_line: ClassVar[bool] = False
    has_nominal_size: ClassVar[bool] = True
    has_outline: ClassVar[bool] = True
    has_nominal_shape: ClassVar[bool] = False
    decodes_shape: ClassVar[bool] = False
    largest_learned_px: ClassVar[float] = float("inf")
    artwork: ClassVar[Artwork | None] = None

    def detector(self, settings: DetectionSettings, *, auto: bool) -> MarkerDetector | None:
        """Detector for one recording; None where "auto" (`auto`) should skip this kind with these settings."""

    def missing_setting(self, settings: DetectionSettings) -> str | None:  # noqa: ARG002 - for kinds that need one
        """Why the kind cannot be used with these settings, or None."""
        return None

    def covers(self, u: FloatArray, v: FloatArray, half_u: float, half_v: float) -> BoolArray:
        """Points (u, v) within a marker of these half sizes: its outline, a rectangle unless overridden."""
        return np.asarray((np.abs(v) <= half_v) & (np.abs(u) <= half_u))

    def core_half_px(self, size_px: float) -> float:
        """Half size of the core: the part of the learned template that is never removed from its support."""
        return 0.5 * size_px + 1.0

    def start_contrast(self, image: GrayImage, detection: Detection) -> tuple[float, float]:
        """Gain and offset for the first fit: from the brightness around the detection unless overridden."""
        half = 0.5 * detection.size_px + TUNING.rim_px
        part, _, _ = part_around(image, detection.x_px, detection.y_px, half, beyond=2)
        levels = TUNING.extreme_percent, 100.0 - TUNING.extreme_percent
        dark, light = np.percentile(part, levels) if part.size else (0.0, 1.0)
        return max(float(light - dark), 1.0), float(dark)

    def fit_learned(self, detection: Detection, learned: Template) -> IdealFit | None:  # noqa: ARG002 - optional
        """Parametric template of this kind fitted to a learned one; None where there is none or the fit failed."""
        return None

    def fit_pixels(self, detection: Detection, points_uv: FloatArray, gray: FloatArray) -> IdealFit | None:  # noqa: ARG002 - optional
        """Parametric template fitted to gray levels at points of shape (2, n) in the marker's frame, or None."""
        return None

    def marker_name(self, rank: int) -> str:
        """Name of the marker at this rank along the beam, from 0."""
        return f"m{rank + 1}"

    def marker_rank(self, name: str) -> int | None:
        """Rank of the marker with this name, from 0; None for a name that the user has given."""
        digits = "".join(filter(str.isdigit, name))
        ranks = (int(digits), int(digits) - 1) if digits else ()
        return next((rank for rank in ranks if self.marker_name(rank) == name), None)

"""Patches: image regions chosen by the user and tracked by their own texture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from tracker.arrays import BoolArray, FloatArray, GrayImage
from tracker.markers.kind import (
    Detection,
    DetectionSettings,
    FoundMarkers,
    MarkerDetector,
    MarkerKind,
    NothingFound,
)
from tracker.template import from_values


@dataclass(frozen=True)
class Tuning:
    """Windows of patches."""

    #: [px] sd that the stronger gradient of the smallest window gives, with a noise of one gray level in 256
    #: convention: about that of a code of 24 px
    wanted_sd_px: float = 0.0025
    #: [gray levels] of 256, without which there is nothing to track
    least_texture: float = 4.0
    #: [1] of that information along the weaker gradient
    #: convention: a bare edge gets a window that includes its ends
    weak_share: float = 0.1


TUNING = Tuning()

SIZES_PX = (31, 41, 51, 61)


class PatchDetector:
    """Windows around given points of the first frame; without a `size_px` the smallest with enough texture."""

    def __init__(
        self,
        points_px: tuple[tuple[float, float], ...],
        positions_mm: tuple[float, ...] | None,
        size_px: float | None,
        shape: Literal["square", "round"] = "square",
        names: tuple[str, ...] | None = None,
    ) -> None:
        self._kind = ROUND_PATCH if shape == "round" else PATCH
        self._points_px = points_px
        self._positions_mm = positions_mm
        self._size_px = size_px
        self._names = names or tuple(map(PATCH.marker_name, range(len(points_px))))

    def detect(self, frames: list[GrayImage]) -> FoundMarkers | NothingFound:
        """Windows in the order of the points."""
        image = frames[0].astype(np.float64)
        height, width = image.shape
        points, positions = self._points_px, self._positions_mm
        if positions is not None and len(positions) != len(points):
            return NothingFound(f"positions_mm has {len(positions)} entries, but points_px has {len(points)}")
        if len(self._names) != len(points):
            return NothingFound(f"names has {len(self._names)} entries, but points_px has {len(points)}")
        outside = [p for p in points if not (0 <= p[0] <= width - 1 and 0 <= p[1] <= height - 1)]
        if outside:
            return NothingFound(
                f"points_px {outside[0]} lies outside the image of {width} x {height} px (x right, y down)"
            )
        detections, notes = [], []
        for k, (x, y) in enumerate(points):
            size = self._size_px or window_size(image, x, y)
            if np.ptp(_window(image, x, y, size)) < TUNING.least_texture * np.ptp(image) / 256.0:
                return NothingFound(
                    f"there is no texture to track around points_px ({x:g}, {y:g}); choose a point with contrast"
                )
            name = self._names[k]
            position_mm = positions[k] if positions else float("nan")
            detections.append(_detection(self._kind, name, x, y, size, image, position_mm))
            window = "round window" if self._kind is ROUND_PATCH else "window"
            notes.append(f"Patch {name} is a {window} of {size:.0f} px around ({x:g}, {y:g}).")
        return FoundMarkers(tuple(detections), tuple(notes))

    def redetect(self, image: GrayImage, sought: tuple[Detection, ...]) -> list[Detection]:  # noqa: ARG002 - protocol
        """None: a patch has no identity beyond its template, which the follower itself searches for."""
        return []


def window_size(image: FloatArray, x_px: float, y_px: float) -> float:
    """Side of the smallest window whose gradients suffice in both directions, else of the largest.

    The larger eigenvalue of the structure tensor must give `TUNING.wanted_sd_px`, the smaller one a tenth of that
    information, so that a bare edge gets a window that includes its ends.
    """
    noise = max(np.ptp(image) / 256.0, 1e-9)
    for size in SIZES_PX:
        patch = _window(image, x_px, y_px, size)
        if min(patch.shape) < 5:
            continue
        down, across = np.gradient(patch)
        tensor = np.array(
            [[np.sum(across**2), np.sum(across * down)], [np.sum(across * down), np.sum(down**2)]]
        )
        weak, strong = np.linalg.eigvalsh(tensor / noise**2)
        if strong > TUNING.wanted_sd_px**-2 and weak > TUNING.weak_share * strong:
            return float(size)
    return float(SIZES_PX[-1])


def _window(image: FloatArray, x_px: float, y_px: float, size_px: float) -> FloatArray:
    half = 0.5 * size_px
    top, left = max(round(y_px - half), 0), max(round(x_px - half), 0)
    return image[top : round(y_px + half) + 1, left : round(x_px + half) + 1]


def _detection(
    kind: PatchKind,
    name: str,
    x_px: float,
    y_px: float,
    size_px: float,
    image: FloatArray,
    position_mm: float,
) -> Detection:
    """The first template consists of the frame's own pixels around the nearest pixel centre."""
    column, row = round(x_px), round(y_px)
    half = round(0.5 * size_px)
    margin = half + 3
    padded = np.pad(image, margin, mode="edge")
    patch = padded[row : row + 2 * margin + 1, column : column + 2 * margin + 1]
    axis = np.arange(-margin, margin + 1, dtype=np.float64)
    support = kind.covers(axis[None, :], axis[:, None], half, half)
    template = from_values(patch, support.astype(np.uint8), 1.0)
    return Detection(
        name, kind, 0, float(column), float(row), np.eye(2), float(size_px), template, position_mm
    )


class PatchKind(MarkerKind):
    """Image regions without a marker: the template is learned from the texture itself."""

    name = "patch"
    auto_rank = 2
    is_sought = False
    takes_points = True
    # The first template is one noisy image.
    learning_rounds = 4
    has_nominal_size = False
    has_outline = False

    def detector(self, settings: DetectionSettings, *, auto: bool) -> MarkerDetector | None:  # noqa: ARG002 - the same
        """Windows around the given points; None without points."""
        if not settings.points_px:
            return None
        return PatchDetector(
            settings.points_px, settings.positions_mm, settings.size_px, settings.patch_shape, settings.names
        )

    def missing_setting(self, settings: DetectionSettings) -> str | None:
        """Patches need their centres."""
        if settings.points_px:
            return None
        return "kind 'patch' tracks points that you give: set points_px to their centres in the first frame"

    def core_half_px(self, size_px: float) -> float:
        """The inner half of the window."""
        return 0.25 * size_px

    def start_contrast(self, image: GrayImage, detection: Detection) -> tuple[float, float]:  # noqa: ARG002 - known
        """The first template is in gray levels already."""
        return 1.0, 0.0


class RoundPatchKind(PatchKind):
    """Patches with a round window: the corners of a square would hold the background of a round object."""

    def covers(self, u: FloatArray, v: FloatArray, half_u: float, half_v: float) -> BoolArray:
        """Points within the ellipse."""
        return np.asarray(np.hypot(u / max(half_u, 1e-9), v / max(half_v, 1e-9)) <= 1.0)


PATCH, ROUND_PATCH = PatchKind(), RoundPatchKind()

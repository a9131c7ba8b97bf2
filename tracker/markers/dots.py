"""Round dots, dark on light or light on dark, along a beam."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from tracker.arrays import BoolArray, FloatArray, GrayImage
from tracker.markers.assignment import ClampSide, matching_subset, order_along_beam
from tracker.markers.kind import (
    Artwork,
    Candidates,
    Detection,
    DetectionSettings,
    FoundMarkers,
    IdealFit,
    MarkerDetector,
    MarkerKind,
    NothingFound,
    fitted,
    part_around,
)
from tracker.markers.proposals import TUNING as MOTION
from tracker.markers.proposals import spot_motion, spot_paths, still_and_beside, stillest_frame
from tracker.markers.spots import Spot, find_spots, gray_level, largest_group, similar_spots
from tracker.template import Template, disc_template, disc_values, step_response
from tracker.template import template as templates


@dataclass(frozen=True)
class Tuning:
    """Dots: their ideal template, and where they are sought."""

    #: [pixels] of a large dot to which its ideal template is fitted
    #: convention: limits time
    points_for_shape: int = 4000
    #: [1] in diameters, of a fitted disc that is the dot
    #: convention: twice that of the dot as detected
    largest_radius: float = 1.0
    #: [1] in diameters, radius beyond which a fit is not followed
    #: convention: what is no dot may pull the radius to any size, and the time of a disc grows with its cube
    beyond: float = 1.5
    #: [px] within which dots are sought about where they are expected, at least
    reach_px: float = 80.0
    #: [1] the same in diameters
    reach_diameters: float = 4.0
    #: [1] the same in spacings
    #: convention: beyond it the next dot is nearer
    reach_spacings: float = 1.25
    #: [1] difference of the dots' gray levels from which they are sought at three levels
    uneven: float = 0.15
    #: [1] in diameters, of a fitted disc that is the dot
    least_radius: float = 0.25
    #: [1] in diameters from its centre, where a learned dot has its own gray level
    core: float = 0.25
    #: [1] the same of a large dot
    large_core: float = 0.3
    #: [1] in diameters, beyond which a large dot has that of its surroundings
    large_rim: float = 0.55
    #: [1] of the radius, of the lens blur of a large dot
    largest_blur: float = 0.3
    #: [1] around a dot, within which it is detected again in its sharpest frame
    part_diameters: float = 2.0
    #: [px] that are added to it
    part_px: float = 8.0
    #: [px] of this part that must be in the image
    least_part_px: int = 16
    #: [1] diameter there over that in the first frame, at least
    least_change: float = 0.6
    #: [1] and at most
    most_change: float = 1.5
    #: [spots] of which those with the spacing of positions_mm are chosen
    #: convention: limits time
    most_candidates: int = 60


TUNING = Tuning()


class DotDetector:
    """Detects round dots along a beam, exactly as many as there are `positions_mm`, where given.

    With `keep_still`, dots that stand still beside the moving ones may be markers: references of a shaking camera.
    """

    def __init__(
        self,
        positions_mm: tuple[float, ...] | None,
        clamp_side: ClampSide | None,
        *,
        keep_still: bool = False,
        kind: MarkerKind | None = None,
    ) -> None:
        self._kind = kind or DOT
        self._positions_mm = positions_mm
        self._clamp_side = clamp_side
        self._keep_still = keep_still
        self._light, self._size_px, self._levels = False, 0.0, np.empty(0)
        self._others_px = np.empty((0, 2))

    def detect(self, frames: list[GrayImage]) -> FoundMarkers | NothingFound:
        """Dots of the first frame, named m1, m2, ... from the clamp outwards."""
        spots = find_spots(frames[0])
        group = largest_group(spots)
        if not group:
            seen = _centres(spots) if spots else None
            return NothingFound("no round dot of 5 to 200 px was detected in the first frame", seen_px=seen)
        positions_mm = self._positions_mm
        chosen, notes = self._without_background(frames, spots, group)
        if chosen is None:
            return NothingFound(self._wrong_count(spots, group), seen_px=_centres(group))
        beam = order_along_beam(_centres(chosen), positions_mm, self._clamp_side)
        positions = sorted(positions_mm) if positions_mm is not None else [float("nan")] * len(chosen)
        self._remember(frames, spots, chosen)
        diameters = np.array([s.diameter_px for s in chosen])
        paths, joint = spot_paths(frames, _centres(chosen), diameters, self._find)
        detections = [
            _detection(
                self._kind.marker_name(rank), *_at_its_sharpest(frames, chosen[k], paths[k]), positions[rank]
            )
            for rank, k in enumerate(beam.order)
        ]
        detections = [
            replace(d, kind=self._kind, first_px=(chosen[k].x_px, chosen[k].y_px))
            for d, k in zip(detections, beam.order, strict=True)
        ]
        if joint:
            detections = [replace(d, path_px=paths[k]) for d, k in zip(detections, beam.order, strict=True)]
        return FoundMarkers(tuple(detections), (*notes, *beam.notes))

    def _remember(self, frames: list[GrayImage], spots: list[Spot], chosen: list[Spot]) -> None:
        """Store the appearance of the dots, and the positions of still spots that are no markers."""
        self._light, self._size_px = chosen[0].light, float(np.median([s.diameter_px for s in chosen]))
        others = [s for s in spots if s not in chosen]
        if others:
            points = _centres(others)
            motion = spot_motion(frames, points, np.array([s.diameter_px for s in others]))
            self._others_px = points[motion < MOTION.moved_px]
        levels = np.array([gray_level(frames[0], at, self._size_px) for at in _centres(chosen)])
        low, middle, high = np.percentile(levels, (0.0, 50.0, 100.0))
        self._levels = np.array([low, middle, high] if high - low > TUNING.uneven * middle else [middle])

    def _without_background(
        self, frames: list[GrayImage], spots: list[Spot], group: list[Spot]
    ) -> tuple[list[Spot] | None, list[str]]:
        """The markers in a group of similar spots, and notes on the others; None for the wrong number."""
        positions_mm = self._positions_mm
        if positions_mm is not None and len(group) == len(positions_mm):
            return group, _ignored(len(spots) - len(group), "differ in size or colour")
        chosen = self._matching_spacing(spots, group)
        if chosen is not None:
            kept = f"the {len(chosen)} whose spacing fits positions_mm are tracked"
            return chosen, [f"{len(spots)} round spots were detected; {kept}."]
        moving = self._moving(frames, group)
        notes = _ignored(len(group) - len(moving), "stand still beside the moving ones, in the background")
        if self._keep_still or (positions_mm is not None and len(moving) != len(positions_mm)):
            return (group, []) if positions_mm is None else (None, [])
        return moving, [*notes, *_ignored(len(spots) - len(group), "differ in size or colour")]

    def _moving(self, frames: list[GrayImage], group: list[Spot]) -> list[Spot]:
        """The spots without those in the background; with a given number, also without still ones on the line."""
        points, diameters = _centres(group), np.array([s.diameter_px for s in group])
        motion = spot_motion(frames, points, diameters)
        background = still_and_beside(points, diameters, motion)
        kept = [s for s, out in zip(group, background, strict=True) if not out]
        positions_mm = self._positions_mm
        if positions_mm is not None and len(kept) != len(positions_mm):
            moved = [s for s, m in zip(group, motion, strict=True) if m > MOTION.moved_px]
            return moved if len(moved) == len(positions_mm) else kept
        return kept

    def _matching_spacing(self, spots: list[Spot], group: list[Spot]) -> list[Spot] | None:
        if self._positions_mm is None or len(self._positions_mm) < 3:
            return None
        for candidates in (group, spots):
            if len(self._positions_mm) < len(candidates) <= TUNING.most_candidates:
                subset = matching_subset(_centres(candidates), self._positions_mm)
                if subset is not None:
                    return [candidates[k] for k in subset]
        return None

    def _wrong_count(self, spots: list[Spot], group: list[Spot]) -> str:
        where = ", ".join(f"({s.x_px:.0f}, {s.y_px:.0f})" for s in group[:12])
        more = f" and {len(group) - 12} more" if len(group) > 12 else ""
        colour = "light on dark" if group[0].light else "dark on light"
        others = len(spots) - len(group)
        other_text = f"; {others} other round spots differ in size or colour" if others else ""
        return (
            f"positions_mm names {len(self._positions_mm or ())} dots, but {len(group)} similar ones were detected "
            f"({colour}, about {np.median([s.diameter_px for s in group]):.0f} px) at x, y = {where}{more} px"
            f"{other_text}; give one position for each, or crop the image to the beam"
        )

    def redetect(self, image: GrayImage, sought: tuple[Detection, ...]) -> list[Detection]:  # noqa: ARG002 - protocol
        """None: one dot alone cannot be told from another; see `candidates`."""
        return []

    def candidates(self, image: GrayImage, sought: tuple[Detection, ...]) -> Candidates:
        """Similar spots around the expected positions, without those that were no markers in the first frame."""
        return self._find(image, np.array([(s.x_px, s.y_px) for s in sought]))

    def _find(self, image: GrayImage, expected_px: FloatArray) -> Candidates:
        low, high = expected_px.min(axis=0), expected_px.max(axis=0)
        spacing = float(np.hypot(*(high - low))) / max(len(expected_px) - 1, 1)
        reach = max(TUNING.reach_px, TUNING.reach_diameters * self._size_px, TUNING.reach_spacings * spacing)
        last = np.array(image.shape[1::-1]) - 1
        left, top = np.clip(low - reach, 0, last).astype(int)
        right, bottom = np.clip(high + reach, 0, last).astype(int)
        part = image[top : bottom + 1, left : right + 1]
        spots = similar_spots(part, self._size_px, self._levels, light=self._light) + np.array([left, top])
        for other in self._others_px:
            spots = spots[np.hypot(*(spots - other).T) > 0.5 * self._size_px]
        margin = 0.5 * self._size_px + 1.0
        return Candidates(spots, np.array([[left + margin, top + margin], [right - margin, bottom - margin]]))


def _centres(spots: list[Spot]) -> FloatArray:
    return np.array([(s.x_px, s.y_px) for s in spots]).reshape(-1, 2)


def _ignored(count: int, why: str) -> list[str]:
    if count <= 0:
        return []
    return [f"{count} other round {'spot' if count == 1 else 'spots'} {why}: ignored."]


def _at_its_sharpest(frames: list[GrayImage], spot: Spot, path_px: FloatArray) -> tuple[int, Spot]:
    """The frame in which a spot of the first frame is blurred least, and the spot as detected there."""
    frame = stillest_frame(path_px)
    centre = path_px[frame]
    if frame == 0:
        return 0, spot
    half = TUNING.part_diameters * spot.diameter_px + TUNING.part_px
    part, x0, y0 = part_around(frames[frame], centre[0], centre[1], half)
    if min(part.shape) < TUNING.least_part_px:
        return 0, spot
    near = [
        s
        for s in find_spots(part)
        if s.light == spot.light and np.hypot(s.x_px + x0 - centre[0], s.y_px + y0 - centre[1]) < 0.5 * half
    ]
    if (
        len(near) != 1
        or not TUNING.least_change < near[0].diameter_px / spot.diameter_px < TUNING.most_change
    ):
        return 0, spot
    return frame, replace(near[0], x_px=near[0].x_px + x0, y_px=near[0].y_px + y0)


def _detection(name: str, frame: int, spot: Spot, position_mm: float) -> Detection:
    template = disc_template(0.5 * spot.diameter_px, templates.TUNING.first_blur_px)
    if not spot.light:
        template = replace(template, coefs=1.0 - template.coefs)
    return Detection(
        name, DOT, frame, spot.x_px, spot.y_px, np.eye(2), spot.diameter_px, template, position_mm
    )


class DotKind(MarkerKind):
    """Round dots: rotation leaves them unchanged, and one cannot be told from another."""

    name = "blob"
    auto_rank = 1
    can_have_angle = False
    largest_learned_px = 140.0
    artwork = Artwork("disc", gray_percentiles=(50.0, 50.0))

    def detector(self, settings: DetectionSettings, *, auto: bool) -> MarkerDetector | None:
        """Detector of dots; "auto" prefers given points to dots."""
        if auto and settings.points_px:
            return None
        keep_still = bool(settings.reference or settings.input)
        return DotDetector(settings.positions_mm, settings.clamp_side, keep_still=keep_still, kind=self)

    def covers(self, u: FloatArray, v: FloatArray, half_u: float, half_v: float) -> BoolArray:  # noqa: ARG002 - round
        """Points within a disc."""
        return np.asarray(np.hypot(v, u) <= half_u)

    def fit_learned(self, detection: Detection, learned: Template) -> IdealFit | None:
        """Radius, blur and both gray levels of the ideal dot fitted to a learned template."""
        u, v = learned.axes_px()
        inside = learned.support > 0
        values = learned.values()
        gray = values[inside]
        middle = values[np.hypot(v[:, None], u[None, :]) < TUNING.core * detection.size_px]
        centre_level = float(np.median(middle))
        rim_level = float(np.percentile(gray, 90 if centre_level < np.median(gray) else 10))
        span = max(abs(centre_level - rim_level), 1e-9)

        # What is no dot may pull the radius to any size: the time of a disc grows with its cube.
        largest = TUNING.beyond * detection.size_px

        # A change of the gray levels alone, as for two of the six derivatives, leaves the disc as it was.
        @lru_cache(maxsize=8)
        def ideal(x: float, y: float, radius: float, log_blur: float) -> FloatArray:
            return disc_values(u - x, v - y, np.clip(radius, -largest, largest), np.exp(log_blur))[inside]

        def residual(p: FloatArray) -> FloatArray:
            return np.asarray((p[4] + (p[5] - p[4]) * ideal(*p[:4]) - gray) / span)

        start = np.array(
            [0, 0, 0.5 * detection.size_px, np.log(templates.TUNING.first_blur_px), rim_level, centre_level]
        )
        scales = [1, 1, 1, 1, 50, 50]
        found = fitted(residual, start, scales)
        radius, blur = float(found[2]), float(np.exp(found[3]))
        if not TUNING.least_radius < radius / detection.size_px < TUNING.largest_radius or blur > radius:
            return None
        template = disc_template(radius, blur)
        return IdealFit(template, np.eye(2), found[:2], float(found[4]), float(found[5]), 2.0 * radius)

    def fit_pixels(self, detection: Detection, points_uv: FloatArray, gray: FloatArray) -> IdealFit | None:
        """Ellipse, blur and both gray levels fitted to the pixels of a large dot, whose edge is nearly straight."""
        every = max(1, points_uv.shape[1] // TUNING.points_for_shape)
        points, values = points_uv[:, ::every], gray[::every]
        inside = np.hypot(*points) < TUNING.large_core * detection.size_px
        if not inside.any() or inside.all():
            return None
        centre_level = float(np.median(values[inside]))
        rim_level = float(np.median(values[np.hypot(*points) > TUNING.large_rim * detection.size_px]))
        span = max(abs(centre_level - rim_level), 1e-9)

        def residual(p: FloatArray) -> FloatArray:
            at = np.array([[1.0 + p[2], p[3]], [p[3], 1.0 - p[2]]]) @ (points - p[:2, None])
            ideal = step_response(p[4] - np.hypot(*at), np.exp(p[5]))
            return np.asarray((p[6] + (p[7] - p[6]) * ideal - values) / span)

        start = np.array(
            [
                0,
                0,
                0,
                0,
                0.5 * detection.size_px,
                np.log(templates.TUNING.first_blur_px),
                rim_level,
                centre_level,
            ]
        )
        scales = [1, 1, 0.1, 0.1, 1, 1, 50, 50]
        found = fitted(residual, start, scales)
        radius, blur = float(found[4]), float(np.exp(found[5]))
        if (
            not TUNING.least_radius < radius / detection.size_px < TUNING.largest_radius
            or blur > TUNING.largest_blur * radius
        ):
            return None
        matrix = np.array([[1.0 + found[2], found[3]], [found[3], 1.0 - found[2]]])
        template = disc_template(radius, blur)
        return IdealFit(template, matrix, found[:2], float(found[6]), float(found[7]), 2.0 * radius)


DOT = DotKind()

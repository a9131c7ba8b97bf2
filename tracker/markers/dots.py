"""Round dots, dark on light or light on dark, along a beam.

Round spots in an image: regions cut out at many gray levels, selected by their shape.

Spots that look like a known one, searched for in single frames: a few gray levels only, and fast.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
import scipy  # its parts are loaded when they are used
import skimage  # its parts are loaded when they are used
from scipy import ndimage

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
)
from tracker.markers.proposals import MOVED_PX, spot_motion, spot_paths, still_and_beside, stillest_frame
from tracker.template import Template, disc_template, disc_values, step_response

SMALLEST_PX, LARGEST_PX = 4.5, 200.0
# A group of dots up to this size is preferred to larger ones, which may be their backgrounds.
USUAL_PX = 64.0
# Larger discs are examined for what they enclose: a highlight on a ball is not a dot.
LARGEST_BODY_PX = 400.0
# Holes such as reflections cause are filled in regions of at least this size.
FILLED_FROM_PX = 24.0
# A body has a sharp edge: it is cut out equally at this many levels, to this share of its diameter.
BODY_LEVELS, BODY_SPREAD = 5, 0.03
# A dot printed on a round background is concentric with it, to this share of the background's diameter.
CONCENTRIC = 0.05
LEVELS = 14
# A dot must be cut out at this many neighbouring levels; texture and noise are not.
STABLE_LEVELS = 3


@dataclass(frozen=True)
class Spot:
    """A round region: centre, diameter and whether it is lighter than its surroundings."""

    x_px: float
    y_px: float
    diameter_px: float
    light: bool
    levels: int
    spread: float = 0.0

    def encloses(self, other: Spot) -> bool:
        """Whether the other spot, of opposite polarity, lies inside, but off the centre."""
        off = float(np.hypot(self.x_px - other.x_px, self.y_px - other.y_px))
        inside = off + 0.5 * other.diameter_px < 0.5 * self.diameter_px
        return self.light != other.light and inside and off > CONCENTRIC * self.diameter_px


def find_spots(image: GrayImage) -> list[Spot]:
    """All round regions of 4.5 to 200 px that are cut out equally at three or more gray levels.

    They are compact (area over convex area, circle of equal area, axis ratio) and do not touch the edge. A single light
    (or dark) spot on a larger disc of up to 400 px is replaced by that disc: a reflection keeps its position relative
    to the lamp while the body moves. Sorted from top to bottom.
    """
    spots = _stable_spots(image)
    small = [s for s in spots if s.diameter_px <= LARGEST_PX]
    bodies = [s for s in spots if s.levels >= BODY_LEVELS and s.spread < BODY_SPREAD]
    for body in bodies:
        enclosed = [s for s in small if body.encloses(s)]
        if len(enclosed) == 1:
            small = [s for s in small if s is not enclosed[0]]
            if body not in small:
                small.append(body)
    return sorted(small, key=lambda s: (s.y_px, s.x_px))


def _stable_spots(image: GrayImage) -> list[Spot]:
    smooth = ndimage.gaussian_filter(image.astype(np.float32), 0.7)
    low, high = np.percentile(smooth, (0.2, 99.8))
    if high - low < 1.0:
        return []
    votes: list[Spot] = []
    for level in np.linspace(low, high, LEVELS + 2)[1:-1]:
        mask = smooth > level
        votes += _regions(mask, light=True)
        votes += _regions(~mask, light=False)
    return _merged(votes)


def _regions(mask: np.ndarray, *, light: bool) -> list[Spot]:
    labels = skimage.measure.label(mask, connectivity=1)  # type: ignore[no-untyped-call]  # skimage has no types
    areas = np.bincount(labels.ravel())
    smallest, largest = (np.pi / 4 * d**2 for d in (SMALLEST_PX, LARGEST_BODY_PX))
    keep = (areas >= smallest) & (areas <= largest)
    keep[0] = False
    if not keep.any():
        return []
    relabelled = np.cumsum(keep) * keep
    labels = relabelled[labels]
    spots = []
    for k, box in enumerate(ndimage.find_objects(labels), start=1):
        rows, cols = box
        inside = min(rows.start, cols.start, mask.shape[0] - rows.stop, mask.shape[1] - cols.stop) > 0
        large = min(rows.stop - rows.start, cols.stop - cols.start) >= FILLED_FROM_PX
        if inside and large:
            # Separately: its holes may contain further dots.
            filled = ndimage.binary_fill_holes(labels[box] == k)
            spots += _round_regions(filled.astype(np.uint8), (cols.start, rows.start), light=light)
        if large or not inside:
            labels[box][labels[box] == k] = 0
    return [*spots, *_round_regions(labels, (0, 0), light=light)]


def _round_regions(labels: np.ndarray, corner: tuple[int, int], *, light: bool) -> list[Spot]:
    """The labelled regions that are round; `corner` is the x and y of the labels' first pixel."""
    table = skimage.measure.regionprops_table(  # type: ignore[no-untyped-call]  # skimage has no types
        labels, properties=("centroid", "area", "solidity", "axis_major_length", "axis_minor_length")
    )
    round_ = table["axis_minor_length"] > 0.72 * table["axis_major_length"]
    # The axes of an ellipse determine its area: a square or an L of the same axes has another.
    filled = table["area"] / (np.pi / 4 * table["axis_major_length"] * table["axis_minor_length"] + 1e-9)
    good = round_ & (table["solidity"] > 0.86) & (np.abs(filled - 1.0) < 0.08)
    return [
        Spot(
            float(table["centroid-1"][k]) + corner[0],
            float(table["centroid-0"][k]) + corner[1],
            float(np.sqrt(4 / np.pi * table["area"][k])),
            light,
            1,
        )
        for k in np.flatnonzero(good)
    ]


def _merged(votes: list[Spot]) -> list[Spot]:
    """Regions of neighbouring levels that agree in position and size, merged to one spot each."""
    groups: list[list[Spot]] = []
    for vote in votes:
        for group in groups:
            other = group[-1]
            near = np.hypot(vote.x_px - other.x_px, vote.y_px - other.y_px) < 0.2 * other.diameter_px + 0.5
            similar = abs(vote.diameter_px - other.diameter_px) < 0.25 * other.diameter_px + 1.0
            if near and similar and vote.light == other.light:
                group.append(vote)
                break
        else:
            groups.append([vote])
    spots = []
    for group in groups:
        if len(group) >= STABLE_LEVELS:
            x, y, d = np.median([(s.x_px, s.y_px, s.diameter_px) for s in group], axis=0)
            spread = float(np.std([s.diameter_px for s in group]) / d)
            spots.append(Spot(float(x), float(y), float(d), group[0].light, len(group), spread))
    return spots


def largest_group(spots: list[Spot]) -> list[Spot]:
    """The largest group of one polarity with diameters within a third of each other; of equal ones that of dots."""
    groups = [
        [s for s in spots if s.light == seed.light and 0.75 < s.diameter_px / seed.diameter_px < 1.0 / 0.75]
        for seed in spots
    ]

    def rank(group: list[Spot]) -> tuple[int, bool, int]:
        usual = float(np.median([s.diameter_px for s in group])) <= USUAL_PX
        return len(group), usual, sum(s.levels for s in group)

    return max(groups, key=rank, default=[])


# Blur widens a spot along its path and lowers its contrast: limits relative to the diameter and area at rest.
LEAST_WIDTH, MOST_WIDTH = 0.6, 3.0
LEAST_AREA, MOST_AREA = 0.4, 3.0
# A disc fills 79 % of its bounding box.
LEAST_FILLED = 0.6
# Spots of different levels are the same within this share of the diameter.
SAME = 0.4


def gray_level(image: GrayImage, centre_px: FloatArray, diameter_px: float) -> float:
    """Gray level midway between a spot inside the image and its surroundings."""
    half = int(np.ceil(0.5 * diameter_px)) + 2
    x, y = round(float(centre_px[0])), round(float(centre_px[1]))
    top, left = max(y - half, 0), max(x - half, 0)
    part = image[top : y + half + 1, left : x + half + 1].astype(np.float64)
    rows, columns = np.indices(part.shape)
    distance = np.hypot(columns + left - centre_px[0], rows + top - centre_px[1])
    inside, outside = part[distance < 0.25 * diameter_px + 0.5], part[distance > 0.5 * diameter_px + 1.0]
    return 0.5 * float(np.median(inside) + np.median(outside))


def similar_spots(image: GrayImage, diameter_px: float, levels: FloatArray, *, light: bool) -> FloatArray:
    """Centres of regions of about this diameter, lighter (or darker) than one of the levels; shape (s, 2)."""
    found: list[FloatArray] = []
    for level in levels:
        mask = ((image > level) if light else (image < level)).astype(np.uint8)
        _, _, table, centres = cv2.connectedComponentsWithStats(mask, connectivity=4)
        width, height, area = (table[:, c].astype(np.float64) for c in (2, 3, 4))
        ratio = area / (0.25 * np.pi * diameter_px**2)
        good = (np.minimum(width, height) > LEAST_WIDTH * diameter_px) & (ratio > LEAST_AREA)
        good &= (np.maximum(width, height) < MOST_WIDTH * diameter_px) & (ratio < MOST_AREA)
        good &= area > LEAST_FILLED * width * height
        # The first component is the rest of the image.
        for centre in np.asarray(centres, dtype=np.float64)[1:][good[1:]]:
            if all(np.hypot(*(centre - other)) > SAME * diameter_px for other in found):
                found.append(centre)
    return np.array(found).reshape(-1, 2)


FIRST_BLUR_PX = 0.7
# Pixels of a large dot that its ideal template is fitted to.
POINTS_FOR_SHAPE = 4000
# Largest radius of a fitted disc that is the dot, and radius beyond which a fit is not followed, in diameters.
LARGEST_RADIUS, BEYOND = 1.0, 1.5
# Dots are searched for within this distance of where they are expected: in px, in diameters, in spacings.
REACH_PX, REACH_DIAMETERS, REACH_SPACINGS = 80.0, 4.0, 1.25
# Dots are searched for at one gray level, or at three where their levels differ by more than this share.
UNEVEN = 0.15


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
    ) -> None:
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
            return NothingFound("no round dot of 5 to 200 px was detected in the first frame", seen)
        positions_mm = self._positions_mm
        chosen, notes = self._without_background(frames, spots, group)
        if chosen is None:
            return NothingFound(self._wrong_count(spots, group), _centres(group))
        beam = order_along_beam(_centres(chosen), positions_mm, self._clamp_side)
        positions = sorted(positions_mm) if positions_mm is not None else [float("nan")] * len(chosen)
        self._remember(frames, spots, chosen)
        diameters = np.array([s.diameter_px for s in chosen])
        paths, joint = spot_paths(frames, _centres(chosen), diameters, self._find)
        detections = [
            _detection(DOT.marker_name(rank), *_at_its_sharpest(frames, chosen[k], paths[k]), positions[rank])
            for rank, k in enumerate(beam.order)
        ]
        detections = [
            replace(d, first_px=(chosen[k].x_px, chosen[k].y_px))
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
            self._others_px = points[motion < MOVED_PX]
        levels = np.array([gray_level(frames[0], at, self._size_px) for at in _centres(chosen)])
        low, middle, high = np.percentile(levels, (0.0, 50.0, 100.0))
        self._levels = np.array([low, middle, high] if high - low > UNEVEN * middle else [middle])

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
            moved = [s for s, m in zip(group, motion, strict=True) if m > MOVED_PX]
            return moved if len(moved) == len(positions_mm) else kept
        return kept

    def _matching_spacing(self, spots: list[Spot], group: list[Spot]) -> list[Spot] | None:
        if self._positions_mm is None or len(self._positions_mm) < 3:
            return None
        for candidates in (group, spots):
            if len(self._positions_mm) < len(candidates) <= 60:
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
        reach = max(REACH_PX, REACH_DIAMETERS * self._size_px, REACH_SPACINGS * spacing)
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


def _window(
    image: GrayImage, centre: tuple[float, float] | FloatArray, reach: float
) -> tuple[GrayImage, int, int]:
    """Square part of an image within `reach` of a centre, and the x and y of its first pixel."""
    x0, y0 = (max(int(c - reach), 0) for c in centre)
    return image[y0 : int(centre[1] + reach) + 1, x0 : int(centre[0] + reach) + 1], x0, y0


def _at_its_sharpest(frames: list[GrayImage], spot: Spot, path_px: FloatArray) -> tuple[int, Spot]:
    """The frame in which a spot of the first frame is blurred least, and the spot as detected there."""
    frame = stillest_frame(path_px)
    centre = path_px[frame]
    if frame == 0:
        return 0, spot
    half = 2.0 * spot.diameter_px + 8.0
    part, x0, y0 = _window(frames[frame], centre, half)
    if min(part.shape) < 16:
        return 0, spot
    near = [
        s
        for s in find_spots(part)
        if s.light == spot.light and np.hypot(s.x_px + x0 - centre[0], s.y_px + y0 - centre[1]) < 0.5 * half
    ]
    if len(near) != 1 or not 0.6 < near[0].diameter_px / spot.diameter_px < 1.5:
        return 0, spot
    return frame, replace(near[0], x_px=near[0].x_px + x0, y_px=near[0].y_px + y0)


def _detection(name: str, frame: int, spot: Spot, position_mm: float) -> Detection:
    template = disc_template(0.5 * spot.diameter_px, FIRST_BLUR_PX)
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
        return DotDetector(settings.positions_mm, settings.clamp_side, keep_still=bool(settings.reference))

    def covers(self, u: FloatArray, v: FloatArray, half_u: float, half_v: float) -> BoolArray:  # noqa: ARG002 - round
        """Points within a disc."""
        return np.asarray(np.hypot(v, u) <= half_u)

    def fit_learned(self, detection: Detection, learned: Template) -> IdealFit | None:
        """Radius, blur and both gray levels of the ideal dot fitted to a learned template."""
        u, v = learned.axes_px()
        inside = learned.support > 0
        values = learned.values()
        gray = values[inside]
        middle = values[np.hypot(v[:, None], u[None, :]) < 0.25 * detection.size_px]
        centre_level = float(np.median(middle))
        rim_level = float(np.percentile(gray, 90 if centre_level < np.median(gray) else 10))
        span = max(abs(centre_level - rim_level), 1e-9)

        # What is no dot may pull the radius to any size: the time of a disc grows with its cube.
        largest = BEYOND * detection.size_px

        # A change of the gray levels alone, as for two of the six derivatives, leaves the disc as it was.
        @lru_cache(maxsize=8)
        def ideal(x: float, y: float, radius: float, log_blur: float) -> FloatArray:
            return disc_values(u - x, v - y, np.clip(radius, -largest, largest), np.exp(log_blur))[inside]

        def residual(p: FloatArray) -> FloatArray:
            return np.asarray((p[4] + (p[5] - p[4]) * ideal(*p[:4]) - gray) / span)

        start = np.array([0, 0, 0.5 * detection.size_px, np.log(0.7), rim_level, centre_level])
        scales = [1, 1, 1, 1, 50, 50]
        fit = scipy.optimize.least_squares(
            residual, start, method="lm", x_scale=scales, max_nfev=120, ftol=1e-6, xtol=1e-6
        )
        radius, blur = float(fit.x[2]), float(np.exp(fit.x[3]))
        if not 0.25 < radius / detection.size_px < LARGEST_RADIUS or blur > radius:
            return None
        template = disc_template(radius, blur)
        return IdealFit(template, np.eye(2), fit.x[:2], float(fit.x[4]), float(fit.x[5]), 2.0 * radius)

    def fit_pixels(self, detection: Detection, points_uv: FloatArray, gray: FloatArray) -> IdealFit | None:
        """Ellipse, blur and both gray levels fitted to the pixels of a large dot, whose edge is nearly straight."""
        every = max(1, points_uv.shape[1] // POINTS_FOR_SHAPE)
        points, values = points_uv[:, ::every], gray[::every]
        inside = np.hypot(*points) < 0.3 * detection.size_px
        if not inside.any() or inside.all():
            return None
        centre_level = float(np.median(values[inside]))
        rim_level = float(np.median(values[np.hypot(*points) > 0.55 * detection.size_px]))
        span = max(abs(centre_level - rim_level), 1e-9)

        def residual(p: FloatArray) -> FloatArray:
            at = np.array([[1.0 + p[2], p[3]], [p[3], 1.0 - p[2]]]) @ (points - p[:2, None])
            ideal = step_response(p[4] - np.hypot(*at), np.exp(p[5]))
            return np.asarray((p[6] + (p[7] - p[6]) * ideal - values) / span)

        start = np.array([0, 0, 0, 0, 0.5 * detection.size_px, np.log(0.7), rim_level, centre_level])
        scales = [1, 1, 0.1, 0.1, 1, 1, 50, 50]
        fit = scipy.optimize.least_squares(
            residual, start, method="lm", x_scale=scales, max_nfev=120, ftol=1e-6, xtol=1e-6
        )
        radius, blur = float(fit.x[4]), float(np.exp(fit.x[5]))
        if not 0.25 < radius / detection.size_px < LARGEST_RADIUS or blur > 0.3 * radius:
            return None
        matrix = np.array([[1.0 + fit.x[2], fit.x[3]], [fit.x[3], 1.0 - fit.x[2]]])
        template = disc_template(radius, blur)
        return IdealFit(template, matrix, fit.x[:2], float(fit.x[6]), float(fit.x[7]), 2.0 * radius)


DOT = DotKind()

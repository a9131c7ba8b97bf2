"""Round dots, dark on light or light on dark, by thresholds at many levels and the shape of what they cut out."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage
from skimage.measure import label, regionprops_table

from tracker.arrays import FloatArray, GrayImage
from tracker.markers.base import Detection, FoundMarkers, NothingFound
from tracker.markers.beam_order import matching_subset, order_along_beam
from tracker.markers.spot_motion import MOVED_PX, spot_motion, still_and_beside, stillest_frame
from tracker.settings import ClampSide
from tracker.template.parametric import disc_template

SMALLEST_PX, LARGEST_PX = 4.5, 64.0
# Larger discs are looked at for what they bear: a spot of light on a ball is not a dot.
LARGEST_BODY_PX = 400.0
# Holes as reflections make them are filled in regions from this size on.
FILLED_FROM_PX = 24.0
# A body's edge is sharp: it is cut out alike at so many levels, to this share of its diameter.
BODY_LEVELS, BODY_SPREAD = 5, 0.03
# A dot printed on a round card lies in its middle, to this share of the card's diameter.
CONCENTRIC = 0.05
LEVELS = 14
# A dot must be cut out at this many neighbouring levels: texture and noise are not.
STABLE_LEVELS = 3
FIRST_BLUR_PX = 0.7


@dataclass(frozen=True)
class Spot:
    """A round region: centre, diameter and whether it is lighter than what surrounds it."""

    x_px: float
    y_px: float
    diameter_px: float
    light: bool
    levels: int
    spread: float = 0.0

    def bears(self, other: Spot) -> bool:
        """Whether the other, of opposite polarity, lies inside, and not in the middle."""
        off = float(np.hypot(self.x_px - other.x_px, self.y_px - other.y_px))
        inside = off + 0.5 * other.diameter_px < 0.5 * self.diameter_px
        return self.light != other.light and inside and off > CONCENTRIC * self.diameter_px


def find_spots(image: GrayImage) -> list[Spot]:
    """All round regions of 4.5 to 64 px that are cut out alike at three or more levels of gray.

    The regions must be compact (area over convex area, circle of equal area, axis ratio) and not touch the
    edge. A single spot of light (or shade) on a larger disc gives way to that disc, of up to 400 px: a reflection stays
    where the lamp is while the body moves. Sorted from top to bottom.
    """
    spots = _stable_spots(image)
    small = [s for s in spots if s.diameter_px <= LARGEST_PX]
    bodies = [s for s in spots if s.levels >= BODY_LEVELS and s.spread < BODY_SPREAD]
    for body in bodies:
        borne = [s for s in small if body.bears(s)]
        if len(borne) == 1:
            small = [s for s in small if s is not borne[0]]
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
    labels = label(mask, connectivity=1)  # type: ignore[no-untyped-call]  # skimage has no types
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
        at_edge = (
            rows.start == 0 or cols.start == 0 or rows.stop == mask.shape[0] or cols.stop == mask.shape[1]
        )
        large = min(rows.stop - rows.start, cols.stop - cols.start) >= FILLED_FROM_PX
        if at_edge:
            labels[box][labels[box] == k] = 0
        elif large:
            # By itself: what lies in its holes may be a dot of its own.
            whole = ndimage.binary_fill_holes(labels[box] == k)
            labels[box][labels[box] == k] = 0
            spots += _round_ones(whole.astype(np.uint8), (cols.start, rows.start), light=light)
    return [*spots, *_round_ones(labels, (0, 0), light=light)]


def _round_ones(labels: np.ndarray, corner: tuple[int, int], *, light: bool) -> list[Spot]:
    """The labelled regions that are round; `corner` is the x and y of the labels' first pixel."""
    table = regionprops_table(  # type: ignore[no-untyped-call]  # skimage has no types
        labels,
        properties=("centroid", "area", "solidity", "axis_major_length", "axis_minor_length"),
    )
    round_ = table["axis_minor_length"] > 0.72 * table["axis_major_length"]
    # An ellipse's axes give its area: a square or an L of the same axes misses it.
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
    """Regions of neighbouring levels that agree in place and size, as one spot each."""
    groups: list[list[Spot]] = []
    for vote in votes:
        for group in groups:
            other = group[-1]
            near = np.hypot(vote.x_px - other.x_px, vote.y_px - other.y_px) < 0.2 * other.diameter_px + 0.5
            alike = abs(vote.diameter_px - other.diameter_px) < 0.25 * other.diameter_px + 1.0
            if near and alike and vote.light == other.light:
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


def alike(spots: list[Spot]) -> list[Spot]:
    """The largest group of one polarity whose diameters agree within a third."""
    best: list[Spot] = []
    for seed in spots:
        group = [
            s for s in spots if s.light == seed.light and 0.75 < s.diameter_px / seed.diameter_px < 1.0 / 0.75
        ]
        if (len(group), sum(s.levels for s in group)) > (len(best), sum(s.levels for s in best)):
            best = group
    return best


class DotDetector:
    """Round dots along a beam.

    Parameters
    ----------
    positions_mm : tuple of float or None
        Distances from the clamp: as many dots must be found.
    clamp_side : str or None
    keep_still : bool
        Whether dots that stand still beside the moving ones may be markers: references of a shaking camera.
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

    def detect(self, frames: list[GrayImage]) -> FoundMarkers | NothingFound:
        """Dots of the first frame, named m1, m2, ... from the clamp outwards."""
        spots = find_spots(frames[0])
        group = alike(spots)
        if not group:
            seen = _places(spots) if spots else None
            return NothingFound("no round dot of 5 to 60 px was seen in the first frame", seen)
        wanted = self._positions_mm
        chosen, notes = self._without_background(frames, spots, group)
        if chosen is None:
            return NothingFound(self._what_was_seen(spots, group), _places(group))
        group = chosen
        points = np.array([(s.x_px, s.y_px) for s in group])
        beam = order_along_beam(points, wanted, self._clamp_side)
        positions = sorted(wanted) if wanted is not None else [float("nan")] * len(group)
        detections = tuple(
            _detection(f"m{rank + 1}", *_at_its_sharpest(frames, group[index]), positions[rank])
            for rank, index in enumerate(beam.order)
        )
        return FoundMarkers(detections, (*notes, *beam.notes))

    def _without_background(
        self, frames: list[GrayImage], spots: list[Spot], group: list[Spot]
    ) -> tuple[list[Spot] | None, list[str]]:
        """The markers among alike spots, and a note on what was left out; None when the count cannot be met."""
        wanted = self._positions_mm
        if wanted is not None and len(group) == len(wanted):
            return group, _left_out(len(spots) - len(group), "differ in size or colour")
        if wanted is not None:
            chosen = self._choose(spots, group)
            if chosen is not None:
                note = (
                    f"{len(spots)} round spots were seen; the {len(chosen)} whose spacing fits positions_mm are "
                    "followed."
                )
                return chosen, [note]
        moving = self._moving(frames, group)
        notes = _left_out(len(group) - len(moving), "stand still beside the moving ones, in the background")
        if self._keep_still or (wanted is not None and len(moving) != len(wanted)):
            return (group, []) if wanted is None else (None, [])
        return moving, [*notes, *_left_out(len(spots) - len(group), "differ in size or colour")]

    def _moving(self, frames: list[GrayImage], group: list[Spot]) -> list[Spot]:
        """The spots without those of the background; with a known count, also without still ones on the line."""
        points, diameters = _places(group), np.array([s.diameter_px for s in group])
        motion = spot_motion(frames, points, diameters)
        background = still_and_beside(points, diameters, motion)
        kept = [s for s, out in zip(group, background, strict=True) if not out]
        wanted = self._positions_mm
        if wanted is not None and len(kept) != len(wanted):
            moved = [s for s, m in zip(group, motion, strict=True) if m > MOVED_PX]
            return moved if len(moved) == len(wanted) else kept
        return kept

    def _choose(self, spots: list[Spot], group: list[Spot]) -> list[Spot] | None:
        if self._positions_mm is None or len(self._positions_mm) < 3:
            return None
        for candidates in (group, spots):
            if len(self._positions_mm) < len(candidates) <= 60:
                points = np.array([(s.x_px, s.y_px) for s in candidates])
                subset = matching_subset(points, self._positions_mm)
                if subset is not None:
                    return [candidates[k] for k in subset]
        return None

    def _what_was_seen(self, spots: list[Spot], group: list[Spot]) -> str:
        where = ", ".join(f"({s.x_px:.0f}, {s.y_px:.0f})" for s in group[:12])
        more = f" and {len(group) - 12} more" if len(group) > 12 else ""
        colour = "light on dark" if group[0].light else "dark on light"
        others = len(spots) - len(group)
        other_text = f"; {others} other round spots differ in size or colour" if others else ""
        wanted = len(self._positions_mm or ())
        return (
            f"positions_mm names {wanted} dots, but {len(group)} alike were seen ({colour}, about "
            f"{np.median([s.diameter_px for s in group]):.0f} px) at x, y = {where}{more} px{other_text}; "
            "give one position for each, or crop the picture to the beam"
        )

    def redetect(self, image: GrayImage, sought: tuple[Detection, ...]) -> list[Detection]:
        """Dots near where they were last seen; two candidates for one place are not taken."""
        found = []
        reach = max(80.0, 4.0 * max(s.size_px for s in sought))
        for known in sought:
            x0, y0 = (max(int(c - reach), 0) for c in (known.x_px, known.y_px))
            part = image[y0 : int(known.y_px + reach) + 1, x0 : int(known.x_px + reach) + 1]
            if min(part.shape) < 16:
                continue
            near = [s for s in find_spots(part) if 0.75 < s.diameter_px / known.size_px < 1.33]
            if len(near) == 1:
                found.append(replace(known, x_px=near[0].x_px + x0, y_px=near[0].y_px + y0))
        return found


def _places(spots: list[Spot]) -> FloatArray:
    return np.array([(s.x_px, s.y_px) for s in spots])


def _left_out(count: int, why: str) -> list[str]:
    if count <= 0:
        return []
    return [f"{count} other round {'spot' if count == 1 else 'spots'} {why}: left out."]


def _at_its_sharpest(frames: list[GrayImage], spot: Spot) -> tuple[int, Spot]:
    """The frame in which a spot of the first frame is blurred least, and the spot as it is seen there."""
    frame, place = stillest_frame(frames, np.array([spot.x_px, spot.y_px]), spot.diameter_px)
    half = 2.0 * spot.diameter_px + 8.0
    x0, y0 = (max(int(c - half), 0) for c in place)
    part = frames[frame][y0 : int(place[1] + half) + 1, x0 : int(place[0] + half) + 1]
    if frame == 0 or min(part.shape) < 16:
        return 0, spot
    near = [
        s
        for s in find_spots(part)
        if s.light == spot.light and np.hypot(s.x_px + x0 - place[0], s.y_px + y0 - place[1]) < 0.5 * half
    ]
    if len(near) != 1 or not 0.6 < near[0].diameter_px / spot.diameter_px < 1.5:
        return 0, spot
    return frame, replace(near[0], x_px=near[0].x_px + x0, y_px=near[0].y_px + y0)


def _detection(name: str, frame: int, spot: Spot, position_mm: float) -> Detection:
    template = disc_template(0.5 * spot.diameter_px, FIRST_BLUR_PX)
    if not spot.light:
        template = replace(template, coefs=1.0 - template.coefs)
    return Detection(
        name, "blob", frame, spot.x_px, spot.y_px, np.eye(2), spot.diameter_px, template, None, position_mm
    )

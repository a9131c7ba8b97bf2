"""Round spots in an image: regions cut out at many gray levels, selected by their shape."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import skimage  # its parts are loaded when they are used
from scipy import ndimage

from tracker.arrays import GrayImage

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

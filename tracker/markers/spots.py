"""Round spots in an image: regions at many gray levels selected by their shape, and spots like a known one."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import skimage  # its parts are loaded when they are used
from scipy import ndimage

from tracker.arrays import FloatArray, GrayImage


@dataclass(frozen=True)
class Tuning:
    """What is a round spot, and what looks like a known one."""

    #: [px] diameter of a dot, at least
    smallest_px: float = 4.5
    #: [px] and at most
    largest_px: float = 200.0
    #: [px] a group of dots up to this size is preferred to larger ones
    #: convention: these may be their backgrounds
    usual_px: float = 64.0
    #: [px] of a disc that is examined for what it encloses
    #: convention: a highlight on a ball is not a dot
    largest_body_px: float = 400.0
    #: [px] of a region whose holes are filled
    #: convention: reflections cause them
    filled_from_px: float = 24.0
    #: [1] gray levels at which a body is cut out equally
    #: convention: a body has a sharp edge
    body_levels: int = 5
    #: [1] to this share of its diameter
    body_spread: float = 0.03
    #: [1] of its background's diameter, to which a printed dot is concentric with it
    concentric: float = 0.05
    #: [1] gray levels at which regions are cut out
    #: convention: limits time
    levels: int = 14
    #: [1] neighbouring levels at which a dot must be cut out
    #: convention: texture and noise are not
    stable_levels: int = 3
    #: [1] shorter over longer axis of a round region
    #: convention: seen up to 44 degrees obliquely
    least_axis_ratio: float = 0.72
    #: [1] area over convex area of a round region
    least_solidity: float = 0.86
    #: [1] relative difference from the area of the ellipse of the same axes
    #: convention: an L or a ring of the same axes differs by more
    ellipse_misfit: float = 0.08
    #: [1] smaller side of a spot over its diameter at rest, at least
    #: convention: blur widens a spot along its path and lowers its contrast
    least_width: float = 0.6
    #: [1] larger side, at most
    #: convention: as above
    most_width: float = 3.0
    #: [1] area over that at rest, at least
    #: convention: as above
    least_area: float = 0.4
    #: [1] and at most
    #: convention: as above
    most_area: float = 3.0
    #: [1] of its bounding box that a spot fills
    #: convention: a disc fills 79 %
    least_filled: float = 0.6
    #: [1] of the diameter within which spots of different levels are the same
    same: float = 0.4
    #: [%] of the pixels at either end of the gray levels that are left out
    extreme_percent: float = 0.2
    #: [1] of the diameter and half a px, within which regions of two levels are one spot
    near: float = 0.2
    #: [1] of the diameter and a px, by which their diameters differ less
    alike: float = 0.25
    #: [1] ratio of the diameters of two spots of a group, at least
    group: float = 0.75


TUNING = Tuning()


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
        return self.light != other.light and inside and off > TUNING.concentric * self.diameter_px


def find_spots(image: GrayImage) -> list[Spot]:
    """All round regions of 4.5 to 200 px that are cut out equally at three or more gray levels.

    They are compact (area over convex area, circle of equal area, axis ratio) and do not touch the edge. A single light
    (or dark) spot on a larger disc of up to 400 px is replaced by that disc: a reflection keeps its position relative
    to the lamp while the body moves. Sorted from top to bottom.
    """
    spots = _stable_spots(image)
    small = [s for s in spots if s.diameter_px <= TUNING.largest_px]
    bodies = [s for s in spots if s.levels >= TUNING.body_levels and s.spread < TUNING.body_spread]
    for body in bodies:
        enclosed = [s for s in small if body.encloses(s)]
        if len(enclosed) == 1:
            small = [s for s in small if s is not enclosed[0]]
            if body not in small:
                small.append(body)
    return sorted(small, key=lambda s: (s.y_px, s.x_px))


def _stable_spots(image: GrayImage) -> list[Spot]:
    smooth = ndimage.gaussian_filter(image.astype(np.float32), 0.7)
    low, high = np.percentile(smooth, (TUNING.extreme_percent, 100.0 - TUNING.extreme_percent))
    if high - low < 1.0:
        return []
    votes: list[Spot] = []
    for level in np.linspace(low, high, TUNING.levels + 2)[1:-1]:
        mask = smooth > level
        votes += _regions(mask, light=True)
        votes += _regions(~mask, light=False)
    return _merged(votes)


def _regions(mask: np.ndarray, *, light: bool) -> list[Spot]:
    labels = skimage.measure.label(mask, connectivity=1)  # type: ignore[no-untyped-call]  # skimage has no types
    areas = np.bincount(labels.ravel())
    smallest, largest = (np.pi / 4 * d**2 for d in (TUNING.smallest_px, TUNING.largest_body_px))
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
        large = min(rows.stop - rows.start, cols.stop - cols.start) >= TUNING.filled_from_px
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
    round_ = table["axis_minor_length"] > TUNING.least_axis_ratio * table["axis_major_length"]
    # The axes of an ellipse determine its area: a square or an L of the same axes has another.
    filled = table["area"] / (np.pi / 4 * table["axis_major_length"] * table["axis_minor_length"] + 1e-9)
    good = round_ & (table["solidity"] > TUNING.least_solidity)
    good &= np.abs(filled - 1.0) < TUNING.ellipse_misfit
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
            near = (
                np.hypot(vote.x_px - other.x_px, vote.y_px - other.y_px)
                < TUNING.near * other.diameter_px + 0.5
            )
            similar = abs(vote.diameter_px - other.diameter_px) < TUNING.alike * other.diameter_px + 1.0
            if near and similar and vote.light == other.light:
                group.append(vote)
                break
        else:
            groups.append([vote])
    spots = []
    for group in groups:
        if len(group) >= TUNING.stable_levels:
            x, y, d = np.median([(s.x_px, s.y_px, s.diameter_px) for s in group], axis=0)
            spread = float(np.std([s.diameter_px for s in group]) / d)
            spots.append(Spot(float(x), float(y), float(d), group[0].light, len(group), spread))
    return spots


def largest_group(spots: list[Spot]) -> list[Spot]:
    """The largest group of one polarity with diameters within a third of each other; of equal ones that of dots."""
    groups = [
        [
            s
            for s in spots
            if s.light == seed.light and TUNING.group < s.diameter_px / seed.diameter_px < 1.0 / TUNING.group
        ]
        for seed in spots
    ]

    def rank(group: list[Spot]) -> tuple[int, bool, int]:
        usual = float(np.median([s.diameter_px for s in group])) <= TUNING.usual_px
        return len(group), usual, sum(s.levels for s in group)

    return max(groups, key=rank, default=[])


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
        good = (np.minimum(width, height) > TUNING.least_width * diameter_px) & (ratio > TUNING.least_area)
        good &= (np.maximum(width, height) < TUNING.most_width * diameter_px) & (ratio < TUNING.most_area)
        good &= area > TUNING.least_filled * width * height
        # The first component is the rest of the image.
        for centre in np.asarray(centres, dtype=np.float64)[1:][good[1:]]:
            if all(np.hypot(*(centre - other)) > TUNING.same * diameter_px for other in found):
                found.append(centre)
    return np.array(found).reshape(-1, 2)

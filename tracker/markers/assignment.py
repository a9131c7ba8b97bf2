"""Which spot is which marker, for markers of the same appearance: all are assigned together.

One marker alone cannot be told from its neighbour that has taken its place. All together can: a shift by one place
leaves a marker at one end without a spot and a spot at the other end without a marker. The order along the beam, and
regions in which no marker is sought, are determined here as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Literal, cast

import numpy as np
import scipy  # its parts are loaded when they are used

from tracker.arrays import BoolArray, FloatArray, GrayImage, IntArray
from tracker.markers.kind import (
    Candidates,
    Detection,
    FoundMarkers,
    MarkerDetector,
    NothingFound,
    SimilarMarkerDetector,
)


@dataclass(frozen=True)
class Tuning:
    """Joint assignment of markers that look alike, and their order along the beam."""

    #: [1] negative logarithm of the probability that a visible marker is not detected, or that a spot is no marker
    #: convention: one of 8000
    missing: float = 9.0
    #: [1] the same for a spot that comes into view
    #: convention: rare: the first frame usually shows all
    entering: float = 7.0
    #: [1] the same for a marker that leaves it
    #: convention: one of 7
    leaving: float = 2.0
    #: [1] largest cost of an unexpected motion (a pluck, a release), and of one beyond the range of an oscillation
    #: convention: less than that of two markers that are missing
    unpredicted: float = 16.0
    #: [1] by which the best hypothesis must be better than any that contradicts it
    #: statistics: a factor of 400 in probability
    decisive: float = 6.0
    #: [1] sd of deviations of single markers from the common motion, relative to their spacing
    shape_sd: float = 0.15
    #: [1] the largest of them
    #: physics: from half the spacing on the neighbour is nearer
    shape_limit: float = 0.45
    #: [1] sizes within which spots are alternatives for a single marker, which has no spacing
    alone: float = 8.0
    #: [1] common motions examined in detail
    #: convention: limits time
    most_hypotheses: int = 12
    #: [markers] that a motion may bring fewer to a spot than the best one
    #: physics: each costs at least `missing`
    fewer: int = 2
    #: [1] factor by which distances between neighbours change less
    #: convention: a line of markers does not fold
    most_stretch: float = 1.7
    #: [1] factor by which one direction must fit worse before the spacing alone decides the clamped end
    decisive_ratio: float = 3.0
    #: [1] misfit of that direction, relative to the extent, at least
    least_misfit: float = 0.02
    #: [1] of the smallest spacing, within which a spot must be where the others say
    near_spot: float = 0.2
    #: [1] of the smallest spacing, by which two hypotheses differ
    apart: float = 0.25


TUNING = Tuning()


@dataclass(frozen=True)
class Assignment:
    """Index of each marker's spot, shape (m,), -1 where it has none or the choice is ambiguous.

    ``motion_px``, shape (2,), is the median distance from the expected positions, NaN without any spot;
    ``ambiguous``, shape (m,), marks markers for which two hypotheses explain the spots comparably.
    """

    spots: IntArray
    motion_px: FloatArray
    ambiguous: BoolArray


@dataclass(frozen=True)
class Expectation:
    """Where markers are expected, shape (m, 2), and how far off all of them together may be, px.

    `sd_px` is the scale of a common displacement. Where the range of an oscillation is known, a displacement to
    outside of `range_px`, its smallest and largest x, y, shape (2, 2), is improbable as well, on the scale of
    `range_sd_px`.
    """

    where_px: FloatArray
    sd_px: float
    range_px: FloatArray | None = None
    range_sd_px: float = 1.0

    def cost(self, motion_px: FloatArray) -> float:
        """Negative logarithm of the probability of a common displacement."""
        cost = min(0.5 * float(motion_px @ motion_px) / self.sd_px**2, TUNING.unpredicted)
        if self.range_px is None:
            return cost
        beyond = np.maximum(np.maximum(self.range_px[0] - motion_px, motion_px - self.range_px[1]), 0.0)
        return cost + min(0.5 * float(beyond @ beyond) / self.range_sd_px**2, TUNING.unpredicted)


@dataclass(frozen=True)
class Scene:
    """Markers where they are expected, and spots where they are, shape (s, 2), px.

    `corners_px`, shape (2, 2), are the smallest and the largest x, y between which spots can be found.
    """

    expectation: Expectation
    spots_px: FloatArray
    size_px: float
    corners_px: FloatArray

    @property
    def expected_px(self) -> FloatArray:
        """Expected positions of the markers; shape (m, 2)."""
        return self.expectation.where_px

    def spacing_px(self) -> FloatArray:
        """Distance from each marker to the nearest other one; shape (m,)."""
        return spacing_px(self.expected_px, self.size_px)

    def is_visible(self, points_px: FloatArray) -> BoolArray:
        """Whether markers at these points would be found as spots."""
        return np.asarray(np.all((points_px > self.corners_px[0]) & (points_px < self.corners_px[1]), axis=1))


def spacing_px(points_px: FloatArray, size_px: float) -> FloatArray:
    """Distance from each marker to the nearest other one, some sizes for a single one; shape (m,)."""
    if len(points_px) < 2:
        return np.full(len(points_px), TUNING.alone * size_px)
    distance = scipy.spatial.distance.cdist(points_px, points_px)
    np.fill_diagonal(distance, np.inf)
    return np.asarray(np.maximum(distance.min(axis=1), 1.0))


def completed(points_px: FloatArray, form_px: FloatArray) -> FloatArray:
    """Points with the missing ones (NaN) added: those of an earlier form, displaced as the others are; shape (m, 2)."""
    seen = np.all(np.isfinite(points_px), axis=1)
    if seen.all() or not seen.any():
        return np.where(seen[:, None], points_px, form_px)
    return np.where(seen[:, None], points_px, form_px + _displaced(form_px, points_px[seen], seen))


def assign(scene: Scene) -> Assignment:
    """The common motion that explains the spots best, and the spot of each marker under it.

    Every hypothesis is a common displacement from the expected positions, then refined to one that is linear along the
    line of markers. It costs `TUNING.missing` for each visible marker without a spot and each spot that is not a marker
    (less for those that left the view or came into it), the square of the motion in units of its uncertainty, and the
    deviations of single markers. Where hypotheses that differ about a marker cost nearly the same, it gets none.
    """
    m = len(scene.expected_px)
    nothing = Assignment(np.full(m, -1), np.full(2, np.nan), np.zeros(m, dtype=bool))
    if m == 0 or len(scene.spots_px) == 0:
        return nothing
    found = [_refined(scene, motion) for motion in _motions(scene)]
    found += [_in_order(scene)] if len(scene.spots_px) == m else []
    ranked = sorted(((_cost(scene, spots), tuple(spots.tolist())) for spots in found), key=lambda c: c[0])
    least, best = ranked[0][0], np.array(ranked[0][1])
    ambiguous = np.zeros(m, dtype=bool)
    for cost, other in ranked[1:]:
        if cost < least + TUNING.decisive:
            rival = np.array(other)
            ambiguous |= (rival >= 0) & (best >= 0) & (rival != best)
            # A spot that may also be another marker.
            ambiguous |= (best >= 0) & (rival != best) & np.isin(best, rival)
    kept = np.where(ambiguous, -1, best)
    return Assignment(kept, _motion(scene, kept), ambiguous)


def _motion(scene: Scene, spots: IntArray) -> FloatArray:
    seen = spots >= 0
    if not seen.any():
        return np.full(2, np.nan)
    return np.asarray(np.median(scene.spots_px[spots[seen]] - scene.expected_px[seen], axis=0))


def _motions(scene: Scene) -> FloatArray:
    """Common displacements worth examining: none, and those that bring many markers to a spot; shape (h, 2)."""
    spacing = scene.spacing_px()
    steps = (scene.spots_px[None, :, :] - scene.expected_px[:, None, :]).reshape(-1, 2)
    counts = np.array([_matches(scene, step, spacing) for step in steps])
    order = np.lexsort((np.hypot(*steps.T), -counts))
    kept = [np.zeros(2)]
    for k in order:
        if counts[k] < counts[order[0]] - TUNING.fewer or len(kept) >= TUNING.most_hypotheses:
            break
        if min(np.hypot(*(steps[k] - other)) for other in kept) > TUNING.apart * spacing.min():
            kept.append(steps[k])
    return np.array(kept)


def _matches(scene: Scene, motion: FloatArray, spacing: FloatArray) -> int:
    distance = scipy.spatial.distance.cdist(scene.expected_px + motion, scene.spots_px).min(axis=1)
    return int(np.count_nonzero(distance < TUNING.shape_limit * spacing))


def _refined(scene: Scene, motion: FloatArray) -> IntArray:
    """Spot of each marker under a common motion, with the motion fitted to the spots."""
    where = scene.expected_px + motion
    spots = _nearest(scene, where)
    for _ in range(2):
        seen = spots >= 0
        if np.count_nonzero(seen) < 2:
            break
        where = scene.expected_px + _field(scene, spots, seen)
        spots = _nearest(scene, where)
    return spots


def _field(scene: Scene, spots: IntArray, seen: BoolArray) -> FloatArray:
    """Displacement of all markers, linear along their line, fitted to those with a spot; shape (m, 2)."""
    return _displaced(scene.expected_px, scene.spots_px[spots[seen]], seen)


def _displaced(points_px: FloatArray, now_px: FloatArray, seen: BoolArray) -> FloatArray:
    displaced = now_px - points_px[seen]
    if np.count_nonzero(seen) < 3:
        return np.asarray(np.broadcast_to(displaced.mean(axis=0), points_px.shape))
    along = _along(points_px)
    design = np.stack([np.ones(len(along)), along], axis=1)
    return np.asarray(design @ np.linalg.lstsq(design[seen], displaced, rcond=None)[0])


def _along(points_px: FloatArray) -> FloatArray:
    """Coordinate along the first principal axis of points; shape (m,)."""
    centred = points_px - points_px.mean(axis=0)
    return np.asarray(centred @ np.linalg.svd(centred, full_matrices=False)[2][0])


def _nearest(scene: Scene, where: FloatArray) -> IntArray:
    """One spot at most for each marker at `where`, so that the deviations are smallest."""
    cost = _deviation_cost(scene, where)
    rows, columns = scipy.optimize.linear_sum_assignment(np.minimum(cost - 2.0 * TUNING.missing, 0.0))
    spots = np.full(len(where), -1)
    near = np.isfinite(cost[rows, columns])
    spots[rows[near]] = columns[near]
    return spots


def _deviation_cost(scene: Scene, where: FloatArray) -> FloatArray:
    """Cost of each spot for each marker at `where`, infinite beyond the limit; shape (m, s)."""
    relative = scipy.spatial.distance.cdist(where, scene.spots_px) / scene.spacing_px()[:, None]
    return np.where(relative < TUNING.shape_limit, 0.5 * (relative / TUNING.shape_sd) ** 2, np.inf)


def _in_order(scene: Scene) -> IntArray:
    """As many spots as markers: the assignment of least squares, which no common motion changes.

    Also right for motions of any shape across the line of markers; discarded where the line would fold.
    """
    pairs = scipy.optimize.linear_sum_assignment(
        scipy.spatial.distance.cdist(scene.expected_px, scene.spots_px, "sqeuclidean")
    )[1]
    order = np.argsort(_along(scene.expected_px), kind="stable")
    before, after = (np.diff(p[order], axis=0) for p in (scene.expected_px, scene.spots_px[pairs]))
    stretch = np.linalg.norm(after, axis=1) / np.maximum(np.linalg.norm(before, axis=1), 1e-9)
    forward = np.einsum("ij,ij->i", before, after) > 0.0
    fits = forward & (stretch < TUNING.most_stretch) & (stretch > 1.0 / TUNING.most_stretch)
    return np.asarray(pairs if np.all(fits) else np.full(len(pairs), -1))


def _cost(scene: Scene, spots: IntArray) -> float:
    """Negative logarithm of the probability of an assignment, up to a constant."""
    seen = spots >= 0
    if not seen.any():
        visible = np.count_nonzero(scene.is_visible(scene.expected_px))
        return TUNING.missing * float(visible + len(scene.spots_px)) + TUNING.unpredicted
    motion = _motion(scene, spots)
    missing = scene.is_visible(scene.expected_px[~seen] + motion)
    idle = np.setdiff1d(np.arange(len(scene.spots_px)), spots[seen])
    unexplained = scene.is_visible(scene.spots_px[idle] - motion)
    exceptions = (
        np.where(missing, TUNING.missing, TUNING.leaving).sum()
        + np.where(unexplained, TUNING.missing, TUNING.entering).sum()
    )
    deviation = _deviation_cost(scene, scene.expected_px + _field(scene, spots, seen))
    shape = np.minimum(deviation[np.flatnonzero(seen), spots[seen]], TUNING.missing).sum()
    return float(exceptions + shape + scene.expectation.cost(motion))


ClampSide = Literal["top", "bottom", "left", "right"]


@dataclass(frozen=True)
class BeamOrder:
    """Indices of the markers from the clamp outwards, and notes for the user."""

    order: IntArray
    notes: tuple[str, ...]


def order_along_beam(
    points_px: FloatArray, positions_mm: tuple[float, ...] | None, clamp_side: ClampSide | None
) -> BeamOrder:
    """Sort markers, of shape (n, 2), from the clamp outwards.

    The line through the markers is their first principal axis. Its clamped end is at `clamp_side` where given; else
    at the end from which `positions_mm` fit the spacing clearly better; else at the top of the image for a line closer
    to vertical, at the left for one closer to horizontal.
    """
    centred = points_px - points_px.mean(axis=0)
    axis = np.linalg.svd(centred, full_matrices=False)[2][0] if len(points_px) > 1 else np.array([0.0, 1.0])
    upright = abs(axis[1]) >= abs(axis[0])
    side = clamp_side or ("top" if upright else "left")
    outward = {"top": (0, 1), "bottom": (0, -1), "left": (1, 0), "right": (-1, 0)}[side]
    if axis @ np.array(outward, dtype=np.float64) < 0:
        axis = -axis
    along = centred @ axis
    order = np.argsort(along, kind="stable")
    if clamp_side is not None or len(order) < 2:
        return BeamOrder(order, ())
    if positions_mm is not None and len(order) > 2:
        forward = _misfit(along[order], positions_mm)
        backward = _misfit(-along[order[::-1]], positions_mm)
        if forward > TUNING.decisive_ratio * backward and forward > TUNING.least_misfit:
            note = (
                "The spacing of the markers puts the clamp at the opposite end; set clamp_side to override."
            )
            return BeamOrder(order[::-1].copy(), (note,))
        if backward > TUNING.decisive_ratio * forward and backward > TUNING.least_misfit:
            return BeamOrder(order, ())
    note = f"The clamp is assumed at the {side} of the image; set clamp_side if it is not."
    return BeamOrder(order, (note,))


def _misfit(along_px: FloatArray, positions_mm: tuple[float, ...]) -> float:
    """Rms deviation of sorted pixel positions from a line in `positions_mm`, relative to their extent."""
    mm = np.array(positions_mm)
    line = np.polynomial.polynomial.polyfit(mm, along_px, 1)
    if line[1] <= 0:
        return float("inf")
    rest = along_px - np.polynomial.polynomial.polyval(mm, line)
    return float(np.sqrt(np.mean(rest**2)) / max(np.ptp(along_px), 1e-9))


def matching_subset(points_px: FloatArray, positions_mm: tuple[float, ...]) -> IntArray | None:
    """Indices of the spots that lie on a line with the spacing of `positions_mm`, among more spots than markers.

    Every pair of spots is tried as first and last marker; the others must lie within a fifth of the smallest spacing.
    The subset with the smallest error is returned, None when none fits.
    """
    mm = np.array(positions_mm)
    first, last = int(np.argmin(mm)), int(np.argmax(mm))
    share = (mm - mm[first]) / (mm[last] - mm[first])
    spacing = float(np.min(np.diff(np.sort(share))))
    fitting: list[tuple[float, tuple[int, ...]]] = []
    for start, stop in permutations(points_px, 2):
        span = stop - start
        expected = start + share[:, None] * span
        distance = np.linalg.norm(points_px[None, :, :] - expected[:, None, :], axis=2)
        nearest = np.argmin(distance, axis=1)
        error = distance[np.arange(len(mm)), nearest]
        if len(set(nearest.tolist())) == len(
            mm
        ) and error.max() < TUNING.near_spot * spacing * np.linalg.norm(span):
            relative = float(np.sqrt(np.mean(error**2)) / np.linalg.norm(span))
            fitting.append((relative, tuple(sorted(nearest.tolist()))))
    return np.array(min(fitting)[1], dtype=np.int64) if fitting else None


# Two opposite corners, in px.
Region = Sequence[Sequence[float]]


def leaving_out(detector: MarkerDetector, regions: Sequence[Region]) -> MarkerDetector:
    """Detector that finds nothing in these regions, neither at first nor when a marker is lost."""
    if not regions:
        return detector
    return (
        _Similar(detector, regions)
        if isinstance(detector, SimilarMarkerDetector)
        else _Other(detector, regions)
    )


def filled(image: GrayImage, regions: Sequence[Region]) -> GrayImage:
    """Copy of an image whose regions continue the gray levels around them, without an edge of their own."""
    out = image.copy()
    for region in regions:
        (left, top), (right, bottom) = np.sort(np.rint(np.asarray(region, dtype=float)), axis=0).astype(int)
        rows = slice(max(top, 0), min(bottom + 1, image.shape[0]))
        columns = slice(max(left, 0), min(right + 1, image.shape[1]))
        if rows.start < rows.stop and columns.start < columns.stop:
            out[rows, columns] = _continued(out, rows, columns)
    return out


def _continued(image: GrayImage, rows: slice, columns: slice) -> FloatArray:
    """Mean of what the pixels to the left and right, and those above and below, give for each pixel of a region."""
    across = _between(image[rows], columns)
    along = _between(image[:, columns].T, rows)
    known = [part for part in (across, None if along is None else along.T) if part is not None]
    return np.asarray(np.rint(np.mean(known, axis=0)) if known else np.median(image))


def _between(lines: GrayImage, part: slice) -> FloatArray | None:
    """Values of each line between the pixels before and after a part of it; None where there is neither."""
    before = lines[:, part.start - 1].astype(float) if part.start > 0 else None
    after = lines[:, part.stop].astype(float) if part.stop < lines.shape[1] else None
    if before is None or after is None:
        one = before if after is None else after
        return None if one is None else np.repeat(one[:, None], part.stop - part.start, axis=1)
    share = np.arange(1, part.stop - part.start + 1) / (part.stop - part.start + 1)
    return np.asarray(before[:, None] + share * (after - before)[:, None])


class _Other:
    """Detector of markers that are told from each other, without the regions."""

    def __init__(self, detector: MarkerDetector, regions: Sequence[Region]) -> None:
        self._detector = detector
        self._regions = regions

    def detect(self, frames: list[GrayImage]) -> FoundMarkers | NothingFound:
        height, width = frames[0].shape
        for region in self._regions:
            (left, top), (right, bottom) = np.sort(np.asarray(region, dtype=float), axis=0)
            if right < 0.0 or bottom < 0.0 or left > width - 1 or top > height - 1:
                return NothingFound(
                    f"the region of leave_out_px from ({left:g}, {top:g}) to ({right:g}, {bottom:g}) lies outside the "
                    f"image of {width} x {height} px"
                )
        return self._detector.detect([filled(frame, self._regions) for frame in frames])

    def redetect(self, image: GrayImage, sought: tuple[Detection, ...]) -> list[Detection]:
        return self._detector.redetect(filled(image, self._regions), sought)


class _Similar(_Other):
    """The same for markers that cannot be told from each other."""

    def candidates(self, image: GrayImage, sought: tuple[Detection, ...]) -> Candidates:
        detector = cast("SimilarMarkerDetector", self._detector)
        return detector.candidates(filled(image, self._regions), sought)

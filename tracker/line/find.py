"""The line found by itself: a long thin structure that moves in a picture at rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from tracker.arrays import BoolArray, FloatArray, GrayImage
from tracker.checks import Failure
from tracker.line.follower import find_path, straightened
from tracker.line.model import CurveAt


@dataclass(frozen=True)
class Tuning:
    """The line found by its motion."""

    #: [frames] in which pixels are compared
    #: convention: limits time
    frames: int = 16
    #: [1] standard deviation over time, relative to that of a typical pixel, from which a pixel shows motion
    #: statistics: noise alone never does
    moves: float = 3.0
    #: [gray levels] standard deviation of a typical pixel, at least
    #: convention: rounding and a codec that repeats pixels hide the noise
    least_noise: float = 0.5
    #: [px] parts of the moving area that are closer belong together
    gap_px: int = 12
    #: [px] of a line
    least_length_px: float = 40.0
    #: [1] length of a line over its width
    least_elongation: float = 4.0
    #: [1] the line goes on towards the clamp while its contrast is above this share of the typical one
    #: physics: half of the contrast is the edge of a blurred strip
    least_contrast: float = 0.5
    #: [px] over which that contrast is taken
    window_px: int = 6
    #: [1] another area with this share of the motion makes the choice ambiguous, unless it is on the same line
    second: float = 0.3
    #: [1] share of the motion of another area on the same line that is part of it
    least_share: float = 0.02
    #: [1] share of the length in which the free end moves more than the clamp
    #: physics: beyond the last node of mode 5
    end_share: float = 0.05
    #: [px] between places along the line
    spacing_px: float = 2.0
    #: [px] of the image that are not used
    border_px: float = 2.0
    #: [1] share of the moving part in which the strip must be seen
    least_seen: float = 0.8
    #: [1] share of the moving pixels at either end of the area that is left out
    extreme: float = 0.002
    #: [px] beside a line, and at least for its half width, where its strip is sought
    reach_px: float = 12.0


TUNING = Tuning()


def find_line(images: list[GrayImage]) -> FloatArray | Failure:
    """Clamped end and free end in the first image, shape (2, 2).

    The axis of the largest area in which pixels change; the free end is that which moves more. From the other end the
    strip is followed, at rest, to where its contrast ends: at the clamp or the border.
    """
    chosen = np.linspace(0, len(images) - 1, min(TUNING.frames, len(images))).astype(int)
    stack = np.stack([images[k] for k in chosen]).astype(np.float32)
    moving = _moving_area(stack.std(axis=0))
    if isinstance(moving, Failure):
        return moving
    if not moving.is_thin:
        length = moving.high - moving.low
        return Failure(
            f"what moves is {length:.0f} px long and about {moving.width:.0f} px wide: not a thin line"
        )
    axis, low, high = moving.axis, moving.low, moving.high
    # A larger amplitude changes more pixels, by more.
    if moving.begins_stronger:
        axis, low, high = -axis, -high, -low
    return _traced(
        images[0],
        moving.middle,
        axis,
        low,
        high,
        reach_px=int(max(moving.width, TUNING.reach_px)) + int(TUNING.reach_px),
    )


@dataclass(frozen=True)
class _Area:
    """Extent of an area along its axis, from `low` to `high` about its middle, and its width, in px."""

    middle: FloatArray
    axis: FloatArray
    low: float
    high: float
    width: float
    begins_stronger: bool

    @property
    def is_thin(self) -> bool:
        length = self.high - self.low
        return length >= TUNING.least_length_px and length >= TUNING.least_elongation * self.width


def _extent(change: FloatArray, area: BoolArray) -> _Area:
    rows, columns = np.nonzero(area)
    points = np.stack([columns, rows], axis=1).astype(np.float64)
    weights = change[area].astype(np.float64)
    middle = np.average(points, axis=0, weights=weights)
    axis = np.linalg.eigh(np.cov(points.T, aweights=weights))[1][:, 1]
    along, across = (points - middle) @ axis, (points - middle) @ np.array([-axis[1], axis[0]])
    low, high = (float(q) for q in np.quantile(along, (TUNING.extreme, 1.0 - TUNING.extreme)))
    end = TUNING.end_share * (high - low)
    near, far = (weights[part].sum() for part in (along < low + end, along > high - end))
    return _Area(middle, axis, low, high, 4.0 * float(np.median(np.abs(across))), bool(near > far))


def _moving_area(change: FloatArray) -> _Area | Failure:
    """The area with most motion, and others on one line with it: between them are nodes of the motion."""
    moves = change > TUNING.moves * max(float(np.median(change)), TUNING.least_noise)
    labels, count = ndimage.label(ndimage.binary_dilation(moves, iterations=TUNING.gap_px))
    if count == 0:
        return Failure("nothing moves in the first frames")
    total = ndimage.sum_labels(change * moves, labels, np.arange(1, count + 1))
    order = np.argsort(total)[::-1]
    area = moves & (labels == order[0] + 1)
    found = _extent(change, area)
    for k in order[1:]:
        if total[k] < TUNING.least_share * total[order[0]]:
            break
        joint_area = area | (moves & (labels == k + 1))
        joint = _extent(change, joint_area)
        if joint.is_thin:
            area, found = joint_area, joint
        elif total[k] > TUNING.second * total[order[0]]:
            return Failure("more than one object moves in the first frames")
    return found


def _traced(
    image: GrayImage, middle: FloatArray, axis: FloatArray, low: float, high: float, *, reach_px: int
) -> FloatArray | Failure:
    """Ends of the strip along an axis, from beyond the clamp to the free end at `high`."""
    height, width = image.shape
    limit = np.array([width, height]) - 1.0 - TUNING.border_px
    steps = np.arange(low, -np.hypot(width, height), -TUNING.spacing_px)
    inside = np.all(
        (middle + steps[:, None] * axis >= TUNING.border_px) & (middle + steps[:, None] * axis <= limit),
        axis=1,
    )
    first = float(steps[np.argmin(inside) - 1]) if not np.all(inside) and inside[0] else low
    count = max(int((high - first) / TUNING.spacing_px), 8)
    places = first + (np.arange(count) + 0.5) / count * (high - first)
    curve = CurveAt(
        middle + places[:, None] * axis, np.tile(axis, (count, 1)), np.zeros(count), np.ones(count)
    )
    path = find_path(
        straightened(image, curve, reach_px, TUNING.spacing_px), TUNING.spacing_px, "strip", float(reach_px)
    )
    moving = places > low
    typical = float(np.median(path.contrast[moving]))
    window = int(TUNING.window_px / TUNING.spacing_px)
    smooth = ndimage.median_filter(path.contrast, size=2 * window + 1, mode="nearest")
    seen = smooth > TUNING.least_contrast * typical
    if not typical > 0.0 or np.mean(seen[moving]) < TUNING.least_seen:
        return Failure("what moves is not a strip, dark or light on both sides, in the first frame")
    begin = int(np.argmax(moving))
    while begin > 0 and seen[begin - 1]:
        begin -= 1
    ends = [curve.points[k] + path.offsets_px[k] * curve.normals[k] for k in (begin, count - 1)]
    return np.array(ends)

"""The line found by itself: a long thin structure that moves in a picture at rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from tracker.arrays import BoolArray, FloatArray, GrayImage
from tracker.line.curve import CurveAt
from tracker.line.follower import find_path, straightened

FRAMES = 16
# Standard deviation over time, relative to that of a typical pixel, from which a pixel shows motion.
MOVES = 3.0
# Parts of the moving area closer than this belong together.
GAP_PX = 12
LEAST_LENGTH_PX, LEAST_ELONGATION = 40.0, 4.0
# The line goes on towards the clamp while its contrast is above this share of the typical one, over this many px.
LEAST_CONTRAST, WINDOW_PX = 0.5, 6
# Another area with this share of the motion makes the choice ambiguous, unless it is on the same line; with the lower
# share it is part of that line.
SECOND, LEAST_SHARE = 0.3, 0.02
# The free end moves more than the clamp within this share of the length, which is beyond the last node of mode 5.
END_SHARE = 0.05
SPACING_PX = 2.0
BORDER_PX = 2.0


@dataclass(frozen=True)
class NoMovingLine:
    """No line was found: falsy, with the reason."""

    reason: str

    def __bool__(self) -> bool:
        return False


def find_line(images: list[GrayImage]) -> FloatArray | NoMovingLine:
    """Clamped end and free end in the first image, shape (2, 2).

    The axis of the largest area in which pixels change; the free end is that which moves more. From the other end the
    strip is followed, at rest, to where its contrast ends: at the clamp or the border.
    """
    chosen = np.linspace(0, len(images) - 1, min(FRAMES, len(images))).astype(int)
    stack = np.stack([images[k] for k in chosen]).astype(np.float32)
    moving = _moving_area(stack.std(axis=0))
    if isinstance(moving, NoMovingLine):
        return moving
    if not moving.is_thin:
        length = moving.high - moving.low
        return NoMovingLine(
            f"what moves is {length:.0f} px long and about {moving.width:.0f} px wide: not a thin line"
        )
    axis, low, high = moving.axis, moving.low, moving.high
    # A larger amplitude changes more pixels, by more.
    if moving.begins_stronger:
        axis, low, high = -axis, -high, -low
    return _traced(images[0], moving.middle, axis, low, high, reach_px=int(max(moving.width, 12.0)) + 12)


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
        return length >= LEAST_LENGTH_PX and length >= LEAST_ELONGATION * self.width


def _extent(change: FloatArray, area: BoolArray) -> _Area:
    rows, columns = np.nonzero(area)
    points = np.stack([columns, rows], axis=1).astype(np.float64)
    weights = change[area].astype(np.float64)
    middle = np.average(points, axis=0, weights=weights)
    axis = np.linalg.eigh(np.cov(points.T, aweights=weights))[1][:, 1]
    along, across = (points - middle) @ axis, (points - middle) @ np.array([-axis[1], axis[0]])
    low, high = (float(q) for q in np.quantile(along, (0.002, 0.998)))
    end = END_SHARE * (high - low)
    near, far = (weights[part].sum() for part in (along < low + end, along > high - end))
    return _Area(middle, axis, low, high, 4.0 * float(np.median(np.abs(across))), bool(near > far))


def _moving_area(change: FloatArray) -> _Area | NoMovingLine:
    """The area with most motion, and others on one line with it: between them are nodes of the motion."""
    moves = change > MOVES * max(float(np.median(change)), 0.5)
    labels, count = ndimage.label(ndimage.binary_dilation(moves, iterations=GAP_PX))
    if count == 0:
        return NoMovingLine("nothing moves in the first frames")
    total = ndimage.sum_labels(change * moves, labels, np.arange(1, count + 1))
    order = np.argsort(total)[::-1]
    area = moves & (labels == order[0] + 1)
    found = _extent(change, area)
    for k in order[1:]:
        if total[k] < LEAST_SHARE * total[order[0]]:
            break
        joint_area = area | (moves & (labels == k + 1))
        joint = _extent(change, joint_area)
        if joint.is_thin:
            area, found = joint_area, joint
        elif total[k] > SECOND * total[order[0]]:
            return NoMovingLine("more than one object moves in the first frames")
    return found


def _traced(
    image: GrayImage, middle: FloatArray, axis: FloatArray, low: float, high: float, *, reach_px: int
) -> FloatArray | NoMovingLine:
    """Ends of the strip along an axis, from beyond the clamp to the free end at `high`."""
    height, width = image.shape
    limit = np.array([width, height]) - 1.0 - BORDER_PX
    steps = np.arange(low, -np.hypot(width, height), -SPACING_PX)
    inside = np.all(
        (middle + steps[:, None] * axis >= BORDER_PX) & (middle + steps[:, None] * axis <= limit), axis=1
    )
    first = float(steps[np.argmin(inside) - 1]) if not np.all(inside) and inside[0] else low
    count = max(int((high - first) / SPACING_PX), 8)
    places = first + (np.arange(count) + 0.5) / count * (high - first)
    curve = CurveAt(
        middle + places[:, None] * axis, np.tile(axis, (count, 1)), np.zeros(count), np.ones(count)
    )
    path = find_path(straightened(image, curve, reach_px, SPACING_PX), SPACING_PX, "strip", float(reach_px))
    moving = places > low
    typical = float(np.median(path.contrast[moving]))
    window = int(WINDOW_PX / SPACING_PX)
    smooth = ndimage.median_filter(path.contrast, size=2 * window + 1, mode="nearest")
    seen = smooth > LEAST_CONTRAST * typical
    if not typical > 0.0 or np.mean(seen[moving]) < 0.8:
        return NoMovingLine("what moves is not a strip, dark or light on both sides, in the first frame")
    begin = int(np.argmax(moving))
    while begin > 0 and seen[begin - 1]:
        begin -= 1
    ends = [curve.points[k] + path.offsets_px[k] * curve.normals[k] for k in (begin, count - 1)]
    return np.array(ends)

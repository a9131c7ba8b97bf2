"""Motion of round spots in the first frames: spots on the beam move, those in the background do not."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy  # its parts are loaded when they are used

from tracker.arrays import BoolArray, FloatArray, GrayImage
from tracker.markers.assignment import Scene, assign, completed
from tracker.markers.base import Candidates
from tracker.markers.common_motion import CommonMotion

# Frames used, evenly spread over those given.
FRAMES = 9
# A spot whose centroid moves by more than the first has moved; by less than the second, it is still.
MOVED_PX, STILL_PX = 0.4, 0.15
# A spot is tracked in a window of this many diameters about its centre, which is recentred this often.
REACH, CENTRINGS = 1.5, 2
# A spot is lost when less than this share of its contrast is left in the window.
LEAST_CONTRAST = 0.4
# A still spot belongs to the line of the moving ones when it lies within this many diameters of it.
BESIDE = 1.5


def spot_motion(frames: list[GrayImage], points_px: FloatArray, diameters_px: FloatArray) -> FloatArray:
    """Range of each spot's centroid over a few frames, in px; shape (k,).

    The centroid is that of a window of two diameters about the spot's position in the first frame: it underestimates
    motion beyond half a diameter, which exceeds both thresholds anyway.
    """
    picks = sorted({int(k) for k in np.linspace(0, len(frames) - 1, FRAMES)})
    spots = list(zip(points_px, diameters_px, strict=True))
    positions = np.array([[_centroid(frames[k], *spot)[:2] for spot in spots] for k in picks])
    return np.asarray(np.hypot(*np.ptp(positions, axis=0).T))


def centroid_path(frames: list[GrayImage], point_px: FloatArray, diameter_px: float) -> FloatArray:
    """Centroid of a spot of the first frame in each frame, shape (n, 2), NaN from where it is lost.

    Blur along the motion does not shift it: accurate to about a pixel.
    """
    positions = np.full((len(frames), 2), np.nan)
    position, step = np.asarray(point_px, dtype=np.float64), np.zeros(2)
    first = 0.0
    for k, image in enumerate(frames):
        aim, contrast = position + step, 0.0
        for _ in range(CENTRINGS):
            x, y, contrast = _centroid(image, aim, REACH * diameter_px)
            aim = np.array([x, y])
        first = first or contrast
        if contrast < LEAST_CONTRAST * first:
            break
        step, position = aim - position if k else step, aim
        positions[k] = position
    return positions


def spot_paths(
    frames: list[GrayImage],
    points_px: FloatArray,
    diameters_px: FloatArray,
    find: Callable[[GrayImage, FloatArray], Candidates],
) -> tuple[FloatArray, bool]:
    """Paths of the spots of the first frame, shape (k, n, 2), and whether they had to be assigned jointly.

    Each spot is followed from frame to frame. Where one is lost on the way or two meet, as motion by more than a
    diameter between frames causes, the candidates `find(image, expected)` of each frame are assigned to all spots
    together; NaN where that leaves a spot without one.
    """
    spots = zip(points_px, diameters_px, strict=True)
    single = np.array([centroid_path(frames, point, diameter) for point, diameter in spots])
    if np.all(np.isfinite(single)) and not _any_meet(single, 0.5 * float(diameters_px.min())):
        return single, False
    paths = np.full_like(single, np.nan)
    size = float(np.median(diameters_px))
    motion, last = CommonMotion(points_px, size), points_px
    for k, image in enumerate(frames):
        expected = motion.expect(last, np.isfinite(last[:, 0]))
        seen = find(image, expected.where_px)
        found = assign(Scene(expected, seen.centres_px, size, seen.corners_px))
        chosen = found.spots >= 0
        paths[chosen, k] = seen.centres_px[found.spots[chosen]]
        last = paths[:, k]
        motion.assigned(found.motion_px, completed(last, motion.form_px))
        motion.saw(last)
    return paths, True


def _any_meet(paths: FloatArray, near_px: float) -> bool:
    return len(paths) > 1 and any(
        scipy.spatial.distance.pdist(at).min() < near_px for at in np.swapaxes(paths, 0, 1)
    )


def stillest_frame(path_px: FloatArray) -> int:
    """Frame in which a spot with this path, shape (n, 2), moves least; the first unless another is clearly better."""
    if len(path_px) < 3:
        return 0
    speed = np.linalg.norm(path_px[2:] - path_px[:-2], axis=1) / 2.0
    if not np.isfinite(speed[0]):
        return 0
    best = 1 + int(np.nanargmin(speed))
    return best if speed[0] > MOVED_PX and speed[best - 1] <= 0.5 * speed[0] else 0


def _centroid(image: GrayImage, point: FloatArray, diameter: float) -> tuple[float, float, float]:
    """Centroid of a spot, x and y, and its contrast: the largest difference from the rim of the window.

    The centroid is that of the pixels that differ from the rim by more than half the contrast. Without contrast, or
    with the window outside the image: the point itself and 0.
    """
    half = max(round(diameter), 3)
    x, y = round(float(point[0])), round(float(point[1]))
    left, top = max(x - half, 0), max(y - half, 0)
    part = image[top : max(y + half + 1, 0), left : max(x + half + 1, 0)].astype(np.float64)
    if part.size == 0:
        return float(point[0]), float(point[1]), 0.0
    rim = np.concatenate([part[0], part[-1], part[:, 0], part[:, -1]])
    weight = np.abs(part - np.median(rim))
    contrast = float(weight.max())
    weight = np.maximum(weight - 0.5 * contrast, 0.0)
    total = float(weight.sum())
    if total == 0.0:
        return float(point[0]), float(point[1]), 0.0
    rows, columns = np.indices(part.shape)
    return (
        left + float((weight * columns).sum()) / total,
        top + float((weight * rows).sum()) / total,
        contrast,
    )


def still_and_beside(points_px: FloatArray, diameters_px: FloatArray, motion_px: FloatArray) -> BoolArray:
    """Spots that stand still beside the line of the moving ones: background, not the clamped end of the beam.

    All False where fewer than two spots move.
    """
    moving = motion_px > MOVED_PX
    if np.count_nonzero(moving) < 2:
        return np.zeros(len(points_px), dtype=bool)
    centre = points_px[moving].mean(axis=0)
    axis = np.linalg.svd(points_px[moving] - centre, full_matrices=False)[2][0]
    off = np.abs((points_px - centre) @ np.array([-axis[1], axis[0]]))
    # A bent beam is not a straight line: a distance that its own dots have counts as on the line.
    limit = np.maximum(BESIDE * diameters_px, 2.0 * float(off[moving].max()))
    return np.asarray((motion_px < STILL_PX) & (off > limit))

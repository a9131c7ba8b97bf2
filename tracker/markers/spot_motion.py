"""Motion of round spots in the first frames: spots on the beam move, those in the background do not."""

from __future__ import annotations

import numpy as np

from tracker.arrays import BoolArray, FloatArray, GrayImage

# Frames used, evenly spread over those given.
FRAMES = 9
# A spot whose centroid moves by more than the first has moved; by less than the second, it is still.
MOVED_PX, STILL_PX = 0.4, 0.15
# A spot is tracked in a window of this many diameters about its centre, which is recentred this often.
REACH, CENTRINGS = 1.5, 2
# A still spot belongs to the line of the moving ones when it lies within this many diameters of it.
BESIDE = 1.5


def spot_motion(frames: list[GrayImage], points_px: FloatArray, diameters_px: FloatArray) -> FloatArray:
    """Range of each spot's centroid over a few frames, in px; shape (k,).

    The centroid is that of a window of two diameters about the spot's position in the first frame: it underestimates
    motion beyond half a diameter, which exceeds both thresholds anyway.
    """
    picks = sorted({int(k) for k in np.linspace(0, len(frames) - 1, FRAMES)})
    spots = list(zip(points_px, diameters_px, strict=True))
    positions = np.array([[_centroid(frames[k], *spot) for spot in spots] for k in picks])
    return np.asarray(np.hypot(*np.ptp(positions, axis=0).T))


def stillest_frame(
    frames: list[GrayImage], point_px: FloatArray, diameter_px: float
) -> tuple[int, FloatArray]:
    """Frame in which a spot of the first frame moves least, and its position there.

    Its centroid is tracked, which blur along the motion does not shift: accurate to about a pixel.
    """
    positions = np.full((len(frames), 2), np.nan)
    position, step = np.asarray(point_px, dtype=np.float64), np.zeros(2)
    for k, image in enumerate(frames):
        aim = position + step
        for _ in range(CENTRINGS):
            aim = np.array(_centroid(image, aim, REACH * diameter_px))
        step, position = aim - position if k else step, aim
        positions[k] = position
    if len(frames) < 3:
        return 0, positions[0]
    speed = np.linalg.norm(positions[2:] - positions[:-2], axis=1) / 2.0
    best = 1 + int(np.argmin(speed))
    if speed[0] <= MOVED_PX or speed[best - 1] > 0.5 * speed[0]:
        return 0, positions[0]
    return best, positions[best]


def _centroid(image: GrayImage, point: FloatArray, diameter: float) -> tuple[float, float]:
    """Centroid of the pixels that differ from the window's rim by more than half the largest difference."""
    half = max(round(diameter), 3)
    x, y = round(float(point[0])), round(float(point[1]))
    left, top = max(x - half, 0), max(y - half, 0)
    part = image[top : y + half + 1, left : x + half + 1].astype(np.float64)
    rim = np.concatenate([part[0], part[-1], part[:, 0], part[:, -1]])
    weight = np.abs(part - np.median(rim))
    weight = np.maximum(weight - 0.5 * weight.max(), 0.0)
    total = float(weight.sum())
    if total == 0.0:
        return float(point[0]), float(point[1])
    rows, columns = np.indices(part.shape)
    return left + float((weight * columns).sum()) / total, top + float((weight * rows).sum()) / total


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

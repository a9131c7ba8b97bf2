"""Motion in the first frames: points to follow as patches, spots that move, and motion common to all markers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
import scipy  # its parts are loaded when they are used
from numpy.typing import NDArray

from tracker.arrays import BoolArray, FloatArray, GrayImage, robust_sd
from tracker.markers.assignment import Expectation, Scene, assign, completed, spacing_px
from tracker.markers.kind import Candidates
from tracker.video import to_8_bit


@dataclass(frozen=True)
class Tuning:
    """Points to propose, motion that all markers have in common, and spots that move."""

    #: [px] side of the window about a point
    #: convention: the smallest of a patch
    window_px: int = 31
    #: [frames] that are compared
    #: convention: limits time
    frames: int = 16
    #: [sd] of the still part's change, from which a window moves
    #: statistics: noise alone exceeds it in one of 740
    moves: float = 3.0
    #: [gray levels] of that sd, at least
    #: convention: rounding leaves it
    least_spread: float = 0.02
    #: [px] of the image before differentiation
    blur_px: float = 1.0
    #: [1] eigenvalue of the structure tensor that is added to those of bare windows
    bare: float = 1.0
    #: [1] share of the change that a shift explains of a window that moves as a whole
    #: measurement: filmed forks: 0.58 to 0.94 at their weights, 0.03 to 0.32 at turning gears beside them
    rigid: float = 0.5
    #: [1] of the best score, below which a point is not proposed
    #: convention: chosen; effect on proposals only
    worth: float = 0.05
    #: [px] sd of expected positions before any motion
    first_sd_px: float = 1.0
    #: [1] its factor per frame
    fading: float = 0.9
    #: [1] its factor where nothing was found
    growth: float = 1.5
    #: [1] from one side to the other after which the range of an oscillation is known
    #: convention: a cycle and a half
    passes: int = 3
    #: [1] of the range from its middle, where a side begins
    side: float = 0.25
    #: [1] growth of the range from which passes are counted anew
    grown: float = 1.2
    #: [1] of the range, sd by which the motion may exceed it
    beyond: float = 0.08
    #: [1] of the range: predictions with a larger error are no better than the range itself
    #: physics: a position anywhere within a range has a standard deviation of 0.29 of it
    poor: float = 0.25
    #: [1] spacings within which the expected position of a marker is near that of all others
    consistent: float = 0.3
    #: [frames] in which spots are compared
    #: convention: limits time
    motion_frames: int = 9
    #: [px] a spot whose centroid moves by more has moved
    moved_px: float = 0.4
    #: [px] one that moves by less is still
    still_px: float = 0.15
    #: [1] diameters of the window about a spot in which it is tracked
    reach: float = 1.5
    #: [1] times that the window is centred again
    centrings: int = 2
    #: [1] of its contrast, without which a spot is lost
    least_contrast: float = 0.4
    #: [1] diameters within which a still spot belongs to the line of the moving ones
    #: convention: a bent beam is no straight line
    beside: float = 1.5


TUNING = Tuning()

Image = NDArray[np.float32]


def propose_points(frames: list[GrayImage], most: int = 6) -> FloatArray:
    """Centres of at most `most` windows with texture that moves, best first.

    First those that move as a whole: a shift (Lucas and Kanade) explains most of the change of their pixels, in which
    the noise of single pixels averages out, so that a motion of a tenth of a pixel shows. They are ranked by that
    change times the root of the smaller eigenvalue of the structure tensor, after Shi and Tomasi. Then those whose
    pixels change in another way, as by a motion of many pixels, ranked by the mean change times the eigenvalue. Both
    changes count beyond that of the still part of the image. Windows do not overlap.

    Parameters
    ----------
    frames : list of arrays, shape (height, width)
        A few frames in which the object moves.

    Returns
    -------
    array, shape (k, 2)
        x and y in px; empty where nothing moves or the image is smaller than two windows.
    """
    picks = sorted({int(k) for k in np.linspace(0, len(frames) - 1, TUNING.frames)})
    stack = np.array([to_8_bit(frames[k]) for k in picks], dtype=np.float32)
    height, width = stack.shape[1:]
    if len(stack) < 3 or min(height, width) < 2 * TUNING.window_px:
        return np.empty((0, 2))
    mean = stack.mean(axis=0)
    changes = _without_flicker(stack - mean, mean)
    down, across = np.gradient(cv2.GaussianBlur(mean, (0, 0), TUNING.blur_px))
    tensor = tuple(_windowed(product) for product in (across**2, down**2, across * down))
    xx, yy, xy = tensor
    weak = np.maximum(0.5 * (xx + yy - np.sqrt((xx - yy) ** 2 + 4.0 * xy**2)), 0.0)
    explained, total = _explained_by_shift(changes, (across, down), tensor)
    rigid = _beyond_still(np.sqrt(explained)) * (explained > TUNING.rigid * total)
    other = _beyond_still(_windowed(changes.std(axis=0)))
    found: list[tuple[float, float]] = []
    for score in (np.sqrt(weak) * rigid, weak * other):
        _add_peaks(found, score, most)
    return np.array(found).reshape(-1, 2)


def _windowed(image: Image) -> Image:
    """Mean over the window about each pixel."""
    return np.asarray(cv2.blur(image, (TUNING.window_px, TUNING.window_px)))


def _without_flicker(changes: Image, mean: Image) -> Image:
    """Changes of each frame, shape (n, height, width), less those of the brightness of the whole picture."""
    basis = np.column_stack([np.ones(mean.size, np.float32), mean.ravel()])
    flat = changes.reshape(len(changes), -1)
    common = np.linalg.lstsq(basis, flat.T, rcond=None)[0]
    return np.asarray((flat - common.T @ basis.T).reshape(changes.shape))


def _explained_by_shift(
    changes: Image, slopes: tuple[Image, Image], tensor: tuple[Image, ...]
) -> tuple[Image, Image]:
    """Mean square over the frames of the change that the best shift of each window explains, and of all change."""
    (across, down), (xx, yy, xy) = slopes, tensor
    xx, yy = xx + TUNING.bare, yy + TUNING.bare
    explained, total = np.zeros_like(across), np.zeros_like(across)
    for change in changes:
        smooth = cv2.GaussianBlur(change, (0, 0), TUNING.blur_px)
        x, y = _windowed(across * smooth), _windowed(down * smooth)
        explained += (yy * x**2 - 2.0 * xy * x * y + xx * y**2) / (xx * yy - xy**2)
        total += _windowed(smooth**2)
    count = np.float32(len(changes))
    return np.asarray(explained / count), np.asarray(total / count)


def _beyond_still(change: Image) -> Image:
    """Change of each window beyond that of the still part of the image."""
    still = float(np.median(change))
    spread = robust_sd(change - still)
    return np.asarray(np.maximum(change - still - TUNING.moves * max(spread, TUNING.least_spread), 0.0))


def _add_peaks(found: list[tuple[float, float]], score: Image, most: int) -> None:
    """Add the largest values away from the edges of the picture, each a window away from those found before."""
    margin = TUNING.window_px // 2 + 3
    left = np.zeros_like(score)
    left[margin:-margin, margin:-margin] = score[margin:-margin, margin:-margin]
    least = TUNING.worth * float(left.max())
    for x, y in found:
        _take_out(left, round(x), round(y))
    while len(found) < most:
        row, column = np.unravel_index(int(np.argmax(left)), left.shape)
        if left[row, column] <= least:
            return
        found.append((float(column), float(row)))
        _take_out(left, int(column), int(row))


def _take_out(score: Image, x: int, y: int) -> None:
    score[
        max(y - TUNING.window_px, 0) : y + TUNING.window_px + 1,
        max(x - TUNING.window_px, 0) : x + TUNING.window_px + 1,
    ] = 0.0


class CommonMotion:
    """Running error of the predictions, and the limits between which all markers have swung so far.

    Predictions are useless where markers move far between frames. What remains known is the range of an oscillation:
    once it has passed back and forth, positions beyond it are improbable.
    """

    def __init__(self, first_px: FloatArray, size_px: float) -> None:
        self._first, self._size = first_px, size_px
        self.form_px = first_px.copy()
        self._sd_px, self._frames = TUNING.first_sd_px, 0
        self._low, self._high = np.zeros(2), np.zeros(2)
        self._side, self._passes, self._counted_px = 0, 0, 0.0

    def saw(self, positions_px: FloatArray) -> None:
        """After each frame: positions of all markers, shape (m, 2), NaN where missing."""
        self._frames += 1
        seen = np.isfinite(positions_px[:, 0])
        if not seen.any():
            return
        moved = (positions_px[seen] - self._first[seen]).mean(axis=0)
        self._low, self._high = np.minimum(self._low, moved), np.maximum(self._high, moved)
        axis = int(np.argmax(self._high - self._low))
        extent = float(self._high[axis] - self._low[axis])
        if extent > TUNING.grown * self._counted_px:
            self._passes, self._counted_px = 0, extent
        reach = TUNING.side * extent
        off = float(moved[axis] - 0.5 * (self._low[axis] + self._high[axis]))
        side = int(np.sign(off)) if abs(off) > reach else 0
        if side and side != self._side:
            self._passes += self._side != 0
            self._side = side

    def assigned(self, motion_px: FloatArray, form_px: FloatArray) -> None:
        """After an assignment: its motion from the expected positions, NaN where none was found, and all markers."""
        found = bool(np.all(np.isfinite(motion_px)))
        missed = float(np.hypot(*motion_px)) if found else self._sd_px * TUNING.growth
        self._sd_px, self._frames = max(missed, self.sd_px()), 0
        self.form_px = form_px

    def sd_px(self) -> float:
        """Uncertainty of predictions: the largest recent error, which fades while nothing unexpected happens."""
        return float(max(self._sd_px * TUNING.fading**self._frames, TUNING.first_sd_px))

    def is_unpredictable(self, share: float) -> bool:
        """Whether predictions err by more than this share of the spacing between markers."""
        return self.sd_px() > share * float(spacing_px(self.form_px, self._size).min())

    def expect(self, predicted_px: FloatArray, known: BoolArray) -> Expectation:
        """Where markers are expected, from predictions, shape (m, 2), of those `known` in the last frame."""
        extent = float((self._high - self._low).max())
        swings = self._passes >= TUNING.passes
        if swings and (self.sd_px() > TUNING.poor * extent or not known.any()):
            # The middle of the range; anywhere within it is equally probable.
            where, sd_px = self._first + 0.5 * (self._low + self._high), float("inf")
        elif known.any():
            common = self.form_px + np.median(predicted_px[known] - self.form_px[known], axis=0)
            near = np.hypot(*(predicted_px - common).T) < TUNING.consistent * spacing_px(
                self.form_px, self._size
            )
            where, sd_px = np.where((known & near)[:, None], predicted_px, common), self.sd_px()
        else:
            where, sd_px = self.form_px, self.sd_px()
        if not swings:
            return Expectation(where, sd_px)
        moved = (where - self._first).mean(axis=0)
        limits = np.stack([self._low, self._high]) - moved
        return Expectation(where, sd_px, limits, TUNING.beyond * extent + TUNING.first_sd_px)


def spot_motion(frames: list[GrayImage], points_px: FloatArray, diameters_px: FloatArray) -> FloatArray:
    """Range of each spot's centroid over a few frames, in px; shape (k,).

    The centroid is that of a window of two diameters about the spot's position in the first frame: it underestimates
    motion beyond half a diameter, which exceeds both thresholds anyway.
    """
    picks = sorted({int(k) for k in np.linspace(0, len(frames) - 1, TUNING.motion_frames)})
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
        for _ in range(TUNING.centrings):
            x, y, contrast = _centroid(image, aim, TUNING.reach * diameter_px)
            aim = np.array([x, y])
        first = first or contrast
        if contrast < TUNING.least_contrast * first:
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
    speed[np.isnan(path_px[1:-1, 0])] = np.nan  # the spot is not seen there
    if not np.isfinite(speed[0]):
        return 0
    best = 1 + int(np.nanargmin(speed))
    return best if speed[0] > TUNING.moved_px and speed[best - 1] <= 0.5 * speed[0] else 0


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
    moving = motion_px > TUNING.moved_px
    if np.count_nonzero(moving) < 2:
        return np.zeros(len(points_px), dtype=bool)
    centre = points_px[moving].mean(axis=0)
    axis = np.linalg.svd(points_px[moving] - centre, full_matrices=False)[2][0]
    off = np.abs((points_px - centre) @ np.array([-axis[1], axis[0]]))
    # A bent beam is not a straight line: a distance that its own dots have counts as on the line.
    limit = np.maximum(TUNING.beside * diameters_px, 2.0 * float(off[moving].max()))
    return np.asarray((motion_px < TUNING.still_px) & (off > limit))

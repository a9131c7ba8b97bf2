"""Repeated frames: a camera, codec or converter shows an image again although the scene was moving."""

from __future__ import annotations

import cv2
import numpy as np

from tracker.arrays import BoolArray, FloatArray, GrayImage

# One row in this many is compared: enough for a mean over the image.
ROW_STEP = 4
# The change of a repeated image is below this share of that of a moving scene: a codec may refine it. Below the second
# share it is most likely repeated.
SMALL = 0.3
VERY_SMALL = 0.1
# Frames from which a position is predicted, and how many frames ahead at most.
ORDER = 8
HORIZON = 4
# Approximate maximum number of windows from which the prediction is learned.
WINDOWS = 2_000
# Deviation from the prediction, in sd, by which the motion contradicts that the scene stopped.
CONTRADICTED = 5.0
# Rms deviation of the frames before, in sd, that shows a real change of the motion.
DEPARTED = 3.0
# Predictions are at best this precise, in px: errors of registration that do not average out.
LEAST_SD_PX = 2e-3
# Markers stop if they move by less than this share of their usual step, and at once if one of the two steps before was
# larger by this factor: over two slow frames of a vibration the speed changes less.
STOPPED = 0.25
STEPS_BEFORE = 2
ABRUPTNESS = 3.0


def image_change(before: GrayImage, image: GrayImage) -> float:
    """Mean absolute difference of two images of one size and type, in gray levels."""
    one, other = before[::ROW_STEP], image[::ROW_STEP]
    return float(cv2.norm(one, other, cv2.NORM_L1)) / one.size


def repeated_frames(change: FloatArray, x_px: FloatArray, y_px: FloatArray) -> BoolArray:
    """Frames that repeat the previous image although the markers were moving; shape (n,).

    Parameters
    ----------
    change : array, shape (n,)
        `image_change` from the last image to that of each frame; NaN where there is none.
    x_px, y_px : array, shape (n, m)
        Positions of the markers; NaN where missing.

    Notes
    -----
    Three criteria must hold. The image changes far less than others, though not necessarily by nothing: a lossy codec
    refines a repeated image. The markers stop abruptly. Their positions differ from those predicted by linear
    regression on the eight frames before, or on the eight after, which is exact for the sum of a few vibrations. A
    scene at rest, one that is brought to rest and a turning point of the motion are therefore not taken for
    repetitions. Where too few frames differ to learn the prediction, the first two criteria decide.
    Frames at the very beginning count if a run of the same length follows later.
    """
    usual_change = float(np.nanquantile(change, 0.75)) if np.any(np.isfinite(change)) else 0.0
    repeated = np.zeros(change.size, dtype=bool)
    with np.errstate(invalid="ignore"):
        still, surely = change < SMALL * usual_change, change < VERY_SMALL * usual_change
    if not np.any(still):
        return repeated
    positions = np.concatenate([x_px, y_px], axis=1)
    step = _steps(positions, still)
    moving = step[~still & (step > 0.0)]
    usual = float(np.median(moving)) if moving.size else 0.0
    stopped = still & (step < STOPPED * usual)
    motion = _Motion(positions, surely)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], stopped, [False]]).astype(np.int8)))
    for start, stop in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        before = step[max(start - STEPS_BEFORE, 0) : start]
        if start > 1 and before.max(initial=0.0) > ABRUPTNESS * float(step[start:stop].max()):
            off = motion.contradicts(start, stop, repeated)
            repeated[start:stop] = bool(np.all(surely[start:stop])) if off is None else off
    for k in np.flatnonzero(surely[1:]) + 1:
        repeated[k] |= repeated[k - 1]
    if edges.size and edges[0] == 1:
        length = int(edges[1] - edges[0])
        repeated[1 : 1 + length] = np.any(np.convolve(repeated, np.ones(length), "valid") == length)
    return repeated


def _steps(positions: FloatArray, still: BoolArray) -> FloatArray:
    """Steps from frame to frame of all c coordinates combined, shape (n,), each weighted by its usual step.

    Coordinates that hardly move show how a codec refines a repeated image, not whether the scene moves.
    """
    steps = np.abs(np.diff(positions, axis=0, prepend=np.nan))
    usual = np.array([np.median(s[np.isfinite(s)]) if np.isfinite(s).any() else 0.0 for s in steps[~still].T])
    weight = usual / max(float(usual.max(initial=0.0)), 1e-12)
    return np.asarray(np.sqrt(np.nansum((weight * steps) ** 2, axis=1)))


class _Motion:
    """Predictions of positions, shape (n, c), from the frames before or after, learned from the recording."""

    def __init__(self, positions: FloatArray, left_out: BoolArray) -> None:
        self._ways = tuple(
            (series, _predictors(series, without))
            for series, without in ((positions, left_out), (positions[::-1], left_out[::-1]))
        )

    def contradicts(self, start: int, stop: int, repeated: BoolArray) -> bool | None:
        """Whether frames deviate from the prediction; None where there is none, such as close to repeated frames."""
        n = repeated.size
        ahead = self._deviations(0, start, stop, repeated)
        if ahead.size:
            if ahead.max() <= CONTRADICTED:
                return False
            # A scene that is brought to rest deviates from the prediction before it rests.
            earlier = [self._deviations(0, k, k + 1, repeated) for k in range(start - ORDER, start)]
            departed = np.concatenate(earlier)
            return not (departed.size and np.sqrt(np.mean(departed**2)) > DEPARTED)
        back = self._deviations(1, n - stop, n - start, repeated[::-1])
        return bool(back.max() > CONTRADICTED) if back.size else None

    def _deviations(self, way: int, start: int, stop: int, repeated: BoolArray) -> FloatArray:
        """Deviations of frames from their predictions, in sd: of each coordinate and up to four frames, where known."""
        positions, predictors = self._ways[way]
        first = start - ORDER
        if first < 0 or np.any(repeated[first:start]):
            return np.empty(0)
        here = positions[start : min(stop, start + HORIZON)].T
        coefs, sd = predictors
        ahead = np.einsum("cho,oc->ch", coefs[:, : here.shape[1], :ORDER], positions[first:start])
        known = np.abs(here - ahead - coefs[:, : here.shape[1], ORDER]) / sd[:, : here.shape[1]]
        return np.asarray(known[np.isfinite(known)])


def _predictors(positions: FloatArray, left_out: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Predictions of c coordinates 1 to 4 frames ahead: coefficients (c, 4, 9), constant last, sd (c, 4); or NaN."""
    n, c = positions.shape
    coefs, sd = np.full((c, HORIZON, ORDER + 1), np.nan), np.full((c, HORIZON), np.nan)
    for k, series in enumerate(positions.T):
        good = np.isfinite(series) & ~left_out
        complete = np.convolve(good, np.ones(ORDER), "valid") > ORDER - 0.5
        centre = float(np.mean(series[good])) if np.any(good) else 0.0
        for ahead in range(min(HORIZON, n - ORDER)):
            reach = ORDER + ahead + 1
            windows = np.lib.stride_tricks.sliding_window_view(series, reach)
            valid = good[reach - 1 :]
            used = np.flatnonzero(complete[: valid.size] & valid)
            used = used[:: max(1, used.size // WINDOWS)]
            if used.size < 4 * ORDER:
                break
            design = np.column_stack([windows[used, :ORDER] - centre, np.ones(used.size)])
            target = windows[used, -1] - centre
            best = np.linalg.lstsq(design, target, rcond=None)[0]
            spread = 1.4826 * float(np.median(np.abs(target - design @ best)))
            # The constant for coordinates that are not centred.
            best[ORDER] += centre * (1.0 - best[:ORDER].sum())
            coefs[k, ahead], sd[k, ahead] = best, max(spread, LEAST_SD_PX)
    return coefs, sd

"""Frames that a camera, codec or converter shows again although the scene was moving."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from tracker.arrays import BoolArray, FloatArray, GrayImage
from tracker.spread import robust_sd


@dataclass(frozen=True)
class Tuning:
    """How an image and the motion differ where an image is repeated."""

    #: [1] one row in this many is compared
    #: convention: enough for a mean over the image
    row_step: int = 4
    #: [1] share of the change of a moving scene below which an image may be repeated
    #: convention: a codec may refine a repeated image
    small: float = 0.3
    #: [1] share below which it most likely is
    very_small: float = 0.1
    #: [1] quantile of the changes that is the moving scene's
    usual_change: float = 0.75
    #: [frames] from which a position is predicted
    #: physics: exact for the sum of up to four vibrations
    order: int = 8
    #: [frames] that are predicted, at most
    horizon: int = 4
    #: [1] windows from which the prediction is learned, approximately
    #: convention: limits time
    windows: int = 2000
    #: [sd] from the prediction, by which the motion contradicts that the scene stopped
    #: statistics: noise alone does so in one frame of two million
    contradicted: float = 5.0
    #: [sd] rms deviation of the frames before that shows a real change of the motion
    #: statistics: that of one coordinate of a frame exceeds it in one of 370
    departed: float = 3.0
    #: [px] sd of a prediction, at least
    #: convention: errors of registration do not average out
    least_sd_px: float = 2e-3
    #: [1] of their usual step, below which markers stop
    stopped: float = 0.25
    #: [frames] of which one was larger where markers stop at once
    #: convention: over two slow frames of a vibration the speed changes less
    steps_before: int = 2
    #: [1] factor by which it was
    #: convention: as above
    abruptness: float = 3.0


TUNING = Tuning()


def image_change(before: GrayImage, image: GrayImage) -> float:
    """Mean absolute difference of two images of one size and type, in gray levels."""
    one, other = before[:: TUNING.row_step], image[:: TUNING.row_step]
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
    usual_change = float(np.nanquantile(change, TUNING.usual_change)) if np.any(np.isfinite(change)) else 0.0
    repeated = np.zeros(change.size, dtype=bool)
    with np.errstate(invalid="ignore"):
        still, surely = change < TUNING.small * usual_change, change < TUNING.very_small * usual_change
    if not np.any(still):
        return repeated
    positions = np.concatenate([x_px, y_px], axis=1)
    step = _steps(positions, still)
    moving = step[~still & (step > 0.0)]
    usual = float(np.median(moving)) if moving.size else 0.0
    stopped = still & (step < TUNING.stopped * usual)
    motion = _Motion(positions, surely)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], stopped, [False]]).astype(np.int8)))
    for start, stop in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        before = step[max(start - TUNING.steps_before, 0) : start]
        if start > 1 and before.max(initial=0.0) > TUNING.abruptness * float(step[start:stop].max()):
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
            if ahead.max() <= TUNING.contradicted:
                return False
            # A scene that is brought to rest deviates from the prediction before it rests.
            earlier = [self._deviations(0, k, k + 1, repeated) for k in range(start - TUNING.order, start)]
            departed = np.concatenate(earlier)
            return not (departed.size and np.sqrt(np.mean(departed**2)) > TUNING.departed)
        back = self._deviations(1, n - stop, n - start, repeated[::-1])
        return bool(back.max() > TUNING.contradicted) if back.size else None

    def _deviations(self, way: int, start: int, stop: int, repeated: BoolArray) -> FloatArray:
        """Deviations of frames from their predictions, in sd: of each coordinate and up to four frames, where known."""
        positions, predictors = self._ways[way]
        first = start - TUNING.order
        if first < 0 or np.any(repeated[first:start]):
            return np.empty(0)
        here = positions[start : min(stop, start + TUNING.horizon)].T
        coefs, sd = predictors
        ahead = np.einsum("cho,oc->ch", coefs[:, : here.shape[1], : TUNING.order], positions[first:start])
        known = np.abs(here - ahead - coefs[:, : here.shape[1], TUNING.order]) / sd[:, : here.shape[1]]
        return np.asarray(known[np.isfinite(known)])


def _predictors(positions: FloatArray, left_out: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Predictions of c coordinates 1 to 4 frames ahead: coefficients (c, 4, 9), constant last, sd (c, 4); or NaN."""
    n, c = positions.shape
    coefs, sd = np.full((c, TUNING.horizon, TUNING.order + 1), np.nan), np.full((c, TUNING.horizon), np.nan)
    for k, series in enumerate(positions.T):
        good = np.isfinite(series) & ~left_out
        complete = np.convolve(good, np.ones(TUNING.order), "valid") > TUNING.order - 0.5
        centre = float(np.mean(series[good])) if np.any(good) else 0.0
        for ahead in range(min(TUNING.horizon, n - TUNING.order)):
            reach = TUNING.order + ahead + 1
            windows = np.lib.stride_tricks.sliding_window_view(series, reach)
            valid = good[reach - 1 :]
            used = np.flatnonzero(complete[: valid.size] & valid)
            used = used[:: max(1, used.size // TUNING.windows)]
            if used.size < 4 * TUNING.order:
                break
            design = np.column_stack([windows[used, : TUNING.order] - centre, np.ones(used.size)])
            target = windows[used, -1] - centre
            best = np.linalg.lstsq(design, target, rcond=None)[0]
            spread = robust_sd(target - design @ best)
            # The constant for coordinates that are not centred.
            best[TUNING.order] += centre * (1.0 - best[: TUNING.order].sum())
            coefs[k, ahead], sd[k, ahead] = best, max(spread, TUNING.least_sd_px)
    return coefs, sd

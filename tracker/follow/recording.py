"""One pass through the frames of a recording: results of the markers, thumbnails, and frames that are repeated.

Thumbnails are of evenly spaced frames and of the one with the largest displacement. A camera, codec or converter may
show a frame again although the scene was moving.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from tracker import flags
from tracker.arrays import BoolArray, FlagArray, FloatArray, GrayImage, IntArray, robust_sd
from tracker.markers import FrameFollower, FrameResult
from tracker.results import FrameStrip
from tracker.video import Frame, SourceInfo, UnreadableVideoError, source, to_8_bit


@dataclass(frozen=True)
class Tuning:
    """Results and images that are kept; how an image and the motion differ where an image is repeated."""

    #: [px] of an image that is kept
    #: convention: for display
    longest_side_px: int = 320
    #: [1] images that are kept
    #: convention: for display; beyond it every second one is dropped
    most_images: int = 24
    #: [1] factor by which a new largest displacement must exceed the old one
    #: convention: growing motion would resize an image each frame
    clearly_larger: float = 1.05
    #: [frames] of an array of results
    #: convention: enough that few arrays are needed, few enough that an unfinished one costs little memory
    chunk_rows: int = 1024
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


class StripKeeper:
    """Collects images for a `FrameStrip`; memory does not grow with the length of the recording."""

    def __init__(self) -> None:
        self._even: dict[int, NDArray[np.uint8]] = {}
        self._step = 1
        self._rest: NDArray[np.complex128] | None = None
        self._largest = 0.0
        self._widest: tuple[int, NDArray[np.uint8]] | None = None
        self._last: tuple[int, GrayImage] | None = None
        self._shrink = 1.0

    def offer(self, row: int, image: GrayImage, values: FloatArray) -> None:
        """Consider a frame: its row, its image and the markers' positions (x and y first, NaN where missing)."""
        self._last = (row, image)
        if row % self._step == 0:
            self._even[row] = self._small(image)
            if len(self._even) > TUNING.most_images:
                self._step *= 2
                self._even = {k: v for k, v in self._even.items() if k % self._step == 0}
        # Complex positions: this runs in every frame and must be cheap.
        positions = values[0] + 1j * values[1]
        if self._rest is None:
            self._rest = positions
        size = float(np.fmax.reduce(np.abs(positions - self._rest)))
        if size > TUNING.clearly_larger * self._largest:
            self._largest = size
            self._widest = (row, self._small(image))

    def strip(self, order: IntArray) -> FrameStrip | None:
        """The collected images, or None without any; `order` holds the row of each frame in presentation order."""
        kept = dict(self._even)
        if self._widest is not None:
            kept[self._widest[0]] = self._widest[1]
        if self._last is not None:
            kept[self._last[0]] = self._small(self._last[1])
        if not kept:
            return None
        rank = np.argsort(order)
        rows = sorted(kept, key=lambda row: int(rank[row]))
        return FrameStrip(rank[rows], np.stack([kept[row] for row in rows]), self._shrink)

    def _small(self, image: GrayImage) -> NDArray[np.uint8]:
        height, width = image.shape
        self._shrink = max(max(height, width) / TUNING.longest_side_px, 1.0)
        size = (max(round(width / self._shrink), 1), max(round(height / self._shrink), 1))
        if self._shrink == 1.0:
            return to_8_bit(image).copy()
        # of the type of the image, which OpenCV's annotations do not say
        small = cast("GrayImage", cv2.resize(image, size, interpolation=cv2.INTER_AREA))
        return to_8_bit(small)


def image_change(before: GrayImage, image: GrayImage) -> float:
    """Mean absolute difference of two images of one size and type, in gray levels."""
    one, other = before[:: source.TUNING.row_step], image[:: source.TUNING.row_step]
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


class RowStore:
    """Results of m markers frame by frame: 36 m bytes per row, without an object for each."""

    def __init__(self, markers: int) -> None:
        self._markers = markers
        self._values: list[FloatArray] = []
        self._correlation: list[FloatArray] = []
        self._flags: list[FlagArray] = []
        self._count = 0

    def append(self, result: FrameResult) -> None:
        """Copy the result of a frame."""
        row = self._count % TUNING.chunk_rows
        if row == 0:
            self._values.append(np.empty((4, TUNING.chunk_rows, self._markers)))
            if result.correlation is not None:
                self._correlation.append(np.empty((TUNING.chunk_rows, self._markers)))
            self._flags.append(np.empty((TUNING.chunk_rows, self._markers), dtype=np.uint32))
        self._values[-1][:, row] = result.out
        self._flags[-1][row] = result.marks
        if result.correlation is not None:
            self._correlation[-1][row] = result.correlation
        self._count += 1

    def columns(self, order: IntArray) -> tuple[FloatArray, FlagArray, FloatArray | None]:
        """`FrameResult.out`, shape (4, n, m), flags and correlations, (n, m), with the rows in the given order."""
        no_flags = np.empty((0, self._markers), dtype=np.uint32)
        values = np.concatenate(self._values or [np.empty((4, 0, self._markers))], axis=1)[:, order]
        correlation = np.concatenate(self._correlation)[order] if self._correlation else None
        return values, np.concatenate([no_flags, *self._flags])[order], correlation


Progress = Callable[[int, int], None]


@dataclass
class FollowedFrames:
    """Results of all frames, in the order of decoding, their presentation times and how much each image changed."""

    results: RowStore
    pts: list[int | None] = field(default_factory=list)
    changes: list[float] = field(default_factory=list)
    decoded: int = 0
    corrupt: int = 0
    strip: StripKeeper = field(default_factory=StripKeeper)


def follow_recording(
    stream: Iterator[Frame], follower: FrameFollower, info: SourceInfo, progress: Progress | None
) -> FollowedFrames:
    """Track all frames of a stream; more than ten million are refused."""
    rows = FollowedFrames(RowStore(follower.markers))
    before: GrayImage | None = None
    # The next step may still improve a result with motion blur: each is stored one frame later.
    waiting: FrameResult | None = None
    for frame in stream:
        if len(rows.pts) >= source.TUNING.max_frames:
            msg = f"the recording has more than {source.TUNING.max_frames} frames; split it"
            raise UnreadableVideoError(msg)
        rows.pts.append(frame.pts)
        mark = flags.LOSSY.value if info.lossy else 0
        if frame.image is None:
            rows.corrupt += 1
            change = float("nan")
            result: FrameResult = follower.missing(flags.DECODE_CORRUPT.value)
        else:
            rows.decoded += 1
            result = follower.step(frame.image)
            rows.strip.offer(len(rows.pts) - 1, frame.image, result.out)
            change = float("nan") if before is None else image_change(before, frame.image)
            before = frame.image
        rows.changes.append(change)
        np.bitwise_or(result.marks, mark, out=result.marks)
        if waiting is not None:
            rows.results.append(waiting)
        waiting = result
        if progress is not None:
            progress(len(rows.pts), info.frames_declared)
    follower.finish()
    if waiting is not None:
        rows.results.append(waiting)
    return rows

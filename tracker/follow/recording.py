"""One pass through the frames of a recording: it follows the markers and keeps thumbnails.

These are of evenly spaced frames and of the one with the largest displacement.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from tracker import flags
from tracker.arrays import FloatArray, GrayImage, IntArray
from tracker.follow.fits import RowStore
from tracker.follow.repeats import image_change
from tracker.markers import FrameFollower, FrameResult
from tracker.results import FrameStrip
from tracker.video import Frame, SourceInfo, UnreadableVideoError, source, to_8_bit


@dataclass(frozen=True)
class Tuning:
    """Images that are kept."""

    #: [px] of an image that is kept
    #: convention: for display
    longest_side_px: int = 320
    #: [1] images that are kept
    #: convention: for display; beyond it every second one is dropped
    most_images: int = 24
    #: [1] factor by which a new largest displacement must exceed the old one
    #: convention: growing motion would resize an image each frame
    clearly_larger: float = 1.05


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

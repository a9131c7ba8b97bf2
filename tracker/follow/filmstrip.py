"""Thumbnails kept while a recording is tracked: evenly spaced frames, and the frame of largest displacement."""

from __future__ import annotations

from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from tracker.arrays import FloatArray, GrayImage, IntArray
from tracker.results import FrameStrip
from tracker.video import to_8_bit

LONGEST_SIDE_PX = 320
# Maximum number; beyond it every second one is dropped and the step doubles.
MOST_IMAGES = 24
# A new largest displacement must exceed the old one by this factor: growing motion would resize an image each frame.
CLEARLY_LARGER = 1.05


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
            if len(self._even) > MOST_IMAGES:
                self._step *= 2
                self._even = {k: v for k, v in self._even.items() if k % self._step == 0}
        # Complex positions: this runs in every frame and must be cheap.
        positions = values[0] + 1j * values[1]
        if self._rest is None:
            self._rest = positions
        size = float(np.fmax.reduce(np.abs(positions - self._rest)))
        if size > CLEARLY_LARGER * self._largest:
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
        self._shrink = max(max(height, width) / LONGEST_SIDE_PX, 1.0)
        size = (max(round(width / self._shrink), 1), max(round(height / self._shrink), 1))
        if self._shrink == 1.0:
            return to_8_bit(image).copy()
        # of the type of the image, which OpenCV's annotations do not say
        small = cast("GrayImage", cv2.resize(image, size, interpolation=cv2.INTER_AREA))
        return to_8_bit(small)

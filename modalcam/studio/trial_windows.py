"""Windows that follow the markers of a test track: their mean picture, and what of each frame it does not explain."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from tracker import FloatArray, GrayImage, MarkerTracks

Picture = NDArray[np.uint8]
_USUAL_HALF_PX, _LARGEST_HALF_PX = 16, 64
# Pixels of the picture that is shown for one of the window, at most.
_ENLARGED = 4
_SHOWN_PX = 160


@dataclass(frozen=True)
class FollowedWindow:
    """Window that follows a marker: its mean picture, and the standard deviation over the frames as PNG.

    ``unexplained`` is the standard deviation over the frames beyond that of still parts of the picture, as a share of
    the contrast of the mean: 0 where the window shows one rigid object in the light of the first frames.
    """

    name: str
    mean_png: bytes
    residual_png: bytes
    unexplained: float


class WindowSums:
    """Running sums of the windows of some markers."""

    def __init__(self, tracks: MarkerTracks, chosen: tuple[int, ...], half_px: float | None) -> None:
        self._tracks, self._chosen = tracks, chosen
        half = round(_USUAL_HALF_PX if half_px is None else min(half_px, _LARGEST_HALF_PX))
        self._grid = np.arange(-half, half + 1, dtype=np.float64)
        size = len(self._grid)
        self._count = np.zeros(len(chosen))
        self._sum = np.zeros((len(chosen), size, size))
        self._squares = np.zeros_like(self._sum)
        self._noise: list[float] = []
        self._before: NDArray[np.float32] | None = None

    def add(self, row: int, image: GrayImage) -> None:
        """Add a frame of the tracks."""
        gray = image.astype(np.float32)
        for number, k in enumerate(self._chosen):
            x, y = self._tracks.x_px[row, k], self._tracks.y_px[row, k]
            if np.isfinite(x) and np.isfinite(y):
                window = self._window(gray, float(x), float(y))
                self._count[number] += 1
                self._sum[number] += window
                self._squares[number] += window**2
        if self._before is not None and len(self._noise) < 16:
            # Most of a picture is at rest: the median of the differences is that of noise alone.
            change = np.abs(gray - self._before)
            self._noise.append(float(np.median(change)) / 0.6745 / np.sqrt(2.0))
        self._before = gray

    def _window(self, gray: NDArray[np.float32], x: float, y: float) -> FloatArray:
        columns, rows = np.meshgrid((x + self._grid).astype(np.float32), (y + self._grid).astype(np.float32))
        found = cv2.remap(gray, columns, rows, cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(found, dtype=np.float64)

    def windows(self) -> tuple[FollowedWindow, ...]:
        """The windows with enough frames."""
        noise = float(np.median(self._noise)) if self._noise else 0.0
        return tuple(
            self._one(number, self._tracks.markers[k], noise)
            for number, k in enumerate(self._chosen)
            if self._count[number] > 2
        )

    def _one(self, number: int, name: str, noise: float) -> FollowedWindow:
        count = self._count[number]
        mean = self._sum[number] / count
        variance = np.maximum(self._squares[number] / count - mean**2, 0.0) * count / (count - 1.0)
        contrast = max(float(np.std(mean)), 1e-9)
        beyond = float(np.sqrt(max(np.mean(variance) - noise**2, 0.0)))
        residual = np.clip(255.0 * np.sqrt(variance) / contrast, 0.0, 255.0)
        return FollowedWindow(
            name, _png(_stretched(mean)), _png(residual.astype(np.uint8)), beyond / contrast
        )


def _stretched(mean: FloatArray) -> Picture:
    """Gray levels stretched from the darkest to the brightest."""
    low, high = float(mean.min()), float(mean.max())
    return np.asarray(np.rint(255.0 * (mean - low) / max(high - low, 1e-9)), dtype=np.uint8)


def _png(picture: Picture) -> bytes:
    factor = max(1, min(_ENLARGED, _SHOWN_PX // picture.shape[0]))
    shown = np.kron(picture, np.ones((factor, factor), dtype=np.uint8))
    return bytes(cv2.imencode(".png", shown)[1].tobytes())


def followed_windows(
    tracks: MarkerTracks,
    images: Iterable[GrayImage | None],
    chosen: tuple[int, ...],
    half_px: float | None = None,
) -> tuple[FollowedWindow, ...]:
    """Windows of the markers of these indices, from the frames of the track; frames without image are left out."""
    sums = WindowSums(tracks, chosen, half_px)
    for row, image in zip(range(len(tracks.time_s)), images, strict=False):
        if image is not None:
            sums.add(row, image)
    return sums.windows()


def evenly(count: int, most: int) -> tuple[int, ...]:
    """Indices of at most `most` of `count` things, evenly spread, the first and the last among them."""
    return tuple(sorted({round(float(k)) for k in np.linspace(0, count - 1, min(count, most))}))

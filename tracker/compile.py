"""Compilation of the kernels of tracking: the entry point is called with tiny films, so that numba keeps what it needs.

The films are arrays in memory with the pixels of the usual camera, 8 bits. Markers are followed by the same kernels in
16 bits; those that learn templates, and lines, are compiled for other pixels by the first recording that has them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from fractions import Fraction

import numpy as np

from tracker.arrays import FloatArray, GrayImage
from tracker.settings import TrackerSettings
from tracker.track import track_source
from tracker.video import Frame, SourceInfo

_RATE_HZ = Fraction(1000)
# half of the time between frames
_EXPOSURE_S = 5e-4
_FRAMES = 40
_HEIGHT_PX, _WIDTH_PX = 60, 150
_BRIGHT, _DARK = 190.0, 40.0
_NOISE = 1.5
_SWING_PX, _CYCLES_PER_FRAME = 1.5, 0.031
_DOT_RADIUS_PX, _DOTS_PX = 6.0, (25.3, 75.6, 125.1)
_BLUR_PX = 0.7
_STRIP_HALF_WIDTH_PX, _STRIP_PX = 2.0, (10.0, 140.0)


def compile_for_markers() -> None:
    """Compile what following dots, squares and codes needs, with three dots that swing."""
    y, x = np.mgrid[0:_HEIGHT_PX, 0:_WIDTH_PX]

    def cover(swing_px: float) -> FloatArray:
        away = [np.hypot(x - at, y - 0.5 * _HEIGHT_PX - swing_px) - _DOT_RADIUS_PX for at in _DOTS_PX]
        return _covered(np.min(away, axis=0))

    _track(cover, TrackerSettings(fps=_RATE_HZ, kind="blob"))


def compile_for_lines() -> None:
    """Compile what following the beam itself needs, with a strip that swings about its left end."""
    y, x = np.mgrid[0:_HEIGHT_PX, 0:_WIDTH_PX]
    middle = 0.5 * _HEIGHT_PX

    def cover(swing_px: float) -> FloatArray:
        centre = middle + swing_px * (np.maximum(x - _STRIP_PX[0], 0.0) / _WIDTH_PX) ** 2
        across = np.abs(y - centre) - _STRIP_HALF_WIDTH_PX
        return _covered(np.maximum(across, x - _STRIP_PX[1]))

    ends = tuple((end, middle) for end in _STRIP_PX)
    _track(cover, TrackerSettings(fps=_RATE_HZ, kind="line", line_px=ends, exposure_s=_EXPOSURE_S))


def _covered(outside_px: FloatArray) -> FloatArray:
    """Share of a pixel that is covered by what ends `outside_px` px before it, behind a lens that blurs."""
    return 0.5 - 0.5 * np.tanh(outside_px / _BLUR_PX)


def _track(cover: Callable[[float], FloatArray], settings: TrackerSettings) -> None:
    rng = np.random.default_rng(1)
    images: list[GrayImage] = []
    for frame in range(_FRAMES):
        ideal = _BRIGHT - (_BRIGHT - _DARK) * cover(
            _SWING_PX * math.sin(math.tau * _CYCLES_PER_FRAME * frame)
        )
        images.append(np.rint(ideal + _NOISE * rng.standard_normal(ideal.shape)).astype(np.uint8))
    track_source(_Film(images), "film", settings)


class _Film:
    """Frames in memory as an open recording."""

    def __init__(self, images: list[GrayImage]) -> None:
        self._images = images
        self.info = SourceInfo(
            codec="array",
            pixel_format="gray",
            width_px=_WIDTH_PX,
            height_px=_HEIGHT_PX,
            bit_depth=8,
            white_level=255,
            frames_declared=len(images),
            header_rate=_RATE_HZ,
        )

    def frames(self) -> Iterator[Frame]:
        for index, image in enumerate(self._images):
            yield Frame(image, index)

    def stamps(self) -> list[int | None]:
        return list(range(len(self._images)))

    def close(self) -> None:
        """Nothing is open."""

"""What every reader of recordings offers: frames one after the other, and what is known about them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

GrayImage = NDArray[np.uint8] | NDArray[np.uint16]


class UnreadableVideoError(ValueError):
    """The file is not a recording that can be read; the text says why and what to do next."""


@dataclass(frozen=True)
class Frame:
    """One frame in the order of showing.

    Attributes
    ----------
    image : uint8 or uint16 array, shape (height, width), or None
        None when the frame was damaged in the file: its row exists all the same.
    pts : int or None
        Presentation time in ticks of `SourceInfo.time_base`; None when the file gives none.
    """

    image: GrayImage | None
    pts: int | None


@dataclass(frozen=True)
class SourceInfo:
    """What is known of a recording before its frames are read.

    ``white_level`` is the largest value a pixel of the frames can have. ``frames_declared`` is 0 where the
    file does not say. ``predictive`` codecs build frames from other frames. ``header_rate`` is the recorded rate in
    a camera's own header, ``container_rate`` the rate at which a player would show the file.
    """

    codec: str
    pixel_format: str
    width_px: int
    height_px: int
    bit_depth: int
    white_level: int
    frames_declared: int
    lossy: bool
    predictive: bool
    time_base: Fraction | None
    container_rate: Fraction | None
    header_rate: Fraction | None
    notes: tuple[str, ...] = ()


class FrameSource(Protocol):
    """A recording that is open: `info`, then one pass over its frames; memory does not grow with length."""

    @property
    def info(self) -> SourceInfo:
        """Facts from the header; notes may grow while frames are read."""

    def frames(self) -> Iterator[Frame]:
        """All frames in order, damaged ones included. May be called once."""

    def close(self) -> None:
        """Release the file."""

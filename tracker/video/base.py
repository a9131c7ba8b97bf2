"""What every reader of recordings offers: frames one after the other, and what is known about them."""

from __future__ import annotations

import stat
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Protocol

from tracker.arrays import GrayImage

MAX_PIXELS = 67_000_000


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

    ``bit_depth`` is that of the pixels as stored, ``white_level`` the largest value a pixel of the frames can have.
    ``frames_declared`` is 0 where the file does not say. ``predictive`` codecs build frames from other frames.
    ``header_rate`` is the recorded rate in a camera's own header, ``container_rate`` the rate at which a player would
    show the file. Where there is a ``header_rate``, time stamps are of the camera's clock. ``frame_step`` is 2 where
    only every second frame that was recorded is in the file, and so on.
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
    frame_step: int = 1

    @property
    def frames_per_s(self) -> Fraction | None:
        """Rate of the frames in the file by the camera's header, or None."""
        return None if self.header_rate is None else self.header_rate / self.frame_step


class FrameSource(Protocol):
    """A recording that is open: `info`, then one pass over its frames; memory does not grow with length."""

    @property
    def info(self) -> SourceInfo:
        """Facts from the header; notes may grow while frames are read."""

    def frames(self) -> Iterator[Frame]:
        """All frames in order, damaged ones included. May be called once."""

    def stamps(self) -> list[int | None]:
        """Time stamps of all frames, without decoding them; in place of `frames`, not beside it."""

    def close(self) -> None:
        """Release the file."""


def shown(path: Path) -> str:
    """Name of a file for people: control characters and undecodable bytes made visible."""
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in path.name)


def check_picture_size(path: Path, width_px: int, height_px: int, max_pixels: int = MAX_PIXELS) -> None:
    """Hold a size that a file states against the limit, before anything of that size is made.

    Raises
    ------
    UnreadableVideoError
        If there is no size, or it is over the limit.
    """
    if width_px <= 0 or height_px <= 0:
        msg = f"{shown(path)}: the file gives no picture size; it is damaged or was cut off"
        raise UnreadableVideoError(msg)
    if width_px * height_px > max_pixels:
        msg = (
            f"{shown(path)}: the picture of {width_px} x {height_px} px is over the limit of "
            f"{max_pixels / 1e6:.0f} Mpx; crop it to the beam"
        )
        raise UnreadableVideoError(msg)


def check_regular_file(path: Path) -> int:
    """Size of a regular file in bytes; anything else is refused without opening it.

    Raises
    ------
    UnreadableVideoError
        If the file cannot be reached or is no regular file (a pipe would block whoever opens it).
    """
    try:
        status = path.stat()
    except OSError as error:
        msg = f"{shown(path)}: cannot be read ({error.strerror}); check the name and the permissions"
        raise UnreadableVideoError(msg) from error
    if not stat.S_ISREG(status.st_mode):
        msg = f"{shown(path)}: not a regular file"
        raise UnreadableVideoError(msg)
    return status.st_size


def read_head(path: Path, size: int) -> bytes:
    """First bytes of a file.

    Raises
    ------
    UnreadableVideoError
        If the file cannot be read.
    """
    try:
        with path.open("rb") as handle:
            return handle.read(size)
    except OSError as error:
        msg = f"{shown(path)}: cannot be read ({error.strerror}); check the permissions"
        raise UnreadableVideoError(msg) from error

"""Protocols of a reader of recordings and of an open recording, and checks that all readers share."""

from __future__ import annotations

import stat
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import ClassVar, Protocol

from tracker.arrays import GrayImage

MAX_PIXELS = 67_000_000
# An error ends the decoding of an image: by default FFmpeg conceals it, and the image looks intact.
DECODER_OPTIONS = {"max_pixels": str(MAX_PIXELS), "err_detect": "crccheck+bitstream+buffer+explode"}
HEAD_BYTES = 512


class UnreadableVideoError(ValueError):
    """The file is not a readable recording; the text says why and what to do next."""


@dataclass(frozen=True)
class Frame:
    """One frame in presentation order; the image of a damaged one is None: it still takes its place.

    ``pts`` is the presentation time in ticks of `SourceInfo.time_base`; None when the file gives none.
    """

    image: GrayImage | None
    pts: int | None


@dataclass(frozen=True)
class SourceInfo:
    """Properties of a recording before its frames are read.

    ``bit_depth`` is that of the stored pixels, ``white_level`` the largest possible pixel value in the frames.
    ``frames_declared`` is 0 where the file does not state it. ``predictive`` codecs construct frames from other frames.
    ``reordered`` frames are stored in another order than shown, because some are constructed from later ones; this is
    known once all are read.
    ``header_rate`` is the recorded rate in a camera's own header, ``container_rate`` the playback rate. With a
    ``header_rate``, time stamps are camera times. ``frame_step`` is 2 where only every second recorded frame is in the
    file, and so on.
    """

    codec: str
    pixel_format: str
    width_px: int
    height_px: int
    bit_depth: int
    white_level: int
    frames_declared: int = 0
    lossy: bool = False
    predictive: bool = False
    reordered: bool = False
    time_base: Fraction | None = None
    container_rate: Fraction | None = None
    header_rate: Fraction | None = None
    notes: tuple[str, ...] = ()
    frame_step: int = 1

    @property
    def frames_per_s(self) -> Fraction | None:
        """Rate of the frames in the file according to the camera's header, or None."""
        return None if self.header_rate is None else self.header_rate / self.frame_step


class FrameSource(Protocol):
    """An open recording: `info`, then one pass over its frames; memory does not grow with length."""

    @property
    def info(self) -> SourceInfo:
        """Properties from the header; notes may be added while frames are read."""

    def frames(self) -> Iterator[Frame]:
        """All frames in order, damaged ones included. May be called once."""

    def stamps(self) -> list[int | None]:
        """Time stamps of all frames, without decoding them; instead of `frames`, not in addition."""

    def close(self) -> None:
        """Release the file."""


class Reader(Protocol):
    """A format of recordings; a reader subclasses this protocol and is registered in `tracker.video.registry`.

    ``suffixes`` are endings, in lower case, of files that are always recordings; the folder search looks for them.
    An unreadable file raises `UnreadableVideoError`; the text says why and what to do next.
    """

    name: ClassVar[str]
    suffixes: ClassVar[tuple[str, ...]] = ()

    def recognises(self, path: Path, head: bytes) -> bool:
        """Whether this reader is for a path; `head` holds the first bytes of a file, none for a folder."""

    def open(self, path: Path) -> FrameSource:
        """Open a recording."""

    def files(self, path: Path) -> tuple[Path, ...]:
        """All files that a recording consists of, in a fixed order."""
        return (path,)


def shown(path: Path) -> str:
    """Name of a file for messages: control characters and undecodable bytes made visible."""
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in path.name)


def unreadable(path: Path, reason: str) -> UnreadableVideoError:
    """The error to raise for a file, whose name precedes the reason."""
    return UnreadableVideoError(f"{shown(path)}: {reason}")


def check_image_size(path: Path, width_px: int, height_px: int) -> None:
    """Refuse a file that states no image size or one over the limit, before memory of that size is allocated."""
    if width_px <= 0 or height_px <= 0:
        raise unreadable(path, "the file states no image size; it is damaged or incomplete")
    if width_px * height_px > MAX_PIXELS:
        limit = f"{MAX_PIXELS / 1e6:.0f} Mpx"
        raise unreadable(
            path,
            f"the image of {width_px} x {height_px} px is over the limit of {limit}; crop it to the beam",
        )


def check_regular_file(path: Path) -> int:
    """Size of a regular file in bytes; anything else is refused without opening it, since a pipe would block."""
    try:
        status = path.stat()
    except OSError as error:
        raise unreadable(
            path, f"cannot be read ({error.strerror}); check the name and the permissions"
        ) from error
    if not stat.S_ISREG(status.st_mode):
        raise unreadable(path, "not a regular file")
    return status.st_size


def read_head(path: Path, size: int = HEAD_BYTES) -> bytes:
    """First bytes of a file."""
    try:
        with path.open("rb") as handle:
            return handle.read(size)
    except OSError as error:
        raise unreadable(path, f"cannot be read ({error.strerror}); check the permissions") from error

"""Protocols of a reader and of an open recording, and the checks and gray images that all readers share."""

from __future__ import annotations

import stat
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from tracker.arrays import GrayImage


@dataclass(frozen=True)
class Tuning:
    """Limits of what is read."""

    #: [pixels] of an image
    #: convention: the largest takes 0.4 GB in colour of 16 bit
    max_pixels: int = 67_000_000
    #: [frames] of a recording
    #: convention: results of ten million frames of ten markers take 3.6 GB
    max_frames: int = 10_000_000
    #: [bytes] by which a format is recognised
    #: convention: more than the marks of all formats that are told apart
    head_bytes: int = 512
    #: [1] one row in this many of an image is compared with another image
    #: convention: enough for a mean over the image or over a block
    row_step: int = 4


TUNING = Tuning()

# An error ends the decoding of an image: by default FFmpeg conceals it, and the image looks intact.
DECODER_OPTIONS = {"max_pixels": str(TUNING.max_pixels), "err_detect": "crccheck+bitstream+buffer+explode"}


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
    if width_px * height_px > TUNING.max_pixels:
        limit = f"{TUNING.max_pixels / 1e6:.0f} Mpx"
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


def read_head(path: Path, size: int = TUNING.head_bytes) -> bytes:
    """First bytes of a file."""
    try:
        with path.open("rb") as handle:
            return handle.read(size)
    except OSError as error:
        raise unreadable(path, f"cannot be read ({error.strerror}); check the permissions") from error


# Rec. 601 luma in 1/256, so that gray content of 8 bit becomes exactly 256 times its value in 16 bit.
LUMA_256 = np.array([77, 150, 29], dtype=np.uint32)


def has_gray_plane(pixel_format: Any) -> bool:
    """Whether the first plane is the gray image: gray and planar or semi-planar YUV formats."""
    name = pixel_format.name
    return bool(name.startswith(("gray", "yuv", "yuvj", "nv", "p01", "ya")) and not _is_packed(name))


def _is_packed(name: str) -> bool:
    return name.startswith(("yuyv", "uyvy", "yvyu", "ya8", "ya16", "grayf"))


def gray_depth(pixel_format: Any) -> int:
    """Bits of the gray image that `gray_image` gives for this format."""
    if has_gray_plane(pixel_format):
        return int(pixel_format.components[0].bits)
    return 16


def luma_16(rgb: NDArray[np.generic], *, deep: bool) -> GrayImage:
    """Rec. 601 luma in 16 bit; from shape (height, width, 3) of 8 bit, or of 16 where `deep`, to (height, width)."""
    luma = rgb.astype(np.uint32) @ LUMA_256
    return np.asarray(luma >> 8 if deep else luma, dtype=np.uint16)


def gray_image(frame: Any) -> GrayImage:
    """Gray image of a PyAV frame, copied from the decoder's buffer; shape (height, width).

    The luma plane is used without conversion of its range: gain and offset are fitted anyway. RGB and palette formats
    are converted to 16 bit with the weights of Rec. 601, without rounding.
    """
    if not has_gray_plane(frame.format):
        deep = any(component.bits > 8 for component in frame.format.components)
        return luma_16(frame.to_ndarray(format="rgb48le" if deep else "rgb24"), deep=deep)
    deep = gray_depth(frame.format) > 8
    if frame.planes[0].line_size < 0:
        # A bottom-up buffer: its pointer is the last line's. swscale writes it out top-down.
        frame = frame.reformat(format="gray16be" if deep else "yuv444p")
    plane = frame.planes[0]
    big_endian = frame.format.name.endswith("be")
    dtype = np.dtype(">u2" if big_endian else "<u2") if deep else np.dtype(np.uint8)
    stride = plane.line_size // dtype.itemsize
    rows = np.frombuffer(plane, dtype=dtype, count=stride * frame.height).reshape(frame.height, stride)
    if not deep:
        return np.array(rows[:, : frame.width], dtype=np.uint8)
    native = np.array(rows[:, : frame.width], dtype=np.uint16)
    if frame.format.name.startswith(("p01", "p21", "p41")):
        native >>= np.uint16(
            16 - gray_depth(frame.format)
        )  # these store their bits at the upper end of the word
    return native


def packed_bytes(pixels: int, bits: int) -> int:
    """Size in bytes of `pixels` of `bits` each, most significant bit first; -1 without a whole number of bytes."""
    return pixels * bits // 8 if pixels * bits % 8 == 0 else -1


def unpacked(data: NDArray[np.uint8], bits: int) -> GrayImage:
    """A copy of the pixels in bytes: of 8 bit, of 16 in little-endian words, or packed to 10 or 12."""
    if bits == 8:
        return data.copy()
    if bits == 16:
        return data.view("<u2").astype(np.uint16)
    # Four pixels from every five bytes, or two from every three.
    b = data.astype(np.uint16).reshape(-1, 5 if bits == 10 else 3).T
    if bits == 10:
        pixels = [
            b[0] << 2 | b[1] >> 6,
            (b[1] & 0x3F) << 4 | b[2] >> 4,
            (b[2] & 0x0F) << 6 | b[3] >> 2,
            (b[3] & 0x03) << 8 | b[4],
        ]
    else:
        pixels = [b[0] << 4 | b[1] >> 4, (b[1] & 0x0F) << 8 | b[2]]
    return np.stack(pixels, axis=1).ravel()


def to_8_bit(image: GrayImage) -> NDArray[np.uint8]:
    """Image stretched to 8 bit between its 0.1 and 99.9 percentiles; 8-bit images are returned unchanged."""
    if image.dtype == np.uint8:
        return np.asarray(image, dtype=np.uint8)
    low, high = np.percentile(image, (0.1, 99.9))
    span = max(float(high - low), 1.0)
    return np.asarray(np.clip((image.astype(np.float64) - low) * (255.0 / span), 0, 255), dtype=np.uint8)

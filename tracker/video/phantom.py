"""Phantom recordings (`.cine`): monochrome pixels, the header's rate, and the camera's time of each frame.

Layout after Vision Research, "Cine File Format" (all little-endian): a file header of 44 bytes, a bitmap header, the
camera setup, tagged blocks, a table of offsets, then each image after a short annotation.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from tracker.arrays import GrayImage
from tracker.video.source import TUNING as LIMITS
from tracker.video.source import (
    Frame,
    FrameSource,
    Reader,
    SourceInfo,
    check_image_size,
    check_regular_file,
    packed_bytes,
    unpacked,
    unreadable,
)


@dataclass(frozen=True)
class Tuning:
    """Limits of a Phantom recording."""

    #: [bytes] before an image
    #: convention: chosen; effect on damaged files only
    max_annotation: int = 1_048_576


TUNING = Tuning()

# "CI", and the length of the header in every version of the format.
CINE_HEAD = b"CI\x2c\x00"
# Fields of the headers that are read, and their offsets.
FILE_HEADER = np.dtype(
    {
        "names": ["compression", "frames", "at_bitmap", "at_setup", "at_offsets"],
        "formats": ["<u2", "<u4", "<u4", "<u4", "<u4"],
        "offsets": [4, 20, 24, 28, 32],
    }
)
BITMAP_HEADER = np.dtype(
    {
        "names": ["width", "height", "bits", "packing"],
        "formats": ["<i4", "<i4", "<u2", "<u4"],
        "offsets": [4, 8, 14, 16],
    }
)
SETUP = np.dtype(
    {
        "names": ["mark", "length", "flip_h", "flip_v", "rate", "depth"],
        "formats": ["S2", "<u2", "<u4", "<u4", "<u4", "<u4"],
        "offsets": [140, 142, 756, 760, 768, 896],
    }
)
TAG_HEADER = np.dtype([("size", "<u4"), ("kind", "<u2"), ("reserved", "<u2")])
TAG_TIMES = 1002
# Times are in units of 2^-32 s; the two lowest bits are states of the camera's inputs, not time.
TIME_BASE = Fraction(1, 1 << 32)
SIGNAL_BITS = 3
# Bits of a pixel in each way of packing; None: whole bytes or words.
PACKED_BITS = {0: None, 0x100: 10, 0x400: 12}

# Pixels packed to 10 bit are companded: the camera stores 12 bits of light on a curve that is linear in dark regions
# and flattens in bright ones. The polynomials agree with the manufacturer's table of 1024 entries within 0.6 of 4095.
_DARK = (4.06325235, 0.93662193)
_BRIGHT = (71.9006, 0.0121369198, 3.03121344e-3, 1.03876812e-6, -2.0745890e-10)
_KNEE, _CLIPPED = 152, 1015
_SCALE = 16


def linear_10() -> NDArray[np.uint16]:
    """Light for each of the 1024 packed values, in 1/16 of a 12-bit step, so that all are distinct; shape (1024,)."""
    code = np.arange(1024, dtype=np.float64)
    dark = np.polynomial.polynomial.polyval(code, _DARK)
    bright = np.polynomial.polynomial.polyval(code, _BRIGHT)
    value = np.where(code < _KNEE, dark, bright)
    value[_CLIPPED:] = 4095.0
    return np.asarray(np.rint(value * _SCALE), dtype=np.uint16)


def is_monochrome(path: Path) -> bool:
    """Whether the pixels are monochrome; colour is left to the general reader."""
    check_regular_file(path)
    with path.open("rb") as file:
        compression, _, at_bitmap, *_ = _fields(file, path, FILE_HEADER, 0)
        bits = _fields(file, path, BITMAP_HEADER, at_bitmap)[2]
    return compression == 0 and bits in (8, 16)


class PhantomSource:
    """A monochrome `.cine` as a `tracker.video.source.FrameSource`.

    Supported are pixels of 8 bit, of 9 to 16 bit in words, and packed to 10 or 12 bit. Packed 10-bit values are
    companded by the camera; they are linearised, because noise and blur act on the light. Time stamps are the camera's
    where the file holds them (in 2^-32 s), else frame numbers.
    """

    def __init__(self, path: Path) -> None:
        self._size = check_regular_file(path)
        self._file = path.open("rb")
        try:
            self._read_headers(path)
        except BaseException:
            self._file.close()
            raise

    def _read_headers(self, path: Path) -> None:
        compression, declared, at_bitmap, at_setup, at_offsets = _fields(self._file, path, FILE_HEADER, 0)
        width, height, word, packing = _fields(self._file, path, BITMAP_HEADER, at_bitmap)
        if compression != 0 or word not in (8, 16) or packing not in PACKED_BITS:
            raise unreadable(
                path,
                f"pixels of {word} bit, compression {compression}, packing {packing:#x} are not supported; "
                "export the recording as monochrome cine, TIFF or AVI",
            )
        mark, length, flip_h, flip_v, rate, depth = _fields(self._file, path, SETUP, at_setup)
        if mark != b"ST" or not 0 < rate < 1 << 31:
            raise unreadable(
                path, f"the camera setup is damaged (mark {mark!r}, {rate} fps); copy the file again"
            )
        packed = PACKED_BITS[packing]
        depth = packed or (depth if word == 16 and 8 < depth <= 16 else word)
        self._bits = packed or word
        self._linear = linear_10() if packed == 10 else None
        # Bitmaps start with the bottom row unless their height is negative, packed ones with the top row. The flips are
        # display settings of the camera software.
        self._bottom_up = ((packed is None) == (height > 0)) != bool(flip_v)
        self._mirrored = bool(flip_h)
        width, height = max(width, 0), abs(height)
        check_image_size(path, width, height)
        # Rows of bytes are padded to a multiple of four.
        self._stored_width = -(-width // 4) * 4 if self._bits == 8 else width
        self._image_bytes = packed_bytes(self._stored_width * height, self._bits)
        # Pixels are unpacked in groups of four or two.
        if packed and (self._image_bytes < 0 or width * height % 4):
            raise unreadable(path, f"packed images of {width} x {height} px do not end with a byte")
        offsets = self._offsets(at_offsets, min(declared, LIMITS.max_frames))
        times, notes = _frame_times(self._file, at_setup + length, at_offsets, offsets.size)
        # Images are stored one after another: none can follow beyond the end of the file.
        inside = np.flatnonzero(offsets + self._image_bytes + 8 <= self._size)
        self._frame_offsets = offsets[: int(inside[-1]) + 1 if inside.size else 0]
        self._times = times
        if self._linear is not None:
            notes += ("The camera's companded 10-bit values were linearised.",)
        self.info = SourceInfo(
            codec="cine",
            pixel_format=f"gray{self._bits}" + (" packed" if packed else ""),
            width_px=width,
            height_px=height,
            bit_depth=depth,
            white_level=(1 << depth) - 1 if self._linear is None else 4095 * _SCALE,
            frames_declared=min(declared, LIMITS.max_frames),
            time_base=Fraction(1, rate) if times is None else TIME_BASE,
            header_rate=Fraction(rate),
            notes=notes,
            frame_step=_frame_step(times, rate),
        )

    def _offsets(self, start: int, count: int) -> NDArray[np.int64]:
        self._file.seek(start)
        offsets = np.frombuffer(self._file.read(8 * min(count, max(self._size - start, 0) // 8)), dtype="<i8")
        # A damaged offset becomes one at which reading fails, without overflow.
        inside = (offsets > 0) & (offsets < self._size)
        return np.where(inside, offsets, self._size).astype(np.int64)

    def close(self) -> None:
        """Release the file."""
        self._file.close()

    def stamps(self) -> list[int | None]:
        """Camera time of each frame, or its index."""
        count = len(self._frame_offsets)
        return list(range(count)) if self._times is None else self._times[:count].tolist()

    def frames(self) -> Iterator[Frame]:
        """All frames up to the end of the file; damaged ones without image."""
        for offset, stamp in zip(self._frame_offsets, self.stamps(), strict=True):
            yield Frame(self._image(int(offset)), stamp)

    def frame_at(self, pts: int) -> GrayImage | None:
        """The frame with one of the `stamps`; None if it is damaged."""
        return self._image(int(self._frame_offsets[self.stamps().index(pts)]))

    def _image(self, offset: int) -> GrayImage | None:
        try:
            self._file.seek(offset)
            head = self._file.read(4)
            length = int.from_bytes(head, "little")
            if len(head) < 4 or not 8 <= length <= TUNING.max_annotation:
                return None
            self._file.seek(offset + length - 4)
            stated = int.from_bytes(self._file.read(4), "little")
            data = self._file.read(self._image_bytes)
        except (OSError, ValueError):
            return None  # an invalid offset, or a failing medium
        if len(data) < self._image_bytes or not 0 <= stated - self._image_bytes < 4096:
            return None
        pixels = unpacked(np.frombuffer(data, dtype=np.uint8), self._bits)
        if self._linear is not None:
            pixels = self._linear[pixels]
        image = pixels.reshape(-1, self._stored_width)[:, : self.info.width_px]
        if self._bottom_up:
            image = image[::-1]
        if self._mirrored:
            image = image[:, ::-1]
        return image.copy(order="C")


def _fields(file: BinaryIO, path: Path, form: np.dtype[Any], offset: int) -> tuple[Any, ...]:
    """Fields of a header."""
    file.seek(offset)
    data = file.read(form.itemsize)
    if len(data) < form.itemsize:
        raise unreadable(path, "the recording ends within its headers; copy it again from the camera")
    return tuple(np.frombuffer(data, dtype=form)[0].item())


def _frame_step(times: NDArray[np.int64] | None, rate: int) -> int:
    """Interval between frames in the file, in recorded frames, from the camera times."""
    if times is None or times.size < 2:
        return 1
    return max(round(float(np.median(np.diff(times))) * float(TIME_BASE) * rate), 1)


def _frame_times(
    file: BinaryIO, start: int, stop: int, count: int
) -> tuple[NDArray[np.int64] | None, tuple[str, ...]]:
    """Camera time of each frame from the tagged blocks, in ticks from the first; None without such times."""
    position, least = start, TAG_HEADER.itemsize
    while position + least <= stop:
        file.seek(position)
        head = file.read(least)
        if len(head) < least:
            break
        size, kind, _ = np.frombuffer(head, dtype=TAG_HEADER)[0].item()
        if size < least or position + size > stop:
            break
        if kind == TAG_TIMES and (size - least) // 8 >= count > 0:
            words = np.frombuffer(file.read(8 * count), dtype="<u8")
            if words.size == count:
                ticks = words - (words & np.uint64(SIGNAL_BITS))
                # Unsigned differences wrap to the right signed ones.
                return (ticks - ticks[0]).astype(np.int64), ()
        position += size
    return None, (
        "The file contains no frame times: frames are assumed equally spaced at the header's rate.",
    )


class PhantomReader(Reader):
    """Monochrome Phantom recordings; colour is left to the general reader."""

    name = "phantom"

    def recognises(self, path: Path, head: bytes) -> bool:
        """By the first bytes and the pixel format."""
        return head.startswith(CINE_HEAD) and is_monochrome(path)

    def open(self, path: Path) -> FrameSource:
        """Open a recording."""
        return PhantomSource(path)


PHANTOM = PhantomReader()

"""Phantom recordings (`.cine`): monochrome pixels, the header's rate, and the camera's time of each frame.

Layout after Vision Research, "Cine File Format" (all little-endian): a file header of 44 bytes, a bitmap header, the
camera setup, tagged blocks, a table of offsets, then each image after a short annotation.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from tracker.arrays import GrayImage
from tracker.video.base import (
    MAX_PIXELS,
    Frame,
    FrameSource,
    Reader,
    SourceInfo,
    UnreadableVideoError,
    check_image_size,
    check_regular_file,
    shown,
)
from tracker.video.gray import packed_bytes, unpack_10, unpack_12

MAX_FRAMES = 10_000_000
# "CI", and the length of the header in every version of the format.
CINE_HEAD = b"CI\x2c\x00"
FILE_HEADER = struct.Struct("<2sHHHiIiIIII")
BITMAP_HEADER = struct.Struct("<IiiHHII")
TAG_HEADER = struct.Struct("<IHH")
# Offsets in the setup: its mark and length, the display flips, the rate, the bits per pixel.
SETUP_MARK, SETUP_FLIPS, SETUP_RATE, SETUP_BITS = 140, 756, 768, 896
SETUP_READ = SETUP_BITS + 4
TAG_TIMES = 1002
# Times are in units of 2^-32 s; the two lowest bits are states of the camera's inputs, not time.
TIME_BASE = Fraction(1, 1 << 32)
SIGNAL_BITS = 3
MAX_ANNOTATION = 1 << 20
UNPACKED, PACKED_10, PACKED_12 = 0, 0x100, 0x400

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


@dataclass(frozen=True)
class _Layout:
    """Storage of the images in the file."""

    width_px: int
    height_px: int
    bits: int
    packing: int
    top_down: bool
    mirrored: bool
    rate: Fraction
    depth: int
    declared: int
    offsets: NDArray[np.int64]
    times: NDArray[np.int64] | None
    notes: tuple[str, ...]


def is_monochrome(path: Path) -> bool:
    """Whether the pixels are monochrome; colour is left to the general reader.

    Raises
    ------
    UnreadableVideoError
        If the file ends within its headers.
    """
    check_regular_file(path)
    with path.open("rb") as file:
        _, _, compression, *_, at_bitmap, _, _ = _unpack(file, path, FILE_HEADER, 0)
        bits = _unpack(file, path, BITMAP_HEADER, at_bitmap)[4]
    return compression == 0 and bits in (8, 16)


class PhantomSource:
    """A monochrome `.cine` as a `tracker.video.base.FrameSource`.

    Supported are pixels of 8 bit, of 9 to 16 bit in words, and packed to 10 or 12 bit. Packed 10-bit values are
    companded by the camera; they are linearised, because noise and blur act on the light. Time stamps are the camera's
    where the file holds them (in 2^-32 s), else frame numbers.

    Raises
    ------
    UnreadableVideoError
        If a header is damaged or incomplete, or the pixel format is not supported.
    """

    def __init__(self, path: Path, *, max_pixels: int = MAX_PIXELS) -> None:
        size = check_regular_file(path)
        self._path = path
        self._file = path.open("rb")
        try:
            layout = _read_layout(self._file, path, size)
            check_image_size(path, layout.width_px, layout.height_px, max_pixels)
            self._layout = layout
            self._image_bytes = _image_bytes(path, layout)
        except BaseException:
            self._file.close()
            raise
        self._linear = linear_10() if layout.packing == PACKED_10 else None
        # Images are stored one after another: none can follow beyond the end of the file.
        inside = np.flatnonzero(layout.offsets + self._image_bytes + 8 <= size)
        self._count = int(inside[-1]) + 1 if inside.size else 0
        packed = layout.packing != UNPACKED
        self.info = SourceInfo(
            codec="cine",
            pixel_format=f"gray{layout.depth if packed else layout.bits}" + (" packed" if packed else ""),
            width_px=layout.width_px,
            height_px=layout.height_px,
            bit_depth=layout.depth,
            white_level=4095 * _SCALE if self._linear is not None else (1 << layout.depth) - 1,
            frames_declared=layout.declared,
            lossy=False,
            predictive=False,
            time_base=TIME_BASE if layout.times is not None else 1 / layout.rate,
            container_rate=None,
            header_rate=layout.rate,
            notes=layout.notes,
            frame_step=_frame_step(layout),
        )

    def close(self) -> None:
        """Release the file."""
        self._file.close()

    def stamps(self) -> list[int | None]:
        """Camera time of each frame, or its index."""
        times = self._layout.times
        if times is None:
            return list(range(self._count))
        return [int(t) for t in times[: self._count]]

    def frames(self) -> Iterator[Frame]:
        """All frames up to the end of the file; damaged ones without image."""
        for k, stamp in enumerate(self.stamps()):
            yield Frame(self._image(int(self._layout.offsets[k])), stamp)

    def _image(self, offset: int) -> GrayImage | None:
        try:
            self._file.seek(offset)
            head = self._file.read(4)
            length = int.from_bytes(head, "little")
            if len(head) < 4 or not 8 <= length <= MAX_ANNOTATION:
                return None
            self._file.seek(offset + length - 4)
            stated = int.from_bytes(self._file.read(4), "little")
            data = self._file.read(self._image_bytes)
        except (OSError, ValueError):
            return None  # an invalid offset, or a failing medium
        if len(data) < self._image_bytes or not 0 <= stated - self._image_bytes < 4096:
            return None
        return self._pixels(np.frombuffer(data, dtype=np.uint8))

    def _pixels(self, raw: NDArray[np.uint8]) -> GrayImage:
        layout = self._layout
        height, width = layout.height_px, layout.width_px
        image: GrayImage
        if layout.packing == PACKED_10:
            assert self._linear is not None  # noqa: S101 - made for this packing
            image = self._linear[unpack_10(raw)].reshape(height, width)
        elif layout.packing == PACKED_12:
            image = unpack_12(raw).reshape(height, width)
        elif layout.bits == 16:
            image = raw.view("<u2").astype(np.uint16).reshape(height, width)
        else:
            image = raw.reshape(height, -1)[:, :width]
        if not layout.top_down:
            image = image[::-1]
        if layout.mirrored:
            image = image[:, ::-1]
        return image.copy(order="C")


def _unpack(file: BinaryIO, path: Path, form: struct.Struct, offset: int) -> tuple[int, ...]:
    file.seek(offset)
    data = file.read(form.size)
    if len(data) < form.size:
        msg = f"{shown(path)}: the recording ends within its headers; copy it again from the camera"
        raise UnreadableVideoError(msg)
    return form.unpack(data)


def _read_layout(file: BinaryIO, path: Path, size: int) -> _Layout:
    head = _unpack(file, path, FILE_HEADER, 0)
    compression, declared = head[2], head[7]
    at_bitmap, at_setup, at_offsets = head[8:11]
    _, width, height, _, bits, packing, _ = _unpack(file, path, BITMAP_HEADER, at_bitmap)
    if compression != 0 or bits not in (8, 16) or packing not in (UNPACKED, PACKED_10, PACKED_12):
        msg = (
            f"{shown(path)}: pixels of {bits} bit, compression {compression}, packing {packing:#x} are not supported; "
            "export the recording as monochrome cine, TIFF or AVI"
        )
        raise UnreadableVideoError(msg)
    setup = _unpack(file, path, struct.Struct(f"<{SETUP_READ}s"), at_setup)[0]
    assert isinstance(setup, bytes)  # noqa: S101 - the format says so
    mark, length = struct.unpack_from("<2sH", setup, SETUP_MARK)
    rate = int.from_bytes(setup[SETUP_RATE : SETUP_RATE + 4], "little")
    if mark != b"ST" or not 0 < rate < 1 << 31:
        msg = f"{shown(path)}: the camera setup is damaged (mark {mark!r}, {rate} fps); copy the file again"
        raise UnreadableVideoError(msg)
    flip_h, flip_v = struct.unpack_from("<II", setup, SETUP_FLIPS)
    entries = max(size - at_offsets, 0) // 8
    count = min(declared, entries, MAX_FRAMES)
    file.seek(at_offsets)
    offsets = np.frombuffer(file.read(8 * count), dtype="<i8")
    # A damaged offset becomes one at which reading fails, without overflow.
    offsets = np.where((offsets > 0) & (offsets < size), offsets, size).astype(np.int64)
    times, notes = _frame_times(file, at_setup + length, at_offsets, count)
    if packing == PACKED_10:
        notes += ("The camera's companded 10-bit values were linearised.",)
    # Bitmaps start with the bottom row unless their height is negative, packed ones with the top row. The flips are
    # display settings of the camera software.
    top_down = (packing != UNPACKED) != (height < 0)
    return _Layout(
        width_px=max(width, 0),
        height_px=abs(height),
        bits=bits,
        packing=packing,
        top_down=top_down != bool(flip_v),
        mirrored=bool(flip_h),
        rate=Fraction(rate),
        depth=_depth(setup, bits, packing),
        declared=min(declared, MAX_FRAMES),
        offsets=offsets,
        times=times,
        notes=notes,
    )


def _depth(setup: bytes, bits: int, packing: int) -> int:
    if packing != UNPACKED:
        return 10 if packing == PACKED_10 else 12
    stated = int.from_bytes(setup[SETUP_BITS : SETUP_BITS + 4], "little")
    return stated if bits == 16 and 8 < stated <= 16 else bits


def _frame_step(layout: _Layout) -> int:
    """Interval between frames in the file, in recorded frames, from the camera times."""
    if layout.times is None or layout.times.size < 2:
        return 1
    median_s = float(np.median(np.diff(layout.times))) * float(TIME_BASE)
    return max(round(median_s * float(layout.rate)), 1)


def _image_bytes(path: Path, layout: _Layout) -> int:
    pixels = layout.width_px * layout.height_px
    if layout.packing != UNPACKED:
        size = packed_bytes(pixels, layout.depth)
        # Pixels are unpacked in groups of four or two.
        if size < 0 or pixels % 4:
            msg = f"{shown(path)}: packed images of {layout.width_px} x {layout.height_px} px do not end with a byte"
            raise UnreadableVideoError(msg)
        return size
    if layout.bits == 16:
        return 2 * pixels
    return (layout.width_px + 3) // 4 * 4 * layout.height_px  # rows are padded to a multiple of four bytes


def _frame_times(
    file: BinaryIO, start: int, stop: int, count: int
) -> tuple[NDArray[np.int64] | None, tuple[str, ...]]:
    """Camera time of each frame from the tagged blocks, in ticks from the first; None without such times."""
    position = start
    while position + TAG_HEADER.size <= stop:
        file.seek(position)
        head = file.read(TAG_HEADER.size)
        if len(head) < TAG_HEADER.size:
            break
        size, kind, _ = TAG_HEADER.unpack(head)
        if size < TAG_HEADER.size or position + size > stop:
            break
        if kind == TAG_TIMES and (size - TAG_HEADER.size) // 8 >= count > 0:
            words = np.frombuffer(file.read(8 * count), dtype="<u8")
            if words.size == count:
                ticks = words - (words & np.uint64(SIGNAL_BITS))
                # Unsigned differences wrap to the right signed ones.
                return (ticks - ticks[0]).astype(np.int64), ()
        position += size
    return None, ("The file holds no frame times: frames are assumed equally spaced at the header's rate.",)


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

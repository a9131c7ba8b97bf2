"""Single image files as gray pictures at their full depth, all of one size and kind."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import av
import av.error

from tracker.arrays import GrayImage
from tracker.video.base import (
    MAX_PIXELS,
    UnreadableVideoError,
    check_picture_size,
    check_regular_file,
    read_head,
    shown,
)
from tracker.video.gray import gray_depth, gray_image
from tracker.video.tiff import TiffSource

IMAGE_SUFFIXES = (".bmp", ".jpeg", ".jpg", ".png", ".tif", ".tiff")
# Leading bytes, FFmpeg's decoder.
_KINDS = (
    (b"\x89PNG\r\n\x1a\n", "png"),
    (b"\xff\xd8\xff", "mjpeg"),
    (b"BM", "bmp"),
    (b"II", "tiff"),
    (b"MM", "tiff"),
)
# Uncompressed 16-bit colour with room to spare; a larger file is no picture within the limit of pixels.
MAX_BYTES_PER_PIXEL = 8
JPEG_END, JPEG_END_WITHIN = b"\xff\xd9", 4096


@dataclass(frozen=True)
class PictureKind:
    """What the images of a series have in common."""

    codec: str
    pixel_format: str
    width_px: int
    height_px: int
    bit_depth: int
    white_level: int
    lossy: bool


class PictureFiles:
    """Reads image files one after the other; the first good one sets size and kind for all."""

    def __init__(self, *, max_pixels: int = MAX_PIXELS) -> None:
        self._max_pixels = max_pixels
        self._kind: PictureKind | None = None

    @property
    def kind(self) -> PictureKind:
        """Size and kind; to be asked for after a picture was read."""
        assert self._kind is not None  # noqa: S101 - see above
        return self._kind

    def read(self, path: Path) -> GrayImage | None:
        """Gray picture of one file, shape (height, width); None when it is damaged.

        Raises
        ------
        UnreadableVideoError
            If its size or kind differs from that of the pictures before, or it is over the limit of pixels.
        """
        if check_regular_file(path) > MAX_BYTES_PER_PIXEL * self._max_pixels:
            msg = f"{shown(path)}: too large for a picture of {self._max_pixels / 1e6:.0f} Mpx"
            raise UnreadableVideoError(msg)
        head = read_head(path, 32)
        codec = next((codec for magic, codec in _KINDS if head.startswith(magic)), "")
        if codec == "":
            return None
        found = self._decode(path, codec, head)
        if found is None and codec == "tiff":  # kinds that FFmpeg does not know
            found = self._read_tiff(path)
        if found is None:
            return None
        image, kind = found
        if self._kind is None:
            self._kind = kind
        elif (kind.width_px, kind.height_px) != (self._kind.width_px, self._kind.height_px):
            msg = (
                f"{shown(path)}: the picture is {kind.width_px} x {kind.height_px} px, those before it "
                f"{self._kind.width_px} x {self._kind.height_px} px; give each size a folder of its own"
            )
            raise UnreadableVideoError(msg)
        elif kind != self._kind:
            msg = (
                f"{shown(path)}: the picture is {kind.codec} {kind.pixel_format}, those before it "
                f"{self._kind.codec} {self._kind.pixel_format}; give each kind a folder of its own"
            )
            raise UnreadableVideoError(msg)
        return image

    def _read_tiff(self, path: Path) -> tuple[GrayImage, PictureKind] | None:
        try:
            source = TiffSource(path, max_pixels=self._max_pixels)
        except UnreadableVideoError:
            if self._kind is None:
                raise
            return None
        try:
            image = next((frame.image for frame in source.frames()), None)
        finally:
            source.close()
        if image is None:
            return None
        info = source.info
        kind = PictureKind(
            info.codec,
            info.pixel_format,
            info.width_px,
            info.height_px,
            info.bit_depth,
            info.white_level,
            info.lossy,
        )
        return image, kind

    def _decode(self, path: Path, codec: str, head: bytes) -> tuple[GrayImage, PictureKind] | None:
        stated = _stated_size(codec, head)
        if stated is not None and stated[0] > 0 and stated[1] > 0:
            check_picture_size(path, *stated, self._max_pixels)
        try:
            data = path.read_bytes()
        except OSError:
            return None  # the medium fails here, or the file was taken away
        if codec == "mjpeg" and data.rfind(JPEG_END) < max(len(data) - JPEG_END_WITHIN, 0):
            return None  # cut off: the decoder would fill the rest with gray
        # A decoder of its own for each image: one that is used again may add the picture before to this one.
        decoder: Any = av.CodecContext.create(codec, "r")
        decoder.options = {"max_pixels": str(self._max_pixels), "err_detect": "crccheck"}
        try:
            packet = av.Packet(data)
            packet.is_keyframe = True
            frames = decoder.decode(packet)
        except (av.error.FFmpegError, ValueError):
            return None
        if not frames or frames[0].is_corrupt:
            return None
        frame = frames[0]
        depth = gray_depth(frame.format)
        kind = PictureKind(
            codec="jpeg" if codec == "mjpeg" else codec,
            pixel_format=frame.format.name,
            width_px=frame.width,
            height_px=frame.height,
            bit_depth=depth,
            white_level=(1 << depth) - 1,
            lossy=codec == "mjpeg",
        )
        return gray_image(frame), kind


def _stated_size(codec: str, head: bytes) -> tuple[int, int] | None:
    """Size in the header of kinds that have it at a fixed place."""
    if codec == "png" and len(head) >= 24:
        width, height = struct.unpack(">II", head[16:24])
        return width, height
    if codec == "bmp" and len(head) >= 26:
        width, height = struct.unpack("<ii", head[18:26])
        return abs(width), abs(height)
    return None

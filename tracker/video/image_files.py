"""Single image files as gray images at full depth, all of one size and kind."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import av
import av.error

from tracker.arrays import GrayImage
from tracker.video.base import (
    DECODER_OPTIONS,
    MAX_PIXELS,
    SourceInfo,
    UnreadableVideoError,
    check_image_size,
    check_regular_file,
    read_head,
    unreadable,
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
# Uncompressed 16-bit colour with a margin; a larger file exceeds the limit of pixels.
MAX_BYTES_PER_PIXEL = 8
JPEG_END, JPEG_END_WITHIN = b"\xff\xd9", 4096


class ImageFiles:
    """Reads image files one after the other; the first good one sets size and kind for all."""

    def __init__(self) -> None:
        self.kind: SourceInfo | None = None

    def read(self, path: Path) -> GrayImage | None:
        """Gray image of one file, shape (height, width); None when it is damaged.

        An image over the limit of pixels, or of another size or kind than previous ones, is refused.
        """
        if check_regular_file(path) > MAX_BYTES_PER_PIXEL * MAX_PIXELS:
            raise unreadable(path, f"too large for an image of {MAX_PIXELS / 1e6:.0f} Mpx")
        head = read_head(path, 32)
        codec = next((codec for magic, codec in _KINDS if head.startswith(magic)), "")
        if codec == "":
            return None
        found = self._decode(path, codec, head)
        if found is None and codec == "tiff":  # kinds unknown to FFmpeg
            found = self._read_tiff(path)
        if found is None:
            return None
        image, kind = found
        if self.kind is None:
            self.kind = kind
        elif (kind.width_px, kind.height_px) != (self.kind.width_px, self.kind.height_px):
            raise unreadable(
                path,
                f"the image is {kind.width_px} x {kind.height_px} px, previous ones "
                f"{self.kind.width_px} x {self.kind.height_px} px; move each size into its own folder",
            )
        elif kind != self.kind:
            raise unreadable(
                path,
                f"the image is {kind.codec} {kind.pixel_format}, previous ones "
                f"{self.kind.codec} {self.kind.pixel_format}; move each kind into its own folder",
            )
        return image

    def _read_tiff(self, path: Path) -> tuple[GrayImage, SourceInfo] | None:
        try:
            source = TiffSource(path)
        except UnreadableVideoError:
            if self.kind is None:
                raise
            return None
        try:
            image = next((frame.image for frame in source.frames()), None)
        finally:
            source.close()
        return None if image is None else (image, source.info)

    def _decode(self, path: Path, codec: str, head: bytes) -> tuple[GrayImage, SourceInfo] | None:
        width, height = _stated_size(codec, head)
        if width > 0 and height > 0:
            check_image_size(path, width, height)
        try:
            data = path.read_bytes()
        except OSError:
            return None  # the medium fails, or the file was removed
        if codec == "mjpeg" and data.rfind(JPEG_END) < max(len(data) - JPEG_END_WITHIN, 0):
            return None  # incomplete: the decoder would fill the rest with gray
        # A new decoder for each image: a reused one may mix in the previous image.
        decoder: Any = av.CodecContext.create(codec, "r")
        decoder.options = DECODER_OPTIONS
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
        kind = SourceInfo(
            codec="jpeg" if codec == "mjpeg" else codec,
            pixel_format=frame.format.name,
            width_px=frame.width,
            height_px=frame.height,
            bit_depth=depth,
            white_level=(1 << depth) - 1,
            lossy=codec == "mjpeg",
        )
        return gray_image(frame), kind


def _stated_size(codec: str, head: bytes) -> tuple[int, int]:
    """Size stated in the header of kinds that have it at a fixed offset; 0 for others."""
    form, start = {"png": (">II", 16), "bmp": ("<ii", 18)}.get(codec, ("", 0))
    if not form or len(head) < start + 8:
        return 0, 0
    width, height = struct.unpack_from(form, head, start)
    return abs(width), abs(height)

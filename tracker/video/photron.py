"""Photron recordings: a header (`.cih`, `.cihx`) and raw pixels (`.mraw`) of the same name beside it."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import numpy as np

from tracker.arrays import GrayImage
from tracker.video.base import (
    MAX_PIXELS,
    Frame,
    FrameSource,
    SourceInfo,
    UnreadableVideoError,
    check_picture_size,
    check_regular_file,
    shown,
)
from tracker.video.gray import packed_bytes, unpack_10, unpack_12
from tracker.video.photron_header import PhotronHeader, read_photron_header

HEADER_SUFFIXES = (".cihx", ".cih")
PIXEL_SUFFIX = ".mraw"
DEPTHS = (8, 10, 12, 16)


def companion(path: Path, suffixes: tuple[str, ...]) -> Path | None:
    """File of the same stem beside `path` with the first of `suffixes` that is there.

    A link counts only where `path` itself is one: whoever passes links over does so here as well.
    """
    for suffix in suffixes:
        for spelled in (suffix, suffix.upper()):
            beside = path.with_suffix(spelled)
            if beside != path and beside.is_file() and (path.is_symlink() or not beside.is_symlink()):
                return beside
    return None


class PhotronSource:
    """A Photron recording as a `tracker.video.base.FrameSource`.

    Pixels of 8 bit, of 10 and 12 bit packed with the most significant bit first, and of 16 bit (little-endian words
    that hold fewer bits at their lower or upper end, as the header says) are read. Whatever paths the header
    holds, the pixels are those of the `.mraw` beside it. Time stamps count the recorded frames, so that a step
    between saved frames is part of them.

    Raises
    ------
    UnreadableVideoError
        If the header lacks a key, no `.mraw` is beside it, or its pixels are of a kind that is not read.
    """

    def __init__(self, path: Path, *, max_pixels: int = MAX_PIXELS) -> None:
        header = read_photron_header(path)
        missing = header.missing("rate", "frames", "width", "height", "bits")
        if missing:
            msg = f"{shown(path)}: the header lacks {', '.join(map(repr, missing))}; save it again from the camera"
            raise UnreadableVideoError(msg)
        pixels = companion(path, (PIXEL_SUFFIX,))
        if pixels is None:
            msg = f"{shown(path)}: no {path.stem}{PIXEL_SUFFIX} beside the header; put the two together under one name"
            raise UnreadableVideoError(msg)
        width, height = header.whole("width"), header.whole("height")
        check_picture_size(path, width, height, max_pixels)
        self._bits = _stored_bits(path, header)
        self._frame_bytes = packed_bytes(width * height, self._bits)
        if self._frame_bytes < 0:
            msg = (
                f"{shown(path)}: pictures of {width} x {height} px of {self._bits} bit do not end with a byte"
            )
            raise UnreadableVideoError(msg)
        depth = min(header.whole("depth", self._bits) or self._bits, self._bits)
        upper = header.text("side", "Lower").lower() == "higher"
        self._shift = self._bits - depth if upper and self._bits == 16 else 0
        size = check_regular_file(pixels)
        declared = header.whole("frames")
        self._count = min(declared, size // self._frame_bytes)
        rate = header.rate()
        self._step = header.step()
        self._file = pixels.open("rb")
        self.info = SourceInfo(
            codec="mraw",
            pixel_format=f"gray{self._bits}" + (" packed" if self._bits in (10, 12) else ""),
            width_px=width,
            height_px=height,
            bit_depth=depth,
            white_level=(1 << depth) - 1,
            frames_declared=declared,
            lossy=False,
            predictive=False,
            time_base=1 / rate,
            container_rate=None,
            header_rate=rate,
            notes=_notes(header, pixels, size, self._frame_bytes),
            frame_step=self._step,
        )

    def close(self) -> None:
        """Release the file."""
        self._file.close()

    def stamps(self) -> list[int | None]:
        """Index of each frame on the camera's clock."""
        return [k * self._step for k in range(self._count)]

    def frames(self) -> Iterator[Frame]:
        """All frames that are in the file."""
        for k in range(self._count):
            yield Frame(self._image(k), k * self._step)

    def _image(self, k: int) -> GrayImage | None:
        try:
            self._file.seek(k * self._frame_bytes)
            data = self._file.read(self._frame_bytes)
        except OSError:
            return None  # the medium fails at this frame; others may be readable
        if len(data) < self._frame_bytes:
            return None
        shape = self.info.height_px, self.info.width_px
        if self._bits == 16:
            words = np.frombuffer(data, dtype="<u2").reshape(shape)
            return np.asarray(words >> np.uint16(self._shift), dtype=np.uint16)
        raw = np.frombuffer(data, dtype=np.uint8)
        if self._bits == 8:
            return raw.reshape(shape).copy()
        return (unpack_10 if self._bits == 10 else unpack_12)(raw).reshape(shape)


class HeaderTimed:
    """A video with the header of a Photron camera beside it: the video's pictures on the camera's clock."""

    def __init__(self, source: FrameSource, header: PhotronHeader) -> None:
        self._source = source
        self._rate: Fraction = header.rate()
        self._step = header.step()
        self._notes = [f"The recorded rate is that of {shown(header.path)}, which stands beside the video."]
        info = source.info
        size = (header.whole("width", info.width_px), header.whole("height", info.height_px))
        if size != (info.width_px, info.height_px):
            self._notes.append(
                f"{shown(header.path)} speaks of pictures of {size[0]} x {size[1]} px, the video has "
                f"{info.width_px} x {info.height_px} px: make sure that they belong together."
            )

    @property
    def info(self) -> SourceInfo:
        """Facts of the video, with the camera's rate."""
        info = self._source.info
        return dataclasses.replace(
            info,
            time_base=1 / self._rate,
            header_rate=self._rate,
            frame_step=self._step,
            notes=(*info.notes, *self._notes),
        )

    def frames(self) -> Iterator[Frame]:
        """Frames of the video, counted on the camera's clock."""
        for k, frame in enumerate(self._source.frames()):
            yield Frame(frame.image, k * self._step)

    def stamps(self) -> list[int | None]:
        """Index of each frame on the camera's clock."""
        return [k * self._step for k in range(len(self._source.stamps()))]

    def close(self) -> None:
        """Release the file."""
        self._source.close()


def _stored_bits(path: Path, header: PhotronHeader) -> int:
    color = header.text("color", "Mono")
    bits = header.whole("bits")
    if color.lower() not in ("mono", "raw"):
        msg = f"{shown(path)}: pixels of color type {color[:20]!r} are not read; save as monochrome or raw, or as AVI"
        raise UnreadableVideoError(msg)
    if bits not in DEPTHS:
        msg = f"{shown(path)}: pixels of {bits} bit are not read, expected {', '.join(map(str, DEPTHS))}"
        raise UnreadableVideoError(msg)
    return bits


def _notes(header: PhotronHeader, pixels: Path, size: int, frame_bytes: int) -> tuple[str, ...]:
    notes = []
    declared, rest = header.whole("frames"), size % frame_bytes
    if size // frame_bytes > declared:
        notes.append(
            f"{shown(pixels)} is larger than the {declared} frames of its header; what is beyond them is left out."
        )
    elif size < declared * frame_bytes and rest:
        notes.append(f"{shown(pixels)} ends within a frame, which is left out; the copy may be incomplete.")
    if header.text("color", "Mono").lower() == "raw" and "-c-" in header.text("camera", "").lower():
        notes.append(
            "The pixels are those of a color sensor behind its mosaic of filters, taken as gray: positions are less "
            "certain than with a monochrome camera."
        )
    return tuple(notes)

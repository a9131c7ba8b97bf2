"""Photron recordings: a header (`.cih`, `.cihx`) with raw pixels (`.mraw`) of the same name in the same folder."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from tracker.arrays import GrayImage
from tracker.video.camera_header import (
    HEADER_SUFFIXES,
    PhotronHeader,
    companion,
    read_photron_header,
    with_companion,
)
from tracker.video.source import (
    Frame,
    FrameSource,
    Reader,
    SourceInfo,
    check_image_size,
    check_regular_file,
    packed_bytes,
    shown,
    unpacked,
    unreadable,
)

PIXEL_SUFFIX = ".mraw"
DEPTHS = (8, 10, 12, 16)


class PhotronSource:
    """A Photron recording as a `tracker.video.source.FrameSource`.

    Supported are pixels of 8 bit, of 10 and 12 bit packed with the most significant bit first, and of 16 bit
    (little-endian words with the significant bits at their lower or upper end, as the header states). The pixels are
    those of the `.mraw` next to the header, whatever paths the header contains. Time stamps count recorded frames and
    thus include a step between saved frames.
    """

    def __init__(self, path: Path) -> None:
        header = read_photron_header(path)
        missing = header.missing("rate", "frames", "width", "height", "bits")
        if missing:
            raise unreadable(
                path, f"the header lacks {', '.join(map(repr, missing))}; save it again from the camera"
            )
        pixels = companion(path, (PIXEL_SUFFIX,))
        if pixels is None:
            raise unreadable(
                path,
                f"no {path.stem}{PIXEL_SUFFIX} next to the header; put both into one folder, with the same name",
            )
        width, height = header.whole("width"), header.whole("height")
        check_image_size(path, width, height)
        self._bits = _stored_bits(path, header)
        self._frame_bytes = packed_bytes(width * height, self._bits)
        if self._frame_bytes < 0:
            raise unreadable(
                path, f"images of {width} x {height} px of {self._bits} bit do not end at a byte boundary"
            )
        depth = min(header.whole("depth", self._bits) or self._bits, self._bits)
        upper = header.values.get("side", "Lower").lower() == "higher"
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
            time_base=1 / rate,
            header_rate=rate,
            notes=_notes(header, pixels, size, self._frame_bytes),
            frame_step=self._step,
        )

    def close(self) -> None:
        """Release the file."""
        self._file.close()

    def stamps(self) -> list[int | None]:
        """Index of each frame in recorded frames."""
        return [k * self._step for k in range(self._count)]

    def frames(self) -> Iterator[Frame]:
        """All frames in the file."""
        for k in range(self._count):
            yield Frame(self._image(k), k * self._step)

    def frame_at(self, pts: int) -> GrayImage | None:
        """The frame with one of the `stamps`; None if it is damaged."""
        return self._image(pts // self._step)

    def _image(self, k: int) -> GrayImage | None:
        try:
            self._file.seek(k * self._frame_bytes)
            data = self._file.read(self._frame_bytes)
        except OSError:
            return None  # the medium fails at this frame; others may be readable
        if len(data) < self._frame_bytes:
            return None
        pixels = unpacked(np.frombuffer(data, dtype=np.uint8), self._bits)
        if self._shift:
            np.right_shift(pixels, self._shift, out=pixels)
        return pixels.reshape(self.info.height_px, self.info.width_px)


def _stored_bits(path: Path, header: PhotronHeader) -> int:
    color = header.values.get("color", "Mono")
    bits = header.whole("bits")
    if color.lower() not in ("mono", "raw"):
        raise unreadable(
            path, f"pixels of color type {color[:20]!r} are not supported; save as monochrome, raw or AVI"
        )
    if bits not in DEPTHS:
        raise unreadable(
            path, f"pixels of {bits} bit are not supported, expected {', '.join(map(str, DEPTHS))}"
        )
    return bits


def _notes(header: PhotronHeader, pixels: Path, size: int, frame_bytes: int) -> tuple[str, ...]:
    notes = []
    declared, rest = header.whole("frames"), size % frame_bytes
    if size // frame_bytes > declared:
        notes.append(
            f"{shown(pixels)} is larger than the {declared} frames of its header; the rest is ignored."
        )
    elif size < declared * frame_bytes and rest:
        notes.append(f"{shown(pixels)} ends within a frame, which is ignored; the copy may be incomplete.")
    if (
        header.values.get("color", "Mono").lower() == "raw"
        and "-c-" in header.values.get("camera", "").lower()
    ):
        notes.append(
            "The pixels are those of a color sensor with its filter mosaic, used as gray levels: positions are less "
            "accurate than with a monochrome camera."
        )
    return tuple(notes)


class PhotronReader(Reader):
    """Photron recordings, given by their header or by their pixels."""

    name = "photron"
    suffixes = HEADER_SUFFIXES

    def recognises(self, path: Path, head: bytes) -> bool:  # noqa: ARG002 - raw pixels have no mark
        """By the ending."""
        return path.suffix.lower() in (*HEADER_SUFFIXES, PIXEL_SUFFIX)

    def open(self, path: Path) -> FrameSource:
        """Open by the header."""
        if path.suffix.lower() != PIXEL_SUFFIX:
            return PhotronSource(path)
        header = companion(path, HEADER_SUFFIXES)
        if header is None:
            raise unreadable(
                path,
                "raw pixels without their header; put the .cih or .cihx of the same name into its folder",
            )
        return PhotronSource(header)

    def files(self, path: Path) -> tuple[Path, ...]:
        """Header and pixels."""
        return with_companion(
            path, HEADER_SUFFIXES if path.suffix.lower() == PIXEL_SUFFIX else (PIXEL_SUFFIX,)
        )


PHOTRON = PhotronReader()

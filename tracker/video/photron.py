"""Photron recordings: a header (`.cih`, `.cihx`) with raw pixels (`.mraw`) of the same name in the same folder.

Other recordings are timed by a header in their folder as well.
"""

from __future__ import annotations

import dataclasses
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Protocol

import numpy as np

from tracker.arrays import GrayImage
from tracker.settings_base import TUNING as OPTIONS
from tracker.video.source import (
    Frame,
    FrameSource,
    Reader,
    SourceInfo,
    UnreadableVideoError,
    check_image_size,
    check_regular_file,
    packed_bytes,
    read_head,
    shown,
    unpacked,
    unreadable,
)


@dataclass(frozen=True)
class Tuning:
    """Limits of a camera header."""

    #: [bytes] of a header
    #: convention: chosen; effect on damaged files only
    max_header_bytes: int = 16_000_000
    #: [1] tags and attributes of a header
    #: convention: cameras write a few hundred, and each takes many times its size in memory
    max_tags: int = 20_000


TUNING = Tuning()

# Content of a header: own name, key in a .cih, path in a .cihx.
KEYS = (
    ("rate", "Record Rate(fps)", "cih/recordInfo/recordRate"),
    ("frames", "Total Frame", "cih/frameInfo/totalFrame"),
    ("step", "Save Step", "cih/frameInfo/skipFrame"),
    ("width", "Image Width", "cih/imageDataInfo/resolution/width"),
    ("height", "Image Height", "cih/imageDataInfo/resolution/height"),
    ("color", "Color Type", "cih/imageDataInfo/colorInfo/type"),
    ("bits", "Color Bit", "cih/imageDataInfo/colorInfo/bit"),
    ("depth", "EffectiveBit Depth", "cih/imageDataInfo/effectiveBit/depth"),
    ("side", "EffectiveBit Side", "cih/imageDataInfo/effectiveBit/side"),
    ("camera", "Camera Type", "cih/deviceInfo/deviceName"),
)


@dataclass(frozen=True)
class PhotronHeader:
    """Values of a Photron header by the names in `KEYS`; `keys` holds their spelling in the file."""

    path: Path
    values: dict[str, str]
    keys: dict[str, str]

    def whole(self, name: str, default: int | None = None) -> int:
        """Non-negative whole number; refused where it is absent without a `default`, or not such a number."""
        if name not in self.values and default is not None:
            return default
        text = self._required(name)
        if not (text.isascii() and text.isdecimal() and len(text) <= 12):
            raise unreadable(self.path, f"{self.keys[name]!r} is {text[:40]!r}, expected a whole number")
        return int(text)

    def rate(self) -> Fraction:
        """Frames recorded per second; refused where absent or not a positive number."""
        text = self._required("rate")
        try:
            rate = Fraction(text) if len(text) <= 40 and "e" not in text.lower() else Fraction(0)
        except (ValueError, ZeroDivisionError):
            rate = Fraction(0)
        if not 0 < rate <= OPTIONS.max_fps:
            raise unreadable(self.path, f"{self.keys['rate']!r} is {text[:40]!r}, expected frames per second")
        return rate

    def step(self) -> int:
        """Interval between saved frames, in recorded frames."""
        return max(self.whole("step", 1), 1)

    def missing(self, *names: str) -> tuple[str, ...]:
        """Missing keys among `names`, in the spelling of the file."""
        return tuple(self.keys[name] for name in names if name not in self.values)

    def _required(self, name: str) -> str:
        if name not in self.values:
            raise unreadable(
                self.path, f"the header has no {self.keys[name]!r}; save it again with the camera software"
            )
        return self.values[name]


def read_photron_header(path: Path) -> PhotronHeader:
    """Read a `.cih` or `.cihx`; the content decides which of the two it is.

    Raises
    ------
    UnreadableVideoError
        If the file cannot be read, is larger than 16 MB, is not such a header, defines XML entities or has more than
        20 000 tags and attributes.
    """
    if check_regular_file(path) > TUNING.max_header_bytes:
        raise unreadable(path, f"too large for a camera header (over {TUNING.max_header_bytes // 10**6} MB)")
    data = read_head(path, TUNING.max_header_bytes)
    if b"<cih>" in data or b"<?xml" in data:
        found, column = _xml_values(path, data), 2
    else:
        found, column = _text_values(data), 1
    values = {row[0]: found[row[column]] for row in KEYS if found.get(row[column])}
    if not values:
        raise unreadable(path, f"not a Photron header (it has none of its keys, such as {KEYS[0][column]!r})")
    return PhotronHeader(path, values, {row[0]: row[column] for row in KEYS})


def _text_values(data: bytes) -> dict[str, str]:
    values: dict[str, str] = {}
    # Comments may be in any code page; the keys are ASCII.
    for line in data.decode("ascii", "replace").splitlines():
        key, colon, value = line.partition(":")
        if colon:
            values.setdefault(key.strip(), value.strip())
    return values


def _xml_values(path: Path, data: bytes) -> dict[str, str]:
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise unreadable(path, "the header defines XML entities, which no camera does; it is rejected")
    start, stop = data.find(b"<cih>"), data.rfind(b"</cih>")
    if start < 0 or stop < start:
        raise unreadable(path, "the header is incomplete (no <cih> ... </cih> in it)")
    tags = data.count(b"<", start, stop) + data.count(b"=", start, stop)
    if tags > TUNING.max_tags:
        raise unreadable(path, f"not a camera header (it has {tags} tags and attributes); it is rejected")
    try:
        # Without a document type there are no entities to expand.
        root = ET.fromstring(data[start : stop + 6].decode("utf-8", "replace"))  # noqa: S314
    except ET.ParseError as error:
        raise unreadable(path, f"the header is damaged ({error})") from error
    return {key: (root.findtext(key.removeprefix("cih/")) or "").strip() for _, _, key in KEYS}


HEADER_SUFFIXES = (".cihx", ".cih")


def companion(path: Path, suffixes: tuple[str, ...]) -> Path | None:
    """Existing file of the same folder and stem as `path` with the first possible of `suffixes`.

    A link counts only where `path` itself is one: callers that ignore links then ignore it here as well.
    """
    for suffix in suffixes:
        for spelled in (suffix, suffix.upper()):
            candidate = path.with_suffix(spelled)
            # The name of a file may be so long that no other ending fits: then there is none.
            with suppress(OSError):
                if (
                    candidate != path
                    and candidate.is_file()
                    and (path.is_symlink() or not candidate.is_symlink())
                ):
                    return candidate
    return None


def with_companion(path: Path, suffixes: tuple[str, ...]) -> tuple[Path, ...]:
    """The path and its companion, if there is one."""
    found = companion(path, suffixes)
    return (path, found) if found else (path,)


class HeaderTimed:
    """A recording with the time axis of a Photron header."""

    def __init__(self, source: FrameSource, header: PhotronHeader) -> None:
        self.recording = source
        self._rate: Fraction = header.rate()
        self._step = header.step()
        self._notes = [f"The recorded rate is that of {shown(header.path)} in the same folder."]
        info = source.info
        size = (header.whole("width", info.width_px), header.whole("height", info.height_px))
        if size != (info.width_px, info.height_px):
            self._notes.append(
                f"{shown(header.path)} states images of {size[0]} x {size[1]} px, the recording has "
                f"{info.width_px} x {info.height_px} px: make sure that they belong together."
            )

    @property
    def info(self) -> SourceInfo:
        """Properties of the recording, with the camera's rate."""
        info = self.recording.info
        return dataclasses.replace(
            info,
            time_base=1 / self._rate,
            header_rate=self._rate,
            frame_step=self._step,
            notes=(*info.notes, *self._notes),
        )

    def frames(self) -> Iterator[Frame]:
        """Frames of the recording, counted in recorded frames."""
        for k, frame in enumerate(self.recording.frames()):
            yield Frame(frame.image, k * self._step)

    def stamps(self) -> list[int | None]:
        """Index of each frame in recorded frames."""
        return [k * self._step for k in range(len(self.recording.stamps()))]

    def close(self) -> None:
        """Release the file."""
        self.recording.close()


def without_header(source: FrameSource) -> FrameSource:
    """The source itself, with its own time stamps, where a header gives others."""
    return source.recording if isinstance(source, HeaderTimed) else source


class AnnotatableSource(FrameSource, Protocol):
    """A source whose `info` can be set, for a note on its header."""

    info: SourceInfo


def with_header(source: AnnotatableSource, header: Path | None) -> FrameSource:
    """The source with the rate of a camera header; an unusable header gives a note."""
    if header is None:
        return source
    try:
        return HeaderTimed(source, read_photron_header(header))
    except UnreadableVideoError as error:
        note = f"The camera header in the same folder was not used ({error})."
        source.info = dataclasses.replace(source.info, notes=(*source.info.notes, note))
        return source


def with_header_beside(source: AnnotatableSource, path: Path) -> FrameSource:
    """The source with the rate of a camera header of the same name, if there is one."""
    return with_header(source, companion(path, HEADER_SUFFIXES))


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

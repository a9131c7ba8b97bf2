"""Headers of Photron cameras, `.cih` (text) and `.cihx` (XML), and recordings timed by one in their folder."""

from __future__ import annotations

import dataclasses
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Protocol

from tracker.settings_base import TUNING as OPTIONS
from tracker.video.source import (
    Frame,
    FrameSource,
    SourceInfo,
    UnreadableVideoError,
    check_regular_file,
    read_head,
    shown,
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

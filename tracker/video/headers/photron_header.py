"""Headers of Photron cameras: `.cih` (lines of text) and `.cihx` (XML after a binary preamble)."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

from tracker.video.base import check_regular_file, read_head, unreadable

MAX_HEADER_BYTES = 16_000_000
# Tags and attributes of a .cihx: cameras write a few hundred, and each takes many times its size in memory.
MAX_TAGS = 20_000
MAX_RATE = 10**9
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
        if not 0 < rate <= MAX_RATE:
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
    if check_regular_file(path) > MAX_HEADER_BYTES:
        raise unreadable(path, f"too large for a camera header (over {MAX_HEADER_BYTES // 10**6} MB)")
    data = read_head(path, MAX_HEADER_BYTES)
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
    if tags > MAX_TAGS:
        raise unreadable(path, f"not a camera header (it has {tags} tags and attributes); it is rejected")
    try:
        # Without a document type there are no entities to expand.
        root = ET.fromstring(data[start : stop + 6].decode("utf-8", "replace"))  # noqa: S314
    except ET.ParseError as error:
        raise unreadable(path, f"the header is damaged ({error})") from error
    return {key: (root.findtext(key.removeprefix("cih/")) or "").strip() for _, _, key in KEYS}

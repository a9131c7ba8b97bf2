"""Image files at full depth as a recording: the number in each name is the index of a frame."""

from __future__ import annotations

import dataclasses
import math
import os
import re
import struct
from collections import defaultdict
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import av
import av.error

from tracker.arrays import GrayImage
from tracker.video.photron import HEADER_SUFFIXES, with_header
from tracker.video.source import (
    DECODER_OPTIONS,
    Frame,
    FrameSource,
    Reader,
    SourceInfo,
    UnreadableVideoError,
    check_image_size,
    check_regular_file,
    gray_depth,
    gray_image,
    read_head,
    unreadable,
)
from tracker.video.source import TUNING as LIMITS
from tracker.video.tiff import TiffSource


@dataclasses.dataclass(frozen=True)
class Tuning:
    """Folders of images."""

    #: [bytes] of a file for each pixel of the largest image
    #: physics: uncompressed colour of 16 bit with a margin
    max_bytes_per_pixel: int = 8
    #: [bytes] from the end of a JPEG within which its mark must be
    #: convention: some programs add bytes behind it
    jpeg_end_within: int = 4096
    #: [images] of a recording
    #: convention: fewer numbered images are photographs
    least_images: int = 10
    #: [images] tried until one can be read, which determines size and depth of all
    tried_for_size: int = 20
    #: [1] gaps that a note names
    #: convention: a line of text
    gaps_named: int = 5


TUNING = Tuning()

IMAGE_SUFFIXES = (".bmp", ".jpeg", ".jpg", ".png", ".tif", ".tiff")
# Leading bytes, FFmpeg's decoder.
_KINDS = (
    (b"\x89PNG\r\n\x1a\n", "png"),
    (b"\xff\xd8\xff", "mjpeg"),
    (b"BM", "bmp"),
    (b"II", "tiff"),
    (b"MM", "tiff"),
)
JPEG_END = b"\xff\xd9"


class ImageFiles:
    """Reads image files one after the other; the first good one sets size and kind for all."""

    def __init__(self) -> None:
        self.kind: SourceInfo | None = None

    def read(self, path: Path) -> GrayImage | None:
        """Gray image of one file, shape (height, width); None when it is damaged.

        An image over the limit of pixels, or of another size or kind than previous ones, is refused.
        """
        if check_regular_file(path) > TUNING.max_bytes_per_pixel * LIMITS.max_pixels:
            raise unreadable(path, f"too large for an image of {LIMITS.max_pixels / 1e6:.0f} Mpx")
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
        if codec == "mjpeg" and data.rfind(JPEG_END) < max(len(data) - TUNING.jpeg_end_within, 0):
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


_NUMBERED = re.compile(r"^(?P<prefix>.*?)(?P<number>\d{1,15})(?P<rest>\D*)$", re.DOTALL)


@dataclasses.dataclass(frozen=True)
class ImageSeries:
    """Files of one folder that differ only in their last number, in its order."""

    prefix: str
    suffix: str
    files: tuple[tuple[int, str], ...]


def image_series(names: list[str]) -> tuple[ImageSeries, ...]:
    """Numbered series of at least ten images among file names, longest first.

    ``frame2.png`` precedes ``frame10.png``; names that differ before or after the number belong to different series.
    """
    groups: dict[tuple[str, str], list[tuple[int, str]]] = defaultdict(list)
    for name in names:
        stem, suffix = os.path.splitext(name)  # noqa: PTH122 - names, not paths: they may be anything
        match = _NUMBERED.match(stem)
        if suffix.lower() in IMAGE_SUFFIXES and match is not None and not name.startswith("."):
            groups[match["prefix"], match["rest"] + suffix.lower()].append((int(match["number"]), name))
    series = [
        ImageSeries(prefix, suffix, tuple(sorted(files)))
        for (prefix, suffix), files in groups.items()
        if len(files) >= TUNING.least_images
    ]
    return tuple(sorted(series, key=lambda s: (-len(s.files), s.prefix, s.suffix)))


class ImageFolder:
    """A folder of numbered images (PNG, TIFF, BMP, JPEG) as a `tracker.video.source.FrameSource`.

    Numbers without a file are frames without image, so that the others keep their time; numbers that all increase in
    steps of more than one count as consecutive. Only one image and the list of names are in memory. The folder must
    hold exactly one series of at least ten numbered images, with no number twice and at most half of them missing.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._files = _only_series(folder).files
        self._step = _step(folder, self._files)
        first, last = self._files[0][0], self._files[-1][0]
        self._span = (last - first) // self._step + 1
        if self._span > 2 * len(self._files) or self._span > LIMITS.max_frames:
            raise unreadable(
                folder,
                f"the numbers from {first} to {last} leave room for {self._span} frames, but only "
                f"{len(self._files)} images exist; number them without gaps, or remove stray files",
            )
        self._images = ImageFiles()
        self.info = self._first_info()

    def close(self) -> None:
        """Nothing stays open between images."""

    def stamps(self) -> list[int | None]:
        """Number of each frame from 0, missing ones included."""
        return list(range(self._span))

    def frames(self) -> Iterator[Frame]:
        """One frame per number; missing or damaged ones without image."""
        start = self._files[0][0]
        k = 0
        for number, name in self._files:
            place = (number - start) // self._step
            for absent in range(k, place):
                yield Frame(None, absent)
            yield Frame(self._images.read(self._folder / name), place)
            k = place + 1

    def frame_at(self, pts: int) -> GrayImage | None:
        """The frame with one of the `stamps`; None if it is missing or damaged."""
        name = dict(self._files).get(self._files[0][0] + pts * self._step)
        return None if name is None else self._images.read(self._folder / name)

    def _first_info(self) -> SourceInfo:
        for _, name in self._files[: TUNING.tried_for_size]:
            self._images.read(self._folder / name)
            if self._images.kind is not None:
                return dataclasses.replace(self._images.kind, frames_declared=self._span, notes=self._notes())
        first = self._folder / self._files[0][1]
        raise unreadable(first, "neither this image nor the next ones can be read")

    def _notes(self) -> tuple[str, ...]:
        notes = []
        if self._step > 1:
            notes.append(
                f"The image numbers increase in steps of {self._step}: the rate to give is that of the existing images."
            )
        gaps = [
            (before + self._step, after - self._step)
            for (before, _), (after, _) in pairwise(self._files)
            if after - before > self._step
        ]
        if gaps:
            named = [f"{a}" if a == b else f"{a} to {b}" for a, b in gaps[: TUNING.gaps_named]]
            more = f" and {len(gaps) - TUNING.gaps_named} other gaps" if len(gaps) > TUNING.gaps_named else ""
            absent = self._span - len(self._files)
            notes.append(
                f"{absent} of {self._span} numbers have no image ({', '.join(named)}{more}); they are kept as frames "
                "without image."
            )
        return tuple(notes)


def _only_series(folder: Path) -> ImageSeries:
    try:
        with os.scandir(folder) as entries:
            names = [e.name for e in entries if e.is_file(follow_symlinks=False)]
    except OSError as error:
        raise unreadable(
            folder, f"cannot be read ({error.strerror}); check the name and the permissions"
        ) from error
    found = image_series(names)
    if not found:
        raise unreadable(
            folder,
            f"no series of numbered images, expected at least {TUNING.least_images} of {', '.join(IMAGE_SUFFIXES)}",
        )
    if len(found) > 1:
        named = ", ".join(f"{s.files[0][1]} ..." for s in found[:3])
        raise unreadable(
            folder,
            f"{len(found)} series of images are in one folder ({named}); move each into its own folder",
        )
    return found[0]


def _step(folder: Path, files: tuple[tuple[int, str], ...]) -> int:
    differences = [after - before for (before, _), (after, _) in pairwise(files)]
    if 0 in differences:
        k = differences.index(0)
        raise unreadable(
            folder, f"{files[k][1]} and {files[k + 1][1]} have the same number; keep one of them"
        )
    return math.gcd(*differences)


class ImageFolderReader(Reader):
    """Folders of numbered images."""

    name = "image folder"

    def recognises(self, path: Path, head: bytes) -> bool:  # noqa: ARG002 - folders have none
        """Any folder."""
        return path.is_dir()

    def open(self, path: Path) -> FrameSource:
        """Open a folder, with the rate of the one camera header in it, if there is exactly one."""
        headers = [p for p in self.files(path) if p.suffix.lower() in HEADER_SUFFIXES]
        only = headers[0] if len(headers) == 1 and not headers[0].is_symlink() else None
        return with_header(ImageFolder(path), only)

    def files(self, path: Path) -> tuple[Path, ...]:
        """All images and camera headers in the folder."""
        suffixes = (*IMAGE_SUFFIXES, *HEADER_SUFFIXES)
        return tuple(sorted(p for p in path.iterdir() if p.suffix.lower() in suffixes and p.is_file()))


IMAGE_FOLDER = ImageFolderReader()

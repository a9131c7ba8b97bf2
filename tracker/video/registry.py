"""One door to all readers: which one a path needs, and what a recording is, without tracking anything."""

from __future__ import annotations

import dataclasses
from collections import Counter
from itertools import pairwise
from pathlib import Path

from tracker.arrays import GrayImage
from tracker.video.base import (
    FrameSource,
    SourceInfo,
    UnreadableVideoError,
    check_regular_file,
    read_head,
    shown,
)
from tracker.video.ffmpeg import VideoSource
from tracker.video.image_files import IMAGE_SUFFIXES
from tracker.video.image_folder import ImageFolder
from tracker.video.phantom import PhantomSource, is_monochrome
from tracker.video.photron import HEADER_SUFFIXES, PIXEL_SUFFIX, HeaderTimed, PhotronSource, companion
from tracker.video.photron_header import read_photron_header
from tracker.video.tiff import TiffSource, is_tiff

# "CI", and the length of the header that every version of the format has.
CINE_HEAD = b"CI\x2c\x00"


def open_recording(path: Path) -> FrameSource:
    """Open a recording with the reader it needs.

    A folder is one recording of numbered images; a Photron header or its pixels stand for both. Of the other files
    the first bytes decide. A Photron header beside a video or among images gives them its rate.

    Raises
    ------
    UnreadableVideoError
        If it is none that can be read; the text says why and what to do next.
    """
    if path.is_dir():
        header = _header_among(path)
        return _timed(ImageFolder(path), header)
    suffix = path.suffix.lower()
    if suffix in HEADER_SUFFIXES:
        return PhotronSource(path)
    if suffix == PIXEL_SUFFIX:
        return PhotronSource(_header_of(path))
    check_regular_file(path)
    head = read_head(path, 4)
    if is_tiff(head):
        return _timed(TiffSource(path), companion(path, HEADER_SUFFIXES))
    if head == CINE_HEAD and is_monochrome(path):
        return PhantomSource(path)
    return _timed(VideoSource(path), companion(path, HEADER_SUFFIXES))


def input_files(path: Path) -> tuple[Path, ...]:
    """All files that a recording is made of, in an order that does not change; whether they can be read is not asked.

    Raises
    ------
    OSError
        If `path` is a folder that cannot be listed.
    """
    if path.is_dir():
        suffixes = (*IMAGE_SUFFIXES, *HEADER_SUFFIXES)
        return tuple(sorted(p for p in path.iterdir() if p.suffix.lower() in suffixes and p.is_file()))
    beside = companion(path, (PIXEL_SUFFIX,) if path.suffix.lower() in HEADER_SUFFIXES else HEADER_SUFFIXES)
    return (path, beside) if beside else (path,)


def _header_of(pixels: Path) -> Path:
    header = companion(pixels, HEADER_SUFFIXES)
    if header is None:
        msg = f"{shown(pixels)}: raw pixels without their header; put the .cih or .cihx of the same name beside it"
        raise UnreadableVideoError(msg)
    return header


def _header_among(folder: Path) -> Path | None:
    """The one camera header in a folder of images; None where there is none, or more than one."""
    headers = sorted(p for p in folder.iterdir() if p.suffix.lower() in HEADER_SUFFIXES and p.is_file())
    return headers[0] if len(headers) == 1 and not headers[0].is_symlink() else None


def _timed(source: VideoSource | ImageFolder | TiffSource, header: Path | None) -> FrameSource:
    """The source on the clock of a camera's header; a header that cannot serve is named in a note."""
    if header is None:
        return source
    try:
        return HeaderTimed(source, read_photron_header(header))
    except UnreadableVideoError as error:
        note = f"The camera's header beside it was not used ({error})."
        source.info = dataclasses.replace(source.info, notes=(*source.info.notes, note))
        return source


@dataclasses.dataclass(frozen=True)
class ProbeReport:
    """What a recording is, without tracking anything.

    ``step_ticks`` maps the difference of neighbouring time stamps, in ticks of ``info.time_base``, to how
    often it occurs; ``packets`` counts coded pictures without decoding them.
    """

    info: SourceInfo
    packets: int
    stamps_missing: int
    step_ticks: dict[int, int]
    first_frame: GrayImage | None


def probe(path: Path) -> ProbeReport:
    """Read header, time stamps and the first good frame of a recording.

    Frames are counted, not decoded, but for those up to the first good one.

    Raises
    ------
    UnreadableVideoError
        As `open_recording`.
    """
    source = open_recording(path)
    try:
        first = next((frame.image for frame in source.frames() if frame.image is not None), None)
        info = source.info
    finally:
        source.close()
    source = open_recording(path)
    try:
        stamps = source.stamps()
    finally:
        source.close()
    known = sorted(pts for pts in stamps if pts is not None)
    steps = Counter(after - before for before, after in pairwise(known))
    return ProbeReport(info, len(stamps), len(stamps) - len(known), dict(sorted(steps.items())), first)

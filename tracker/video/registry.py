"""Registry of the readers: which one opens a path, and what a recording contains, without tracking it."""

from __future__ import annotations

from collections import Counter
from contextlib import closing
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

from tracker.arrays import GrayImage
from tracker.video.base import (
    FrameSource,
    Reader,
    SourceInfo,
    UnreadableVideoError,
    check_regular_file,
    read_head,
)
from tracker.video.ffmpeg import FFMPEG
from tracker.video.image_folder import IMAGE_FOLDER
from tracker.video.phantom import PHANTOM
from tracker.video.photron import PHOTRON
from tracker.video.tiff import TIFF

# Asked in this order; the last one accepts any file that may be a video.
READERS: list[Reader] = [PHOTRON, IMAGE_FOLDER, TIFF, PHANTOM, FFMPEG]


def register_reader(reader: Reader) -> None:
    """Add a reader, to be asked before those registered so far.

    Raises
    ------
    ValueError
        If another reader has its name.
    """
    if any(known.name == reader.name and known is not reader for known in READERS):
        msg = f"the reader {reader.name!r} is already registered; choose another name"
        raise ValueError(msg)
    if reader not in READERS:
        READERS.insert(0, reader)


def recording_suffixes() -> tuple[str, ...]:
    """Endings of files that are recordings, sorted."""
    return tuple(sorted({suffix for reader in READERS for suffix in reader.suffixes}))


def reader_of(path: Path) -> Reader:
    """The first reader that recognises a path; raises `UnreadableVideoError` if the file cannot be accessed."""
    head = b""
    if not path.is_dir():
        check_regular_file(path)
        head = read_head(path)
    return next(reader for reader in READERS if reader.recognises(path, head))


def open_recording(path: Path) -> FrameSource:
    """Open a recording with the reader that recognises it; raises `UnreadableVideoError` where it is unreadable."""
    return reader_of(path).open(path)


def input_files(path: Path) -> tuple[Path, ...]:
    """All files that a recording consists of, in a fixed order; the path itself where it is unreadable.

    Raises
    ------
    OSError
        If `path` is a folder that cannot be listed.
    """
    try:
        return reader_of(path).files(path)
    except UnreadableVideoError:
        return (path,)


@dataclass(frozen=True)
class ProbeReport:
    """Content of a recording, without tracking it.

    ``step_ticks`` maps the difference of neighbouring time stamps, in ticks of ``info.time_base``, to its number of
    occurrences; ``packets`` counts coded images without decoding them.
    """

    info: SourceInfo
    packets: int
    stamps_missing: int
    step_ticks: dict[int, int]
    first_frame: GrayImage | None


def probe(path: Path) -> ProbeReport:
    """Read header, time stamps and the first good frame of a recording; other frames are counted, not decoded.

    Raises
    ------
    UnreadableVideoError
        As `open_recording`.
    """
    with closing(open_recording(path)) as source:
        first = next((frame.image for frame in source.frames() if frame.image is not None), None)
        info = source.info
    with closing(open_recording(path)) as source:
        stamps = source.stamps()
        # The first frame adds notes on the images, all stamps one on frames that the file hides.
        notes = tuple(dict.fromkeys((*info.notes, *source.info.notes)))
        info = replace(info, frames_declared=source.info.frames_declared, notes=notes)
    known = sorted(pts for pts in stamps if pts is not None)
    steps = Counter(after - before for before, after in pairwise(known))
    return ProbeReport(info, len(stamps), len(stamps) - len(known), dict(sorted(steps.items())), first)

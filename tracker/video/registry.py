"""Registry of the readers: which one opens a path, what a recording contains, and access to its frames."""

from __future__ import annotations

import itertools
from collections import Counter, deque
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, replace
from itertools import islice, pairwise
from pathlib import Path
from typing import Protocol, runtime_checkable

from tracker.arrays import GrayImage
from tracker.video.ffmpeg import FFMPEG
from tracker.video.images import IMAGE_FOLDER
from tracker.video.phantom import PHANTOM
from tracker.video.photron import PHOTRON, without_header
from tracker.video.source import (
    Frame,
    FrameSource,
    Reader,
    SourceInfo,
    UnreadableVideoError,
    check_regular_file,
    read_head,
    shown,
)
from tracker.video.tiff import TIFF


@dataclass(frozen=True)
class Tuning:
    """Decoding ahead of tracking."""

    #: [frames] that are passed to tracking at once
    #: convention: waking the other thread for each one would cost more than decoding some codecs
    chunk_frames: int = 8
    #: [1] groups that are decoded ahead
    chunks_ahead: int = 3


TUNING = Tuning()

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


@runtime_checkable
class SeekableSource(FrameSource, Protocol):
    """An open recording that finds a frame by its time stamp."""

    def frame_at(self, pts: int) -> GrayImage | None:
        """The frame with one of the `stamps`; None if it is damaged."""


def frame_stamps(path: Path) -> tuple[int | None, ...]:
    """Time stamp in the file of each frame in presentation order, which `read_frame` takes; nothing is decoded.

    All are None where the stamps do not identify frames: if one is missing, or two are the same.

    Raises
    ------
    UnreadableVideoError
        As `tracker.video.registry.open_recording`.
    """
    with closing(open_recording(path)) as source:
        recording = without_header(source)
        stamps = recording.stamps()
    known = sorted(pts for pts in stamps if pts is not None)
    usable = isinstance(recording, SeekableSource) and len(known) == len(stamps) == len(set(known))
    return tuple(known) if usable else (None,) * len(stamps)


def read_frame(path: Path, index: int, stamps: Sequence[int | None]) -> GrayImage:
    """The frame of an index, as stored; `stamps` are those of `frame_stamps`, or empty while they are not known.

    Without its stamp the frames before it are decoded, too.

    Raises
    ------
    UnreadableVideoError
        As `open_recording`; if the frame is damaged; or if there is none of this index.
    """
    if index < 0 or (stamps and index >= len(stamps)):
        msg = f"{shown(path)}: there is no frame {index}; expected one from 0 to {len(stamps) - 1}"
        raise UnreadableVideoError(msg)
    with closing(open_recording(path)) as source:
        recording, pts = without_header(source), stamps[index] if stamps else None
        if pts is not None and isinstance(recording, SeekableSource):
            image = recording.frame_at(pts)
        else:
            frames = itertools.islice(recording.frames(), index, None)
            image = next((frame.image for frame in frames), None)
    if image is None:
        msg = f"{shown(path)}: frame {index} is damaged or missing; choose another one"
        raise UnreadableVideoError(msg)
    return image


def prefetched(stream: Iterator[Frame]) -> Generator[Frame]:
    """Frames of a stream that another thread reads, in order; an error of the stream is raised here.

    Closing the iterator ends the thread, whether or not the stream was read to its end.
    """

    def chunk() -> list[Frame]:
        return list(islice(stream, TUNING.chunk_frames))

    pool = ThreadPoolExecutor(1, thread_name_prefix="decode")
    try:
        waiting = deque(pool.submit(chunk) for _ in range(TUNING.chunks_ahead))
        while frames := waiting.popleft().result():
            waiting.append(pool.submit(chunk))
            yield from frames
    finally:
        pool.shutdown(cancel_futures=True)

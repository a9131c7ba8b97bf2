"""Any frame of a recording, without decoding all frames before it."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Protocol, runtime_checkable

from tracker.arrays import GrayImage
from tracker.video.base import FrameSource, UnreadableVideoError, shown
from tracker.video.headers import without_header
from tracker.video.registry import open_recording


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

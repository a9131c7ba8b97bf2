"""One door to all readers: which one a path needs, and what a recording is, without tracking anything."""

from __future__ import annotations

import dataclasses
from collections import Counter
from itertools import pairwise
from pathlib import Path

from tracker.source import FrameSource, GrayImage, SourceInfo
from tracker.video import VideoSource


def open_recording(path: Path) -> FrameSource:
    """Open a recording with the reader it needs.

    Raises
    ------
    UnreadableVideoError
        If it is none that can be read; the text says why and what to do next.
    """
    return VideoSource(path)


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

"""Tracking through all frames of a recording."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from tracker import flags
from tracker.arrays import GrayImage
from tracker.follow.filmstrip import StripKeeper
from tracker.follow.frame_results import RowStore
from tracker.follow.repeated_frames import image_change
from tracker.markers import FrameFollower, FrameResult
from tracker.video import Frame, SourceInfo, UnreadableVideoError

MAX_FRAMES = 10_000_000

Progress = Callable[[int, int], None]


@dataclass
class FollowedFrames:
    """Results of all frames, in the order of decoding, their presentation times and how much each image changed."""

    results: RowStore
    pts: list[int | None] = field(default_factory=list)
    changes: list[float] = field(default_factory=list)
    decoded: int = 0
    corrupt: int = 0
    strip: StripKeeper = field(default_factory=StripKeeper)


def follow_recording(
    stream: Iterator[Frame], follower: FrameFollower, info: SourceInfo, progress: Progress | None
) -> FollowedFrames:
    """Track all frames of a stream; more than ten million are refused."""
    rows = FollowedFrames(RowStore(follower.markers))
    before: GrayImage | None = None
    # The next step may still improve a result with motion blur: each is stored one frame later.
    waiting: FrameResult | None = None
    for frame in stream:
        if len(rows.pts) >= MAX_FRAMES:
            msg = f"the recording has more than {MAX_FRAMES} frames; split it"
            raise UnreadableVideoError(msg)
        rows.pts.append(frame.pts)
        mark = flags.LOSSY.value if info.lossy else 0
        if frame.image is None:
            rows.corrupt += 1
            change = float("nan")
            result: FrameResult = follower.missing(flags.DECODE_CORRUPT.value)
        else:
            rows.decoded += 1
            result = follower.step(frame.image)
            rows.strip.offer(len(rows.pts) - 1, frame.image, result.out)
            change = float("nan") if before is None else image_change(before, frame.image)
            before = frame.image
        rows.changes.append(change)
        np.bitwise_or(result.marks, mark, out=result.marks)
        if waiting is not None:
            rows.results.append(waiting.out, waiting.marks)
        waiting = result
        if progress is not None:
            progress(len(rows.pts), info.frames_declared)
    follower.finish()
    if waiting is not None:
        rows.results.append(waiting.out, waiting.marks)
    return rows

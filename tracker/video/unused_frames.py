"""Coded frames of a video file that are not used: hidden by its edit list, or damaged without an error.

Edit lists of MP4 and MOV files say which of the coded frames players show. Damage that decodes without an error: blocks
of a static background depart for a single picture.
"""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import av
import av.error
import numpy as np
from numpy.typing import NDArray

from tracker.arrays import BoolArray, GrayImage
from tracker.video.source import TUNING as SOURCE
from tracker.video.source import Frame, SourceInfo


@dataclass(frozen=True)
class Tuning:
    """Blocks that depart for a single picture."""

    #: [1] multiple of its largest recent step by which the mean of a block departs
    factor: float = 4.0
    #: [1] and share of white
    #: convention: coarse quantisation changes it by a few gray levels where nothing happens
    least: float = 0.02
    #: [1] of the largest recent step, per frame
    #: convention: a block that a vibration crosses is not static: a step is forgotten over hundreds of frames
    memory: float = 0.995
    #: [frames] from which the usual steps are known
    #: convention: all but the two largest, which a damaged one causes
    first: int = 9
    #: [blocks] that must depart
    least_blocks: int = 8
    #: [1] of the image above which it is the light
    most_blocks: float = 0.9
    #: [1] of these blocks that must return
    returned: float = 0.8
    #: [1] of the mean change, by which the outermost pixels of blocks change more
    #: convention: no object ends at the edges of coded blocks
    within: float = 0.5
    #: [1] of theirs, by which the pixels beyond change less
    #: convention: as above
    beyond: float = 0.25
    #: [frames] without image at the start after which nothing is learned any more
    most_waiting: int = 64


TUNING = Tuning()

# Name of FFmpeg's demultiplexer of the files that have edit lists.
MP4_FORMAT = "mov,mp4,m4a,3gp,3g2,mj2"


class EditList:
    """Frames of a video file that its edit list hides: a lead-in, and parts cut away on a phone.

    All frames are decoded with FFmpeg ignoring the edit list, since shown frames may depend on hidden ones and the time
    stamps must remain those of the recording. A second pass over the packets, without decoding, finds the frames that
    players show. A list that shows nothing is ignored.

    Parameters
    ----------
    options : dict
        Those of the container, without ``ignore_editlist``.
    """

    def __init__(self, path: Path, container: Any, stream: Any, options: dict[str, str]) -> None:
        self._shown: frozenset[int] | None = None
        self._hidden_pts: set[int | None] = set()
        if container.format.name == MP4_FORMAT and stream.frames:
            self._shown = _shown_packets(path, stream.index, options)

    def see(self, packet: Any) -> bool:
        """Whether players show the frame of a packet; registers it for `shows`."""
        if not self._shown or packet.size == 0 or packet.pos in self._shown:
            return True
        self._hidden_pts.add(packet.pts)
        return False

    def shows(self, pts: int | None) -> bool:
        """Whether players show the frame with this time stamp."""
        return pts not in self._hidden_pts

    def described(self, info: SourceInfo) -> SourceInfo:
        """Properties of a recording of which all packets were seen, with a note where frames were left out."""
        hidden = len(self._hidden_pts)
        if self._shown is not None and not self._shown:
            note = "The file's edit list shows none of its frames: it is ignored, and all frames are used."
        elif hidden:
            note = (
                f"{hidden} of {info.frames_declared} frames in the file are hidden by its edit list: players do not "
                "show them, and they are not used. The others keep the times at which they were recorded."
            )
        else:
            return info
        return replace(info, frames_declared=info.frames_declared - hidden, notes=(*info.notes, note))


def _shown_packets(path: Path, stream_index: int, options: dict[str, str]) -> frozenset[int]:
    """Positions in the file of the coded frames of a stream that players show."""
    shown = set()
    # What follows damage is unreadable in the other pass as well.
    with (
        contextlib.suppress(av.error.FFmpegError, ValueError, OSError),
        av.open(str(path.absolute()), mode="r", container_options=options) as container,
    ):
        for packet in container.demux(container.streams[stream_index]):
            if packet.size > 0 and not packet.is_discard and packet.pos is not None:
                shown.add(int(packet.pos))
    return frozenset(shown)


# Side of a coded block of JPEG and its kin, in px.
BLOCK_PX = 8


Means = NDArray[np.float32]


def without_departures(frames: Iterator[Frame], white_level: int) -> Iterator[Frame]:
    """Frames of a codec that codes each alone; one with blocks that depart from both its neighbours has no image.

    The background must be the same in the frames before and after, and the change must end at the edges of coded
    blocks, as no object does. Blocks that move are judged by their own history. Not recognised are damage to the first
    and the last frame, to two frames in succession, and to moving blocks alone.
    """
    head = _head(frames)
    background = _Background(
        TUNING.least * white_level, [frame.image for frame in head if frame.image is not None]
    )
    # The last image, to be judged by the next one, and frames without image after it.
    waiting: list[Frame] = []
    for frame in itertools.chain(head, frames):
        if frame.image is not None:
            if background.departed_before(frame.image):
                waiting[0] = Frame(None, waiting[0].pts)
            yield from waiting
            waiting = [frame]
        elif waiting:
            waiting.append(frame)
        else:
            yield frame
    yield from waiting


def _head(frames: Iterator[Frame]) -> list[Frame]:
    """Frames up to the first nine images, or up to as many without any."""
    head: list[Frame] = []
    for frame in frames:
        head.append(frame)
        if sum(f.image is not None for f in head) == TUNING.first or len(head) == TUNING.most_waiting:
            break
    return head


class _Background:
    """The last good image, the one after it, and the largest recent step of each block's mean."""

    def __init__(self, least: float, first: list[GrayImage]) -> None:
        self._least = least
        # With fewer images the usual steps are unknown, and nothing departs.
        self._largest: Means | None = None
        if len(first) == TUNING.first:
            means = np.stack([block_means(image) for image in first])
            self._largest = np.sort(np.abs(np.diff(means, axis=0)), axis=0)[-3]
        self._quiet = True
        self._good: tuple[GrayImage, Means] | None = None
        self._last: tuple[GrayImage, Means] | None = None

    def departed_before(self, image: GrayImage) -> bool:
        """Whether the image before this one departed from both its neighbours; this one is the last image then."""
        good, last, after = self._good, self._last, (image, block_means(image))
        self._last = after
        if good is None or last is None or self._largest is None:
            self._good = last
            return False
        limit = np.maximum(TUNING.factor * self._largest, self._least)
        step = np.abs(last[1] - good[1])
        departed = step > limit
        count = np.count_nonzero(departed)
        returned = np.count_nonzero(np.abs(after[1] - good[1])[departed] < limit[departed])
        if (
            self._quiet
            and TUNING.least_blocks <= count < TUNING.most_blocks * departed.size
            and returned > TUNING.returned * count
            and ends_at_blocks(departed, good[0], last[0])
        ):
            return True
        self._quiet = count == 0
        self._good = last
        self._largest = np.maximum(step, TUNING.memory * self._largest)
        return False


def block_means(image: GrayImage) -> Means:
    """Means of all complete blocks of an image, each over some of its rows."""
    import cv2  # noqa: PLC0415 - slow to load, and a run that is up to date decodes nothing

    rows, cols = (max(size // BLOCK_PX, 1) for size in image.shape)
    part = image[: rows * BLOCK_PX : SOURCE.row_step, : cols * BLOCK_PX]
    return np.asarray(cv2.resize(part, (cols, rows), interpolation=cv2.INTER_AREA), dtype=np.float32)


def ends_at_blocks(departed: BoolArray, before: GrayImage, image: GrayImage) -> bool:
    """Whether the change of an image ends at the edges of blocks, by the lines of pixels on both sides of these."""
    import cv2  # noqa: PLC0415 - as above

    rows, cols = departed.shape
    change = cv2.absdiff(before, image)[: rows * BLOCK_PX, : cols * BLOCK_PX].astype(np.float32)
    blocks = change.reshape(rows, BLOCK_PX, cols, BLOCK_PX)
    sides = []
    for lines, whole in (
        (blocks.mean(axis=3), departed),
        (blocks.mean(axis=1).transpose(1, 2, 0), departed.T),
    ):
        first, last = lines[1:, 0], lines[:-1, -1]
        for one, other, edge in (
            (first, last, whole[1:] & ~whole[:-1]),
            (last, first, whole[:-1] & ~whole[1:]),
        ):
            sides.append(np.stack([one[edge], other[edge]]))
    noise = float(np.median(change[::2, ::2]))
    within, beyond = np.median(np.concatenate(sides, axis=1), axis=1) - noise
    mean = float(np.mean(blocks.mean(axis=(1, 3))[departed])) - noise
    return bool(within > TUNING.within * mean and beyond < TUNING.beyond * within)

"""Edit lists of MP4 and MOV files: which of the coded frames players show."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import av
import av.error

from tracker.video.source import SourceInfo

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

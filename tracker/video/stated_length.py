"""The length that a container states, and whether its images end before it: then the file was cut."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import av

from tracker.video.base import SourceInfo

# Containers whose header states a length and no number of images. For most others FFmpeg takes the length from the
# images themselves, so that it tells nothing.
_STATING = "matroska,webm"
# Steps between images that may be missing at the end: the length of the last one is not always counted.
_MOST_STEPS = 1.5


class StatedLength:
    """Compares the length in a container's header with the time of the last image.

    Not where the file has other streams: sound may last longer than the images.
    """

    def __init__(self, container: Any, stream: Any) -> None:
        compared = container.format.name == _STATING and len(container.streams) == 1
        self._stated_s = (container.duration or 0) / av.time_base if compared else 0.0
        self._tick_s = float(stream.time_base or 0)
        self._count, self._first_s, self._last_s = 0, float("inf"), 0.0

    def see(self, packet: Any) -> None:
        """Register a coded image."""
        if packet.size and packet.pts is not None:
            time_s = self._tick_s * packet.pts
            self._count += 1
            self._first_s, self._last_s = min(self._first_s, time_s), max(self._last_s, time_s)

    def described(self, info: SourceInfo) -> SourceInfo:
        """Properties of a recording of which all packets were seen, with a note where its images end early."""
        if self._count < 2:
            return info
        step_s = (self._last_s - self._first_s) / (self._count - 1)
        missing_s = self._stated_s - (self._last_s + step_s)
        if missing_s <= _MOST_STEPS * step_s:
            return info
        note = (
            f"The file states a length of {self._stated_s:.4g} s, but its images end {missing_s:.3g} s before: it is "
            "incomplete; copy it again."
        )
        return replace(info, notes=(*info.notes, note))

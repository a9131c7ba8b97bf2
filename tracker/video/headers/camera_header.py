"""A Photron header in the folder of another recording: the recorded rate of a video, a TIFF or a folder of images."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from contextlib import suppress
from fractions import Fraction
from pathlib import Path
from typing import Protocol

from tracker.video.base import Frame, FrameSource, SourceInfo, UnreadableVideoError, shown
from tracker.video.headers.photron_header import PhotronHeader, read_photron_header

HEADER_SUFFIXES = (".cihx", ".cih")


def companion(path: Path, suffixes: tuple[str, ...]) -> Path | None:
    """Existing file of the same folder and stem as `path` with the first possible of `suffixes`.

    A link counts only where `path` itself is one: callers that ignore links then ignore it here as well.
    """
    for suffix in suffixes:
        for spelled in (suffix, suffix.upper()):
            candidate = path.with_suffix(spelled)
            # The name of a file may be so long that no other ending fits: then there is none.
            with suppress(OSError):
                if (
                    candidate != path
                    and candidate.is_file()
                    and (path.is_symlink() or not candidate.is_symlink())
                ):
                    return candidate
    return None


def with_companion(path: Path, suffixes: tuple[str, ...]) -> tuple[Path, ...]:
    """The path and its companion, if there is one."""
    found = companion(path, suffixes)
    return (path, found) if found else (path,)


class HeaderTimed:
    """A recording with the time axis of a Photron header."""

    def __init__(self, source: FrameSource, header: PhotronHeader) -> None:
        self.recording = source
        self._rate: Fraction = header.rate()
        self._step = header.step()
        self._notes = [f"The recorded rate is that of {shown(header.path)} in the same folder."]
        info = source.info
        size = (header.whole("width", info.width_px), header.whole("height", info.height_px))
        if size != (info.width_px, info.height_px):
            self._notes.append(
                f"{shown(header.path)} states images of {size[0]} x {size[1]} px, the recording has "
                f"{info.width_px} x {info.height_px} px: make sure that they belong together."
            )

    @property
    def info(self) -> SourceInfo:
        """Properties of the recording, with the camera's rate."""
        info = self.recording.info
        return dataclasses.replace(
            info,
            time_base=1 / self._rate,
            header_rate=self._rate,
            frame_step=self._step,
            notes=(*info.notes, *self._notes),
        )

    def frames(self) -> Iterator[Frame]:
        """Frames of the recording, counted in recorded frames."""
        for k, frame in enumerate(self.recording.frames()):
            yield Frame(frame.image, k * self._step)

    def stamps(self) -> list[int | None]:
        """Index of each frame in recorded frames."""
        return [k * self._step for k in range(len(self.recording.stamps()))]

    def close(self) -> None:
        """Release the file."""
        self.recording.close()


def without_header(source: FrameSource) -> FrameSource:
    """The source itself, with its own time stamps, where a header gives others."""
    return source.recording if isinstance(source, HeaderTimed) else source


class AnnotatableSource(FrameSource, Protocol):
    """A source whose `info` can be set, for a note on its header."""

    info: SourceInfo


def with_header(source: AnnotatableSource, header: Path | None) -> FrameSource:
    """The source with the rate of a camera header; an unusable header gives a note."""
    if header is None:
        return source
    try:
        return HeaderTimed(source, read_photron_header(header))
    except UnreadableVideoError as error:
        note = f"The camera header in the same folder was not used ({error})."
        source.info = dataclasses.replace(source.info, notes=(*source.info.notes, note))
        return source


def with_header_beside(source: AnnotatableSource, path: Path) -> FrameSource:
    """The source with the rate of a camera header of the same name, if there is one."""
    return with_header(source, companion(path, HEADER_SUFFIXES))

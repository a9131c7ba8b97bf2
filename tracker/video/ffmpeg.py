"""Recordings in containers (mp4, mov, avi, mkv, gif, cine ...), decoded by PyAV packet by packet.

FFV1 check sums are verified here: the decoder replaces a damaged slice by that of the image before, and says so in its
log only. A recording whose images end before the length that its container states was cut.
"""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import av.error

from tracker.arrays import GrayImage
from tracker.video.photron import HEADER_SUFFIXES, with_companion, with_header_beside
from tracker.video.source import (
    DECODER_OPTIONS,
    Frame,
    FrameSource,
    Reader,
    SourceInfo,
    check_image_size,
    check_regular_file,
    gray_depth,
    gray_image,
    read_head,
    unreadable,
)
from tracker.video.unused_frames import EditList, without_departures


@dataclass(frozen=True)
class Tuning:
    """Damage of containers and check sums."""

    #: [1] of a coded image
    #: convention: bounds the time that a damaged packet takes
    most_slices: int = 1024
    #: [1] between images that may be missing at the end
    #: convention: the length of the last one is not always counted
    most_steps: float = 1.5
    #: [packets] that show whether a stream has check sums
    #: convention: the first may be damaged
    probed_packets: int = 4


TUNING = Tuning()

# The check sum's polynomial is that of zlib, with the opposite order of the bits in a byte.
_REVERSED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))
_ALL_ONES = 0xFFFFFFFF
# Size of the slice before it (3 bytes), error status (1), check sum (4).
_FOOTER, _SIZE = 8, 3


def slices_are_intact(packet: bytes) -> bool:
    """Whether the packet consists of slices whose check sums agree (FFV1 versions 3 and 4 with ``ec``; RFC 9043, 4.9).

    False as well for a packet without check sums: see `has_check_sums`.
    """
    end = len(packet)
    for _ in range(TUNING.most_slices):
        start = end - _FOOTER - int.from_bytes(packet[end - _FOOTER : end - _FOOTER + _SIZE], "big")
        if end < _FOOTER or start < 0:
            return False
        if zlib.crc32(packet[start:end].translate(_REVERSED), _ALL_ONES) != _ALL_ONES:
            return False
        if start == 0:
            return True
        end = start
    return False


def has_check_sums(packets: Iterable[bytes]) -> bool:
    """Whether a stream has check sums, from some of its packets: by chance they agree in one packet of 4e9."""
    return any(slices_are_intact(packet) for packet in packets)


# Containers whose header states a length and no number of images. For most others FFmpeg takes the length from the
# images themselves, so that it tells nothing.
_STATING = "matroska,webm"


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
        if missing_s <= TUNING.most_steps * step_s:
            return info
        note = (
            f"The file states a length of {self._stated_s:.4g} s, but its images end {missing_s:.3g} s before: it is "
            "incomplete; copy it again."
        )
        return replace(info, notes=(*info.notes, note))


FORMATS = (
    "mov,mp4,m4a,3gp,3g2,mj2,avi,matroska,webm,gif,cine,mpeg,mpegts,flv,asf,ogg,dv,mxf,nut,y4m,yuv4mpegpipe,"
    "h264,hevc"
)
CONTAINER_OPTIONS = {"protocol_whitelist": "file", "format_whitelist": FORMATS}
# Streams without a container, as written by small cameras: no time stamps, and a rate invented by FFmpeg.
BARE_STREAMS = frozenset({"h264", "hevc"})
# In practice intra-only, although FFmpeg does not declare them so because exceptions are possible.
INTRA_BY_HABIT = frozenset({"ffv1", "png", "apng", "gif", "huffyuv", "ffvhuff", "utvideo"})


class VideoSource:
    """A video file as a `tracker.video.source.FrameSource`.

    Packets are decoded one by one, so that a damaged one yields a frame without image in its place and no later frame
    shifts. With predictive codecs, the frames after a damaged one have no image until the next key frame.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._container = _open_container(path)
        try:
            self._stream, notes = _first_video_stream(self._container, path)
            self.info = _source_info(path, self._container, self._stream, notes)
            check_image_size(path, self.info.width_px, self.info.height_px)
        except BaseException:
            self._container.close()
            raise
        context = self._stream.codec_context
        context.options = DECODER_OPTIONS
        # Frame threads would report an error at a later packet than the damaged one, and FFmpeg discards the errors of
        # slices that several threads decode; those of FFV1 have check sums.
        context.thread_type = "SLICE"
        context.thread_count = 1 if self.info.predictive else 0
        self.frames_decoded = 0
        self.frames_corrupt = 0
        # Errors so far, those that a key frame has ended, and those before each packet whose frame is still awaited.
        self._errors = self._ended = 0
        self._awaited: dict[int, int] = {}
        self._given_up: set[int] = set()
        # Of an image of another size than the others, where the next one may show whether it is damaged.
        self._odd_size: tuple[int, int] | None = None
        self._length = StatedLength(self._container, self._stream)
        self._latest_pts: int | None = None
        self._has_check_sums = self.info.codec == "ffv1" and has_check_sums(_first_packets(path))

    def close(self) -> None:
        """Release the file."""
        self._container.close()

    def stamps(self) -> list[int | None]:
        """Presentation times of all frames that players show, without decoding; instead of `frames`."""
        edits = EditList(self._path, self._container, self._stream, CONTAINER_OPTIONS)
        stamps = [packet.pts for packet in self._packets() if packet.size > 0 and edits.see(packet)]
        self.info = self._length.described(edits.described(self.info))
        return stamps

    def frame_at(self, pts: int) -> GrayImage | None:
        """The frame with one of the `stamps`, decoded from the key frame before it; None if it is damaged or not found.

        May be called repeatedly, but neither before nor after `frames` or `stamps` of the same source.
        """
        # A seek goes by decoding times: it may end at the key frame after the frame.
        second = round(1 / (self._stream.time_base or 1))
        for position in (pts, pts - second, pts - 10 * second, min(self._stream.start_time or 0, 0)):
            with contextlib.suppress(av.error.FFmpegError):
                self._container.seek(position, stream=self._stream, backward=True)
                self._stream.codec_context.flush_buffers()
                first = next(
                    (f for f in self._images_from_here() if f.pts is not None and f.pts >= pts), None
                )
                if first is not None and first.pts == pts:
                    return None if first.is_corrupt else gray_image(first)
        return None

    def _images_from_here(self) -> Iterator[Any]:
        for packet in self._packets():
            with contextlib.suppress(av.error.FFmpegError):
                yield from packet.decode()

    def frames(self) -> Iterator[Frame]:
        """All frames that players show, damaged ones as `Frame(None, pts)`; once only."""
        alone = not (self.info.predictive or self._has_check_sums or self.info.codec == "rawvideo")
        return without_departures(self._decoded(), self.info.white_level) if alone else self._decoded()

    def _decoded(self) -> Iterator[Frame]:
        edits = EditList(self._path, self._container, self._stream, CONTAINER_OPTIONS)
        for packet in self._packets():
            edits.see(packet)
            yield from (frame for frame in self._decode(packet) if edits.shows(frame.pts))
        self._container.close()
        self.info = self._length.described(edits.described(self.info))
        yield from (self._damaged(pts) for pts in sorted(self._awaited) if edits.shows(pts))

    def _packets(self) -> Iterator[Any]:
        """Coded frames up to the end, or to where the file is incomplete or damaged: earlier ones are valid."""
        with contextlib.suppress(av.error.FFmpegError):
            for packet in self._container.demux(self._stream):
                self._length.see(packet)
                self._see_order(packet)
                yield packet

    def _see_order(self, packet: Any) -> None:
        if packet.size > 0 and packet.pts is not None:
            if self._latest_pts is not None and packet.pts < self._latest_pts and not self.info.reordered:
                self.info = dataclasses.replace(self.info, reordered=True)
            self._latest_pts = packet.pts

    def _decode(self, packet: Any) -> Iterator[Frame]:
        is_data = packet.size > 0
        if is_data and packet.pts is not None:
            self._awaited[packet.pts] = self._errors
        try:
            if is_data and self._has_check_sums and not slices_are_intact(bytes(packet)):
                yield self._without_image(packet, others_depend=True)
                return
            images = packet.decode()
        except av.error.FFmpegError:
            if is_data:
                yield self._without_image(packet, others_depend=not self._intra_only)
            return
        for decoded in images:
            # A decoder may still show what it has of a frame whose packet was an error.
            if decoded.pts in self._given_up:
                continue
            yield self._frame(decoded, packet_corrupt=bool(packet.is_corrupt) and self._intra_only)

    def _without_image(self, packet: Any, *, others_depend: bool) -> Frame:
        self._errors += others_depend
        if packet.pts is not None:
            self._awaited.pop(packet.pts, None)
            self._given_up.add(packet.pts)
        return self._damaged(packet.pts)

    def _frame(self, decoded: Any, *, packet_corrupt: bool) -> Frame:
        # Frames of packets before the damaged one may leave the decoder after it, a key frame among them.
        errors = self._awaited.pop(decoded.pts, self._errors)
        damaged = bool(decoded.is_corrupt) or packet_corrupt
        if damaged and not self._intra_only:
            self._errors += 1
            self._awaited = dict.fromkeys(self._awaited, self._errors)
        elif decoded.key_frame and not damaged:
            self._ended = max(self._ended, errors)
        if damaged or errors > self._ended:
            return self._damaged(decoded.pts)
        if self._is_of_odd_size(decoded):
            return self._damaged(decoded.pts)
        if self.frames_decoded == 0:
            self._note_geometry(decoded)
        self.frames_decoded += 1
        return Frame(gray_image(decoded), decoded.pts)

    def _is_of_odd_size(self, decoded: Any) -> bool:
        """Whether an image alone has another size: a damaged one may state any, a change lasts.

        UnreadableVideoError where the size changes.
        """
        size, before = (decoded.width, decoded.height), self._odd_size
        whole = (self.info.width_px, self.info.height_px)
        self._odd_size = None if size == whole else size
        if size == whole or (self._intra_only and size != before):
            return size != whole
        at = self.frames_decoded + self.frames_corrupt - (before == size)
        raise unreadable(
            self._path,
            f"the image changes from {whole[0]} x {whole[1]} to {size[0]} x {size[1]} px at frame {at}; "
            "split the file there",
        )

    def _damaged(self, pts: int | None) -> Frame:
        self.frames_corrupt += 1
        return Frame(None, pts)

    @property
    def _intra_only(self) -> bool:
        return not self.info.predictive

    def _note_geometry(self, decoded: Any) -> None:
        notes = list(self.info.notes)
        if decoded.rotation:
            notes.append(
                f"The file asks players to rotate the image by {decoded.rotation} degrees; positions refer to the "
                "stored image, x along its rows."
            )
        if decoded.interlaced_frame:
            notes.append("The footage is interlaced: odd and even rows were exposed at different times.")
        aspect = self._stream.sample_aspect_ratio
        if aspect and aspect != 1:
            notes.append(
                f"The file states pixels of aspect {aspect}; they are assumed square, as on the sensor."
            )
        self.info = dataclasses.replace(self.info, notes=tuple(notes))


def _open_container(path: Path) -> Any:
    """Open by absolute path: regular files only, no other protocols, no playlists."""
    check_regular_file(path)
    head = read_head(path)
    kind = looks_like(head)
    if kind is not None:
        raise unreadable(path, f"not a video (looks like {kind})")
    # With the edit list, frames that others depend on are left out and times are those of playback; see `EditList`.
    options = {**CONTAINER_OPTIONS, "ignore_editlist": "1"}
    try:
        return av.open(str(path.absolute()), mode="r", container_options=options)
    except (av.error.FFmpegError, ValueError, OSError) as error:
        reason = "not a video (looks like no readable format, or is damaged at its start)"
        if head[4:8] == b"ftyp":
            reason = (
                "the recording ended before its index was written; recover it with untrunc or ffmpeg, or record to "
                "AVI or MKV"
            )
        raise unreadable(path, reason) from error


def _first_packets(path: Path) -> Iterator[bytes]:
    """Data of the first packets of the first video stream."""
    with _open_container(path) as container:
        stream, _ = _first_video_stream(container, path)
        with contextlib.suppress(av.error.FFmpegError):
            yield from (
                bytes(p) for p in itertools.islice(container.demux(stream), TUNING.probed_packets) if p.size
            )


def _first_video_stream(container: Any, path: Path) -> tuple[Any, list[str]]:
    attached = av.stream.Disposition.attached_pic
    streams = [s for s in container.streams.video if not s.disposition & attached]
    if not streams:
        raise unreadable(path, "not a video (looks like a file without a video stream, such as sound only)")
    notes = [f"The file has {len(streams)} video streams; the first is used."] if len(streams) > 1 else []
    return streams[0], notes


def _source_info(path: Path, container: Any, stream: Any, notes: list[str]) -> SourceInfo:
    context = stream.codec_context
    if context is None or context.format is None:
        name = "unknown" if context is None else context.name
        raise unreadable(
            path, f"the codec {name!r} cannot be decoded; the file is damaged, or export it as H.264 or MJPG"
        )
    depth = gray_depth(context.format)
    is_cine = container.format.name == "cine"
    rate = stream.average_rate or stream.guessed_rate or stream.base_rate
    rate = Fraction(rate) if rate else None
    return SourceInfo(
        codec=context.name,
        pixel_format=context.format.name,
        width_px=int(context.width),
        height_px=int(context.height),
        bit_depth=depth,
        white_level=(1 << depth) - 1,
        frames_declared=max(int(stream.frames), 0),
        lossy=bool(context.codec.lossy),
        predictive=not (context.codec.intra_only or context.codec.name in INTRA_BY_HABIT),
        time_base=Fraction(stream.time_base) if stream.time_base else None,
        container_rate=None if container.format.name in BARE_STREAMS else rate,
        header_rate=rate if is_cine else None,
        notes=tuple(notes),
    )


# File types that are not videos, and their leading bytes.
NOT_VIDEO: dict[str, tuple[bytes, ...]] = {
    "a JPEG image": (b"\xff\xd8\xff",),
    "a PNG image": (b"\x89PNG\r\n",),
    "a TIFF image": (b"II*\x00", b"MM\x00*"),
    "a zip archive": (b"PK\x03\x04",),
    "a gzip archive": (b"\x1f\x8b",),
    "a 7z archive": (b"7z\xbc\xaf",),
    "a RAR archive": (b"Rar!",),
    "a PDF document": (b"%PDF",),
    "a NumPy array": (b"\x93NUMPY",),
    "an HDF5 file": (b"\x89HDF\r\n",),
    "a playlist of other files": (b"ffconcat", b"#EXTM3U"),
    "an XML document": (b"<?xml",),
    "a program": (b"\x7fELF", b"MZ"),
}


def looks_like(head: bytes) -> str | None:
    """Name of a file type other than video, or None when `head` may be the start of a video.

    A file that starts with printable ASCII and white space only is text.
    """
    if not head:
        return "an empty file"
    for name, magics in NOT_VIDEO.items():
        if head.startswith(magics):
            return name
    is_text = all(byte in b"\t\n\r\f" or 32 <= byte < 127 for byte in head)
    return "a text file" if is_text else None


class FfmpegReader(Reader):
    """Videos of any container and codec that FFmpeg decodes; the reader of files that no other one recognises."""

    name = "ffmpeg"
    suffixes = (
        ".avi",
        ".cine",
        ".gif",
        ".h264",
        ".h265",
        ".m4v",
        ".mkv",
        ".mov",
        ".mp4",
        ".mpg",
        ".webm",
        ".wmv",
    )

    def recognises(self, path: Path, head: bytes) -> bool:  # noqa: ARG002 - the last resort
        """Any file."""
        return not path.is_dir()

    def open(self, path: Path) -> FrameSource:
        """Open a video, with the rate of a camera header in the same folder."""
        return with_header_beside(VideoSource(path), path)

    def files(self, path: Path) -> tuple[Path, ...]:
        """The video and a camera header in the same folder."""
        return with_companion(path, HEADER_SUFFIXES)


FFMPEG = FfmpegReader()

"""Recordings in containers (mp4, mov, avi, mkv, gif, cine ...) through PyAV, packet by packet."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import av.error

from tracker.arrays import GrayImage
from tracker.video.base import (
    MAX_PIXELS,
    Frame,
    SourceInfo,
    UnreadableVideoError,
    check_picture_size,
    check_regular_file,
    read_head,
    shown,
)
from tracker.video.gray import gray_depth, gray_image

FORMATS = (
    "mov,mp4,m4a,3gp,3g2,mj2,avi,matroska,webm,gif,cine,mpeg,mpegts,flv,asf,ogg,dv,mxf,nut,y4m,yuv4mpegpipe,"
    "h264,hevc"
)
# Streams of pictures without a container, as small cameras write them: no time stamps, and a rate that FFmpeg makes up.
BARE_STREAMS = frozenset({"h264", "hevc"})
# FFmpeg does not call these intra-only because they could be otherwise; as files have them, they are.
INTRA_BY_HABIT = frozenset({"ffv1", "png", "apng", "gif", "huffyuv", "ffvhuff", "utvideo"})


class VideoSource:
    """A video file as a `tracker.video.base.FrameSource`.

    Decoding goes packet by packet, so that a damaged one gives a frame without picture in its place and
    nothing after it shifts. In codecs that predict frames from others, the frames after a damaged one are
    given without picture until the next key frame.

    Raises
    ------
    UnreadableVideoError
        If the file is not a regular file, not a video, has no picture stream or too large a picture.
    """

    def __init__(self, path: Path, *, max_pixels: int = MAX_PIXELS) -> None:
        self._path = path
        self._container = _open_container(path)
        try:
            self._stream, notes = _first_video_stream(self._container, path)
            self.info = _source_info(path, self._container, self._stream, notes)
            check_picture_size(path, self.info.width_px, self.info.height_px, max_pixels)
        except BaseException:
            self._container.close()
            raise
        context = self._stream.codec_context
        context.options = {"max_pixels": str(max_pixels)}
        # Frame threads would report an error at a later packet than the one that is damaged.
        context.thread_type = "SLICE"
        self.frames_decoded = 0
        self.frames_corrupt = 0
        self._awaited: dict[int, None] = {}
        self._wait_for_key = False

    def close(self) -> None:
        """Release the file."""
        self._container.close()

    def stamps(self) -> list[int | None]:
        """Presentation times of all coded pictures, without decoding; in place of `frames`."""
        stamps: list[int | None] = []
        try:
            stamps.extend(p.pts for p in self._container.demux(self._stream) if p.size > 0)
        except av.error.FFmpegError:
            return stamps  # the container is cut or damaged here; what came before stands
        return stamps

    def frames(self) -> Iterator[Frame]:
        """All frames, damaged ones as `Frame(None, pts)`; once only."""
        packets = self._container.demux(self._stream)
        while True:
            try:
                packet = next(packets)
            except StopIteration:
                break
            except av.error.FFmpegError:
                break  # the container is cut or damaged here; what came before stands
            yield from self._decode(packet)
        self._container.close()
        for pts in sorted(self._awaited):
            yield self._damaged(pts)

    def _decode(self, packet: Any) -> Iterator[Frame]:
        is_data = packet.size > 0
        if is_data and packet.pts is not None:
            self._awaited[packet.pts] = None
        try:
            pictures = packet.decode()
        except av.error.FFmpegError:
            if is_data:
                self._wait_for_key = not self._intra_only
                if packet.pts is not None:
                    self._awaited.pop(packet.pts, None)
                yield self._damaged(packet.pts)
            return
        for picture in pictures:
            yield self._frame(picture, packet_corrupt=bool(packet.is_corrupt) and self._intra_only)

    def _frame(self, picture: Any, *, packet_corrupt: bool) -> Frame:
        if picture.pts is not None:
            self._awaited.pop(picture.pts, None)
        damaged = bool(picture.is_corrupt) or packet_corrupt
        if self._wait_for_key and picture.key_frame and not damaged:
            self._wait_for_key = False
        if damaged and not self._intra_only:
            self._wait_for_key = True
        if damaged or self._wait_for_key:
            return self._damaged(picture.pts)
        if (picture.width, picture.height) != (self.info.width_px, self.info.height_px):
            msg = (
                f"{shown(self._path)}: the picture changes from {self.info.width_px} x {self.info.height_px} "
                f"to {picture.width} x {picture.height} px at frame {self.frames_decoded + self.frames_corrupt}; "
                "split the file there"
            )
            raise UnreadableVideoError(msg)
        if self.frames_decoded == 0:
            self._note_geometry(picture)
        image: GrayImage = gray_image(picture)
        self.frames_decoded += 1
        return Frame(image, picture.pts)

    def _damaged(self, pts: int | None) -> Frame:
        self.frames_corrupt += 1
        return Frame(None, pts)

    @property
    def _intra_only(self) -> bool:
        return not self.info.predictive

    def _note_geometry(self, picture: Any) -> None:
        notes = list(self.info.notes)
        if picture.rotation:
            notes.append(
                f"The file asks players to turn the picture by {picture.rotation} degrees; positions are those "
                "of the stored picture, x along its rows."
            )
        if picture.interlaced_frame:
            notes.append("The footage is interlaced: odd and even rows were seen at different times.")
        aspect = self._stream.sample_aspect_ratio
        if aspect and aspect != 1:
            notes.append(
                f"The file claims pixels of aspect {aspect}; they are taken as square, as the sensor's are."
            )
        self.info = dataclasses.replace(self.info, notes=tuple(notes))


def _open_container(path: Path) -> Any:
    """Open by absolute path, regular files only, nothing but files, no playlists."""
    check_regular_file(path)
    head = read_head(path, 512)
    kind = looks_like(head)
    if kind is not None:
        msg = f"{shown(path)}: not a video (looks like {kind})"
        raise UnreadableVideoError(msg)
    # Edit lists hide frames from players, or slow them down; what the camera recorded is what counts.
    options = {"protocol_whitelist": "file", "format_whitelist": FORMATS, "ignore_editlist": "1"}
    try:
        return av.open(str(path.absolute()), mode="r", container_options=options)
    except (av.error.FFmpegError, ValueError, OSError) as error:
        raise UnreadableVideoError(_why_not_opened(path, head)) from error


def _why_not_opened(path: Path, head: bytes) -> str:
    if head[4:8] == b"ftyp":
        return (
            f"{shown(path)}: the recording was cut off before its index was written; "
            "recover it with untrunc or ffmpeg, or record to AVI or MKV"
        )
    return f"{shown(path)}: not a video (looks like no format that can be read, or is damaged at its start)"


def _first_video_stream(container: Any, path: Path) -> tuple[Any, list[str]]:
    attached = av.stream.Disposition.attached_pic
    streams = [s for s in container.streams.video if not s.disposition & attached]
    if not streams:
        msg = f"{shown(path)}: not a video (looks like a file without moving pictures, such as sound only)"
        raise UnreadableVideoError(msg)
    notes = []
    if len(streams) > 1:
        notes.append(f"The file has {len(streams)} video streams; the first is used.")
    return streams[0], notes


def _source_info(path: Path, container: Any, stream: Any, notes: list[str]) -> SourceInfo:
    context = stream.codec_context
    if context is None or context.format is None:
        name = "unknown" if context is None else context.name
        msg = f"{shown(path)}: the codec {name!r} cannot be decoded; the file is damaged, or export it as H.264 or MJPG"
        raise UnreadableVideoError(msg)
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


# Leading bytes, and what such a file is; none of these is a recording.
NOT_VIDEO: tuple[tuple[bytes, str], ...] = (
    (b"\xff\xd8\xff", "a JPEG picture"),
    (b"\x89PNG\r\n", "a PNG picture"),
    (b"II*\x00", "a TIFF picture"),
    (b"MM\x00*", "a TIFF picture"),
    (b"PK\x03\x04", "a zip archive"),
    (b"\x1f\x8b", "a gzip archive"),
    (b"7z\xbc\xaf", "a 7z archive"),
    (b"Rar!", "a RAR archive"),
    (b"%PDF", "a PDF document"),
    (b"\x93NUMPY", "a NumPy array"),
    (b"\x89HDF\r\n", "an HDF5 file"),
    (b"ffconcat", "a playlist of other files"),
    (b"#EXTM3U", "a playlist of other files"),
    (b"<?xml", "an XML document"),
    (b"\x7fELF", "a program"),
    (b"MZ", "a program"),
)


def looks_like(head: bytes) -> str | None:
    """Name of a kind of file that is no video, or None when `head` may begin one.

    Text is recognised by its bytes: printable ASCII and white space only (at least 16 bytes of it).
    """
    if not head:
        return "an empty file"
    for magic, name in NOT_VIDEO:
        if head.startswith(magic):
            return name
    printable = sum(byte in b"\t\n\r\f" or 32 <= byte < 127 for byte in head)
    if printable == len(head):
        return "a text file"
    return None

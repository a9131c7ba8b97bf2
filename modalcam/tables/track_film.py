"""A recording with its tracks drawn in, from a second pass over the file."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from modalcam.common import InputError, real, shown
from modalcam.pipeline import replacing
from tracker import GrayImage, MarkerTracks, flags
from tracker.video import UnreadableVideoError, open_recording, to_8_bit

SUFFIXES = (".mp4", ".mkv", ".mov", ".gif")
PLAYBACK_FPS = Fraction(30)
LARGEST_PLAYBACK_FPS = 60
# Small images are enlarged to about this width or height, so that names do not cover the markers.
LEAST_SIDE_PX = 480
# Blue, green, red.
GOOD, POOR, DARK = (74, 210, 255), (60, 60, 255), (0, 0, 0)
_BAD = flags.POOR_FIT.value | flags.EDGE.value | flags.SATURATED.value | flags.RECOVERED.value
# Fractional bits of OpenCV's drawing coordinates.
_SHIFT = 4


def check_preview(preview: Path, recording: Path, out: Path) -> None:
    """Check path and name of the preview before tracking starts; within the output folder any path is allowed."""
    if not recording.is_file():
        msg = f"--preview shows one recording: give a file instead of the folder {shown(str(recording))}"
        raise InputError(msg)
    check_suffix(preview, "--preview")
    folder, recordings = real(preview).parent, real(recording).parent
    among = folder.is_relative_to(recordings) and not folder.is_relative_to(real(out))
    if among or folder == recordings:
        msg = f"{shown(str(preview))}: results are never written among the recordings; give another folder"
        raise InputError(msg)


def check_suffix(path: Path, option: str) -> None:
    """Check that a film can be written under this name."""
    if path.suffix.lower() not in SUFFIXES:
        msg = f"{option}: expected a name ending in {', '.join(SUFFIXES)}; found {shown(str(path))}"
        raise InputError(msg)


def write_preview(preview: Path, recording: Path, tracks: MarkerTracks) -> int:
    """Write the recording with the positions of each frame drawn in; returns the number of frames.

    Circles are yellow, or red if a flag marks the fit as doubtful; a missing marker has none.
    """
    rate = tracks.time_axis.fps_container
    if rate is None or not 1 <= rate <= LARGEST_PLAYBACK_FPS:
        rate = PLAYBACK_FPS
    try:
        source = open_recording(recording)
    except UnreadableVideoError as error:
        msg = f"{shown(str(recording))}: {error}"
        raise InputError(msg) from error
    with closing(source), replacing(preview) as temporary:
        images = (frame.image for frame in source.frames() if frame.image is not None)
        return encode(temporary, _drawn(images, tracks), rate)


def _drawn(images: Iterator[GrayImage], tracks: MarkerTracks) -> Iterator[NDArray[np.uint8]]:
    """An image for each row of the tracks; a damaged frame is gray."""
    corrupt = np.all(tracks.flags & flags.DECODE_CORRUPT.value > 0, axis=1)
    height, width = tracks.decode.height_px, tracks.decode.width_px
    for row in range(tracks.time_s.size):
        gray = None if corrupt[row] else next(images, None)
        image = np.full((height, width), 128, np.uint8) if gray is None else to_8_bit(gray)
        yield annotate(image, tracks, row)


def annotate(image: NDArray[np.uint8], tracks: MarkerTracks, row: int) -> NDArray[np.uint8]:
    """Frame `row` of the tracks in colour, enlarged if it is small; shape (height, width, 3), both even."""
    height, width = image.shape
    zoom = max(1, -(-LEAST_SIDE_PX // max(height, width)))
    size = (width * zoom, height * zoom)
    large = cv2.resize(image, size, interpolation=cv2.INTER_NEAREST)
    # Codecs with subsampled colour planes need even sides.
    large = np.pad(large, ((0, size[1] % 2), (0, size[0] % 2)), mode="edge")
    canvas = np.asarray(cv2.cvtColor(large, cv2.COLOR_GRAY2BGR), dtype=np.uint8)
    for k, name in enumerate(tracks.markers):
        x, y = tracks.x_px[row, k], tracks.y_px[row, k]
        if not (np.isfinite(x) and np.isfinite(y)):
            continue
        colour = POOR if int(tracks.flags[row, k]) & _BAD else GOOD
        _mark(canvas, (x + 0.5) * zoom - 0.5, (y + 0.5) * zoom - 0.5, name, colour)
    write_label(canvas, f"{tracks.time_s[row]:.4f} s  {row}")
    return canvas


def write_label(canvas: NDArray[np.uint8], text: str) -> None:
    """Write a text into the upper left corner of an image in colour."""
    _write(canvas, text, (6, 16), GOOD)


def _mark(canvas: NDArray[np.uint8], x: float, y: float, name: str, colour: tuple[int, int, int]) -> None:
    centre = (round(x * 2**_SHIFT), round(y * 2**_SHIFT))
    for stroke, thickness in ((DARK, 3), (colour, 1)):
        cv2.circle(canvas, centre, 7 << _SHIFT, stroke, thickness, cv2.LINE_AA, _SHIFT)
    arm = 3 << _SHIFT
    for dx, dy in ((arm, 0), (0, arm)):
        ends = (centre[0] - dx, centre[1] - dy), (centre[0] + dx, centre[1] + dy)
        cv2.line(canvas, *ends, colour, 1, cv2.LINE_AA, _SHIFT)
    _write(canvas, name, (round(x) + 11, round(y) + 4), colour)


def _write(
    canvas: NDArray[np.uint8], text: str, position: tuple[int, int], colour: tuple[int, int, int]
) -> None:
    # OpenCV's fonts have ASCII only; other characters become question marks.
    plain = shown(text).encode("ascii", "replace").decode("ascii")
    for stroke, thickness in ((DARK, 3), (colour, 1)):
        cv2.putText(canvas, plain, position, cv2.FONT_HERSHEY_SIMPLEX, 0.42, stroke, thickness, cv2.LINE_AA)


def encode(path: Path, images: Iterator[NDArray[np.uint8]], rate: Fraction) -> int:
    """Encode as H.264 in one thread and without time stamps, so that the bytes are reproducible; a GIF is gray."""
    is_gif, count = path.suffix.lower() == ".gif", 0
    with av.open(str(path), mode="w", options={"fflags": "+bitexact"}) as container:
        options = {"flags": "+bitexact", "crf": "20", "preset": "veryfast", "x264-params": "mbtree=0"}
        options = {"flags": "+bitexact"} if is_gif else options
        stream = container.add_stream("gif" if is_gif else "libx264", rate=rate, options=options)
        stream.codec_context.thread_count = 1
        # The encoder of GIF has one palette for all colours: of grays, all are kept.
        stream.pix_fmt = "gray" if is_gif else "yuv420p"
        for image in images:
            if count == 0:
                stream.height, stream.width = image.shape[:2]
            frame = av.VideoFrame.from_ndarray(image, format="bgr24")
            frame.pts, frame.time_base = count, 1 / rate
            container.mux(stream.encode(frame))
            count += 1
        container.mux(stream.encode(None))
    return count

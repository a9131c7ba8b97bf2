"""Video files with reproducible bytes."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import Any, Literal, get_args

import av
import numpy as np
from numpy.typing import NDArray

Codec = Literal["mjpeg", "ffv1", "libx264"]
# of the containers that hold all of them
SUFFIXES = (".avi", ".mkv", ".mp4", ".mov")

# FFmpeg's FF_QP2LAMBDA: its global quality is the quality scale times this.
_LAMBDA_PER_QSCALE = 118
# chroma planes have half as many rows and columns
_SIDE_MULTIPLE = {"mjpeg": 2, "ffv1": 1, "libx264": 2}


def write_video(
    path: Path,
    frames: Iterable[NDArray[Any]],
    *,
    fps_container: Fraction,
    codec: Codec = "mjpeg",
    quality: int = 2,
    crf: int = 18,
) -> int:
    """Write gray frames to a video file, in one thread and without time or version stamps, so that its bytes repeat.

    Parameters
    ----------
    path : Path
        The suffix selects the container (.avi, .mkv, .mp4). Overwritten if it exists.
    frames : iterable of array, shape (height, width)
        uint8, or uint16 of any depth up to 16 bit with "ffv1" (stored as 16 bit, values unchanged), which is lossless.
        "mjpeg" and "libx264" need even sides.
    fps_container : Fraction
        Playback rate declared in the file; high-speed cameras usually write 25 or 30.
    quality, crf : int
        Quality scale of "mjpeg", 2 (best) to 31, and constant rate factor of "libx264", 0 (best) to 51.

    Returns
    -------
    int
        Number of frames written.

    Raises
    ------
    ValueError
        If there is no frame, a frame differs in shape or type from the first, or codec and frames do not match.
    """
    if codec not in get_args(Codec):
        msg = f"codec must be one of {', '.join(get_args(Codec))}, got {codec!r}"
        raise ValueError(msg)
    iterator = iter(frames)
    first = next(iterator, None)
    if first is None:
        msg = f"{path.name}: no frames to write"
        raise ValueError(msg)
    _check_first(first, codec)
    with av.open(str(path), mode="w", options={"fflags": "+bitexact"}) as container:
        stream = container.add_stream(codec, rate=fps_container, options=_options(codec, quality, crf))
        stream.height, stream.width = first.shape
        stream.pix_fmt = _pixel_format(codec, first)
        stream.codec_context.thread_count = 1
        count = 0
        for image in chain([first], iterator):
            if image.shape != first.shape or image.dtype != first.dtype:
                msg = (
                    f"{path.name}: frame {count} is {image.shape} {image.dtype}, the first was "
                    f"{first.shape} {first.dtype}"
                )
                raise ValueError(msg)
            frame = _to_frame(image, stream.pix_fmt)
            frame.pts = count
            frame.time_base = 1 / fps_container
            container.mux(stream.encode(frame))
            count += 1
        container.mux(stream.encode(None))
    return count


def _check_first(frame: NDArray[Any], codec: Codec) -> None:
    if frame.ndim != 2 or frame.dtype not in (np.uint8, np.uint16):
        msg = f"frames must be gray (height, width) of uint8 or uint16, got {frame.shape} {frame.dtype}"
        raise ValueError(msg)
    if codec != "ffv1" and frame.dtype != np.uint8:
        msg = f"{codec} stores 8 bit only; write 16 bit frames with ffv1"
        raise ValueError(msg)
    multiple = _SIDE_MULTIPLE[codec]
    if frame.shape[0] % multiple or frame.shape[1] % multiple:
        msg = f"{codec} needs sides that are multiples of {multiple}, got {frame.shape[1]} x {frame.shape[0]} px"
        raise ValueError(msg)


def _pixel_format(codec: Codec, frame: NDArray[Any]) -> str:
    if codec == "ffv1":
        return "gray" if frame.dtype == np.uint8 else "gray16le"
    # full range: counts are stored unchanged in the luma plane
    return "yuvj420p"


def _options(codec: Codec, quality: int, crf: int) -> dict[str, str]:
    if codec == "mjpeg":
        return {
            "flags": "+bitexact+qscale",
            "global_quality": str(quality * _LAMBDA_PER_QSCALE),
            "qmin": str(quality),
            "qmax": str(quality),
        }
    if codec == "libx264":
        # x264's macroblock tree reads uninitialised memory for frames narrower than 128 px, and the bytes then vary
        return {"flags": "+bitexact", "crf": str(crf), "x264-params": "mbtree=0"}
    return {"flags": "+bitexact", "level": "3", "slicecrc": "1"}


def _to_frame(image: NDArray[Any], pixel_format: str) -> av.VideoFrame:
    if pixel_format != "yuvj420p":
        return av.VideoFrame.from_ndarray(image, format=pixel_format)
    height, width = image.shape
    planes = np.full((height * 3 // 2, width), 128, dtype=np.uint8)
    planes[:height] = image
    return av.VideoFrame.from_ndarray(planes, format="yuvj420p")

"""The gray picture of a decoded frame, at its full depth."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracker.arrays import GrayImage

# Rec. 601 luma in 1/256, so that gray content of 8 bit becomes exactly 256 times its value in 16 bit.
LUMA_256 = np.array([77, 150, 29], dtype=np.uint32)


def has_gray_plane(pixel_format: Any) -> bool:
    """Whether the first plane is the gray picture: gray and planar or semi-planar YUV formats."""
    name = pixel_format.name
    return bool(name.startswith(("gray", "yuv", "yuvj", "nv", "p01", "ya")) and not _is_packed(name))


def _is_packed(name: str) -> bool:
    return name.startswith(("yuyv", "uyvy", "yvyu", "ya8", "ya16", "grayf"))


def gray_depth(pixel_format: Any) -> int:
    """Bits of the gray picture that `gray_image` gives for this format."""
    if has_gray_plane(pixel_format):
        return int(pixel_format.components[0].bits)
    return 16


def luma_16(rgb: NDArray[np.generic], *, deep: bool) -> GrayImage:
    """Rec. 601 luma in 16 bit; from shape (height, width, 3) of 8 bit, or of 16 where `deep`, to (height, width)."""
    luma = rgb.astype(np.uint32) @ LUMA_256
    return np.asarray(luma >> 8 if deep else luma, dtype=np.uint16)


def gray_image(frame: Any) -> GrayImage:
    """Gray picture of a PyAV frame, copied out of the decoder's buffer; shape (height, width).

    The luma plane is taken as it is, without change of range: gain and offset of the picture are fitted
    anyway. RGB and palette formats are weighted by Rec. 601 into 16 bit without rounding.
    """
    if not has_gray_plane(frame.format):
        deep = any(component.bits > 8 for component in frame.format.components)
        return luma_16(frame.to_ndarray(format="rgb48le" if deep else "rgb24"), deep=deep)
    deep = gray_depth(frame.format) > 8
    if frame.planes[0].line_size < 0:
        # A bottom-up buffer: its pointer is the last line's. swscale writes it out top-down.
        frame = frame.reformat(format="gray16be" if deep else "yuv444p")
    plane = frame.planes[0]
    big_endian = frame.format.name.endswith("be")
    dtype = np.dtype(">u2" if big_endian else "<u2") if deep else np.dtype(np.uint8)
    stride = plane.line_size // dtype.itemsize
    rows = np.frombuffer(plane, dtype=dtype, count=stride * frame.height).reshape(frame.height, stride)
    if not deep:
        return np.array(rows[:, : frame.width], dtype=np.uint8)
    native = np.array(rows[:, : frame.width], dtype=np.uint16)
    if frame.format.name.startswith(("p01", "p21", "p41")):
        native >>= np.uint16(16 - gray_depth(frame.format))  # these keep their bits at the top of the word
    return native

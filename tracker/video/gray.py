"""Gray images at full depth, from decoded frames and from packed pixels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracker.arrays import GrayImage

# Rec. 601 luma in 1/256, so that gray content of 8 bit becomes exactly 256 times its value in 16 bit.
LUMA_256 = np.array([77, 150, 29], dtype=np.uint32)


def has_gray_plane(pixel_format: Any) -> bool:
    """Whether the first plane is the gray image: gray and planar or semi-planar YUV formats."""
    name = pixel_format.name
    return bool(name.startswith(("gray", "yuv", "yuvj", "nv", "p01", "ya")) and not _is_packed(name))


def _is_packed(name: str) -> bool:
    return name.startswith(("yuyv", "uyvy", "yvyu", "ya8", "ya16", "grayf"))


def gray_depth(pixel_format: Any) -> int:
    """Bits of the gray image that `gray_image` gives for this format."""
    if has_gray_plane(pixel_format):
        return int(pixel_format.components[0].bits)
    return 16


def luma_16(rgb: NDArray[np.generic], *, deep: bool) -> GrayImage:
    """Rec. 601 luma in 16 bit; from shape (height, width, 3) of 8 bit, or of 16 where `deep`, to (height, width)."""
    luma = rgb.astype(np.uint32) @ LUMA_256
    return np.asarray(luma >> 8 if deep else luma, dtype=np.uint16)


def gray_image(frame: Any) -> GrayImage:
    """Gray image of a PyAV frame, copied from the decoder's buffer; shape (height, width).

    The luma plane is used without conversion of its range: gain and offset are fitted anyway. RGB and palette formats
    are converted to 16 bit with the weights of Rec. 601, without rounding.
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
        native >>= np.uint16(
            16 - gray_depth(frame.format)
        )  # these store their bits at the upper end of the word
    return native


def packed_bytes(pixels: int, bits: int) -> int:
    """Size in bytes of `pixels` of `bits` each, most significant bit first; -1 without a whole number of bytes."""
    return pixels * bits // 8 if pixels * bits % 8 == 0 else -1


def unpacked(data: NDArray[np.uint8], bits: int) -> GrayImage:
    """A copy of the pixels in bytes: of 8 bit, of 16 in little-endian words, or packed to 10 or 12."""
    if bits == 8:
        return data.copy()
    if bits == 16:
        return data.view("<u2").astype(np.uint16)
    # Four pixels from every five bytes, or two from every three.
    b = data.astype(np.uint16).reshape(-1, 5 if bits == 10 else 3).T
    if bits == 10:
        pixels = [
            b[0] << 2 | b[1] >> 6,
            (b[1] & 0x3F) << 4 | b[2] >> 4,
            (b[2] & 0x0F) << 6 | b[3] >> 2,
            (b[3] & 0x03) << 8 | b[4],
        ]
    else:
        pixels = [b[0] << 4 | b[1] >> 4, (b[1] & 0x0F) << 8 | b[2]]
    return np.stack(pixels, axis=1).ravel()


def to_8_bit(image: GrayImage) -> NDArray[np.uint8]:
    """Image stretched to 8 bit between its 0.1 and 99.9 percentiles; 8-bit images are returned unchanged."""
    if image.dtype == np.uint8:
        return np.asarray(image, dtype=np.uint8)
    low, high = np.percentile(image, (0.1, 99.9))
    span = max(float(high - low), 1.0)
    return np.asarray(np.clip((image.astype(np.float64) - low) * (255.0 / span), 0, 255), dtype=np.uint8)

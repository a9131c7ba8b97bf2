"""Pixels of 10 and 12 bit that are packed without gaps, most significant bit first, as high-speed cameras do."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def packed_bytes(pixels: int, bits: int) -> int:
    """Bytes that `pixels` of `bits` each take; -1 where they do not end with a byte."""
    return pixels * bits // 8 if pixels * bits % 8 == 0 else -1


def unpack_10(data: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """Four pixels from every five bytes; shape (5 n,) to (4 n,)."""
    b = data.astype(np.uint16).reshape(-1, 5)
    out = np.empty((b.shape[0], 4), dtype=np.uint16)
    out[:, 0] = b[:, 0] << 2 | b[:, 1] >> 6
    out[:, 1] = (b[:, 1] & 0x3F) << 4 | b[:, 2] >> 4
    out[:, 2] = (b[:, 2] & 0x0F) << 6 | b[:, 3] >> 2
    out[:, 3] = (b[:, 3] & 0x03) << 8 | b[:, 4]
    return out.ravel()


def unpack_12(data: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """Two pixels from every three bytes; shape (3 n,) to (2 n,)."""
    b = data.astype(np.uint16).reshape(-1, 3)
    out = np.empty((b.shape[0], 2), dtype=np.uint16)
    out[:, 0] = b[:, 0] << 4 | b[:, 1] >> 4
    out[:, 1] = (b[:, 1] & 0x0F) << 8 | b[:, 2]
    return out.ravel()

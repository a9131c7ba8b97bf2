"""Check sums of FFV1: the decoder replaces a damaged slice by that of the image before, and says so in its log only."""

from __future__ import annotations

import zlib
from collections.abc import Iterable

# The check sum's polynomial is that of zlib, with the opposite order of the bits in a byte.
_REVERSED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))
_ALL_ONES = 0xFFFFFFFF
# Size of the slice before it (3 bytes), error status (1), check sum (4).
_FOOTER, _SIZE = 8, 3
_MOST_SLICES = 1024


def slices_are_intact(packet: bytes) -> bool:
    """Whether the packet consists of slices whose check sums agree (FFV1 versions 3 and 4 with ``ec``; RFC 9043, 4.9).

    False as well for a packet without check sums: see `has_check_sums`.
    """
    end = len(packet)
    for _ in range(_MOST_SLICES):
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

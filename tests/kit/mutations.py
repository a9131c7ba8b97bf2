"""Seeded damage to a file: bytes, blocks, integers of headers, numbers of texts."""

import math
import re

HEADER_BYTES = 4096
# Where containers keep sizes, counts, offsets and rates: in the bytes after these names.
NAMES = tuple(b"avih strh strf idx1 movi mvhd tkhd mdhd elst stsd stts stsc stsz stco avcC".split())
NAMES += (b"\x2a\xd7\xb1", b"\x44\x89", b"\x16\x54\xae\x6b", b"\x1f\x43\xb6\x75", b"\xa3")  # Matroska
NAMES += (b"!\xf9\x04", b"!\xff\x0b")  # GIF
NAMES += (b"\x00\x01\x04\x00", b"\x01\x01\x04\x00", b"\x11\x01\x04\x00", b"\x02\x01\x03\x00")  # TIFF
BITS = (7, 8, 15, 16, 23, 31, 32, 63, 64)
INTEGERS = (0, 1, 2, 10**7, *(2**bits - 1 for bits in BITS), *(2**bits for bits in BITS[:-1]))
NUMBERS = (
    *["0", "-1", "3", "1e999", "-1e308", "1e300", "1e-320", "1e-9", "1e-5", "1e5", "1e9", "nan", "inf"],
    "9" * 400,
)
NUMBERS += ("", "=1+1", '"a"', "[]")
NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
LARGEST_BYTES = 4_000_000


def flip(data, rng):
    """Change up to 64 bytes, of the whole file or of its header."""
    span = len(data) if rng.integers(2) else min(len(data), HEADER_BYTES)
    for place in rng.integers(0, span, int(2.0 ** rng.uniform(0.0, 6.0))):
        data[place] ^= int(rng.integers(1, 256))


def cut(data, rng):
    """End the file early."""
    del data[int(rng.integers(len(data))) :]


def insert(data, rng):
    """Add random bytes."""
    place, _ = _block(data, rng)
    data[place:place] = rng.bytes(int(2.0 ** rng.uniform(0.0, 10.0)))


def remove(data, rng):
    """Leave out a block."""
    start, stop = _block(data, rng)
    del data[start:stop]


def repeat(data, rng):
    """Repeat a block, up to a thousand times."""
    start, stop = _block(data, rng)
    times = min(int(2.0 ** rng.uniform(0.0, 10.0)), 1 + LARGEST_BYTES // (stop - start))
    data[stop:stop] = bytes(data[start:stop]) * times


def swap(data, rng):
    """Exchange two blocks."""
    (a, b), (c, d) = sorted((_block(data, rng), _block(data, rng)))
    if b <= c:
        data[a:d] = data[c:d] + data[b:c] + data[a:b]


def integer(data, rng):
    """Set one to three integers, in the header or after a name of the container, to extreme values."""
    for _ in range(int(rng.integers(1, 4))):
        place = int(rng.integers(min(len(data), 512)))
        name = NAMES[int(rng.integers(len(NAMES)))]
        count = data.count(name)
        if count and rng.integers(4):
            for _ in range(int(rng.integers(min(count, 8))) + 1):
                place = (
                    data.index(name, (place + 1) % len(data))
                    if name in data[place + 1 :]
                    else data.index(name)
                )
            place += len(name) + int(rng.integers(48))
        size = int(2 ** rng.integers(1, 4))
        value = INTEGERS[int(rng.integers(len(INTEGERS)))] % 256**size
        data[place : place + size] = value.to_bytes(size, ("little", "big")[int(rng.integers(2))])


def number(data, rng):
    """Replace numbers of a text by extreme ones, or by what is no number."""
    for _ in range(int(rng.integers(1, 4))):
        found = list(NUMBER.finditer(data))
        if found:
            one = found[int(rng.integers(len(found)))]
            data[one.start() : one.end()] = NUMBERS[int(rng.integers(len(NUMBERS)))].encode()


def line(data, rng):
    """Repeat, swap or leave out lines of a text."""
    lines = data.split(b"\n")
    a, b = (int(k) for k in rng.integers(0, len(lines), 2))
    what = int(rng.integers(3))
    if what == 0:
        lines[a:a] = [lines[b]] * int(2.0 ** rng.uniform(0.0, 10.0))
    elif what == 1:
        lines[a], lines[b] = lines[b], lines[a]
    else:
        del lines[a]
    data[:] = b"\n".join(lines)


BINARY = (flip, flip, cut, insert, remove, repeat, swap, integer, integer, integer)
TEXT = (flip, cut, insert, remove, repeat, swap, number, number, number, line)


def mutated(whole, rng, *, text=False):
    """The bytes with one to three mutations."""
    data = bytearray(whole)
    kinds = TEXT if text else BINARY
    for _ in range(int(rng.choice((1, 1, 2, 3)))):
        if data:
            kinds[int(rng.integers(len(kinds)))](data, rng)
    return bytes(data)


def _block(data, rng):
    """Ends of a part of the data, from one byte to a quarter of it."""
    start = int(rng.integers(len(data)))
    length = 2.0 ** rng.uniform(0.0, max(0.0, math.log2(len(data) / 4.0)))
    return start, min(len(data), start + max(1, int(length)))

"""Corrupt random bytes of a recording and read it, many times: it is read, has missing frames or is rejected.

Run in a separate process, so that a crash of a decoder does not end the tests:
`python -m support.fuzz_readers CASE COUNT`.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
from kit import camera_files as cases
from kit.mutations import flip

from tracker.video import UnreadableVideoError, open_recording


def damaged(data, rng):
    """With corrupt bytes in the whole file or in its first part, where the headers are."""
    out = bytearray(data)
    flip(out, rng)
    return bytes(out)


def outcome(path):
    try:
        source = open_recording(path)
        try:
            frames = [frame.image is None for frame in source.frames()]
        finally:
            source.close()
    except UnreadableVideoError as error:
        if not str(error).isprintable():
            raise
        return "refused"
    assert len(frames) <= 1000, len(frames)
    return "damaged" if any(frames) else "read"


def main(case, count):
    rng = np.random.default_rng(20)
    with tempfile.TemporaryDirectory() as folder:
        path = cases.WRITERS[case](Path(folder), cases.images_for(case, 12, width=64, height=48))
        parts = sorted(p for p in Path(folder).rglob("*") if p.is_file())
        whole = [p.read_bytes() for p in parts]
        counts = dict.fromkeys(("read", "damaged", "refused"), 0)
        for _ in range(count):
            k = int(rng.integers(len(parts)))
            parts[k].write_bytes(damaged(whole[k], rng))
            counts[outcome(path)] += 1
            parts[k].write_bytes(whole[k])
    sys.stdout.write(f"tried {count}: {counts}\n")


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))

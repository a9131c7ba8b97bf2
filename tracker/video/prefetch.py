"""Decoding in a separate thread ahead of tracking: both release the interpreter while they work."""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import islice

from tracker.video.base import Frame

# Frames are passed in groups: waking the other thread for each one would cost more than decoding some codecs.
CHUNK_FRAMES = 8
CHUNKS_AHEAD = 3


def prefetched(stream: Iterator[Frame]) -> Generator[Frame]:
    """Frames of a stream that another thread reads, in order; an error of the stream is raised here.

    Closing the iterator ends the thread, whether or not the stream was read to its end.
    """

    def chunk() -> list[Frame]:
        return list(islice(stream, CHUNK_FRAMES))

    pool = ThreadPoolExecutor(1, thread_name_prefix="decode")
    try:
        waiting = deque(pool.submit(chunk) for _ in range(CHUNKS_AHEAD))
        while frames := waiting.popleft().result():
            waiting.append(pool.submit(chunk))
            yield from frames
    finally:
        pool.shutdown(cancel_futures=True)

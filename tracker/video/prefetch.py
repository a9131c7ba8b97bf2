"""Decoding in a separate thread ahead of tracking: both release the interpreter while they work."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator

from tracker.video.base import Frame

# Frames are passed in groups: waking the other thread for each one would cost more than decoding some codecs.
CHUNK_FRAMES = 8
CHUNKS_AHEAD = 3


class _End:
    """End of the stream, with the error that ended it, if any."""

    def __init__(self, error: BaseException | None) -> None:
        self.error = error


class Prefetcher:
    """Iterates over a stream of frames that another thread reads, in order; errors are raised at their position.

    A context manager: leaving it ends the thread, whether or not the stream was read to its end.
    """

    def __init__(self, stream: Iterator[Frame]) -> None:
        self._stream = stream
        self._queue: queue.Queue[list[Frame] | _End] = queue.Queue(maxsize=CHUNKS_AHEAD)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._read, name="decode", daemon=True)

    def __enter__(self) -> Iterator[Frame]:
        self._thread.start()
        return self._frames()

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        while self._thread.is_alive():
            try:
                self._queue.get_nowait()  # the reader may be waiting for space
            except queue.Empty:
                self._thread.join(timeout=0.01)

    def _read(self) -> None:
        chunk: list[Frame] = []
        ended = _End(None)
        try:
            for frame in self._stream:
                if self._stop.is_set():
                    return
                chunk.append(frame)
                if len(chunk) == CHUNK_FRAMES:
                    self._queue.put(chunk)
                    chunk = []
        except BaseException as error:  # noqa: BLE001 - raised again in the thread that iterates
            ended = _End(error)
        self._queue.put(chunk)
        self._queue.put(ended)

    def _frames(self) -> Iterator[Frame]:
        while True:
            item = self._queue.get()
            if isinstance(item, _End):
                if item.error is not None:
                    raise item.error
                return
            yield from item

"""Decoding ahead of tracking, in a thread of its own: both release the interpreter while they work."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator

from tracker.video.base import Frame

# Frames are handed over several at a time: waking the other thread for each would cost more than some codecs do.
CHUNK_FRAMES = 8
CHUNKS_AHEAD = 3


class _End:
    """Marks the end of the stream, with the error that ended it, if any."""

    def __init__(self, error: BaseException | None) -> None:
        self.error = error


class Prefetcher:
    """Iterates over a stream of frames that another thread reads; the order stays, errors arrive in their place.

    Used as a context manager: leaving it ends the thread, whether or not the stream was read to its end.
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
                self._queue.get_nowait()  # the reader may be waiting for room
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

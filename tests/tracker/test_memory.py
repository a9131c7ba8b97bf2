"""Memory while a recording streams by: rows may pile up, frames must not."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator
from fractions import Fraction

import numpy as np
import pytest

from tests.support.tracker_scenes import Recording
from tracker.follow.frame_results import CHUNK_ROWS, RowStore
from tracker.settings import TrackerSettings
from tracker.track import track_source
from tracker.video.base import Frame, SourceInfo

MARKERS = 2


class _Loop:
    """A source that gives pictures forwards and backwards, each as a new array, as a decoder does."""

    def __init__(self, pictures: list[np.ndarray], frames: int) -> None:
        self._loop, self._frames = pictures + pictures[-2:0:-1], frames
        height, width = pictures[0].shape
        self.info = SourceInfo(
            "raw",
            "gray",
            width,
            height,
            8,
            255,
            frames,
            time_base=Fraction(1, 1000),
            container_rate=Fraction(1000),
        )

    def frames(self) -> Iterator[Frame]:
        for k in range(self._frames):
            yield Frame(self._loop[k % len(self._loop)].copy(), k)

    def stamps(self) -> list[int | None]:
        return list(range(self._frames))

    def close(self) -> None:
        pass


@pytest.fixture(scope="module")
def pictures() -> list[np.ndarray]:
    return Recording("blob", markers=MARKERS, frames=89, width_px=160, height_px=80).images()


def _peak_while_following(pictures: list[np.ndarray], frames: int) -> int:
    """Largest memory between the last calibration frame and the last frame, in bytes above what there was then."""
    base = 0

    def progress(done: int, _declared: int) -> None:
        nonlocal base
        if done == 200:  # past calibration and what is decoded ahead
            tracemalloc.reset_peak()
            base = tracemalloc.get_traced_memory()[0]
        if done == frames:
            peaks.append(tracemalloc.get_traced_memory()[1] - base)

    peaks: list[int] = []
    settings = TrackerSettings(fps=Fraction(1000), kind="blob")
    tracemalloc.start()
    try:
        tracks = track_source(_Loop(pictures, frames), "loop", settings, progress)
    finally:
        tracemalloc.stop()
    assert tracks, f"the loop could not be tracked: {tracks}"
    assert tracks.x_px.shape == (frames, MARKERS)
    return peaks[0]


def test_a_longer_recording_takes_rows_and_no_frames(pictures: list[np.ndarray]) -> None:
    """Five times as many frames: what more is taken is the rows', 36 bytes a marker, and their time stamps.

    A time stamp is an int of 28 bytes and its place in a list, which grows by an eighth at a time and is copied then:
    100 bytes cover it. Rows come by the chunk. The strip's pictures are at most 24 at all times, as many at 3000
    frames as at 600. A single frame kept out of a hundred would be 24 frames more.
    """
    short, long = 600, 3000
    _peak_while_following(pictures, 300)  # compiles
    more = _peak_while_following(pictures, long) - _peak_while_following(pictures, short)
    per_row = 36 * MARKERS
    allowed = per_row * (long - short + CHUNK_ROWS) + 100 * (long - short) + 10 * pictures[0].nbytes
    assert more < allowed, (
        f"{long - short} frames more took {more} bytes more; rows, time stamps and ten frames of leeway are {allowed}"
    )


def test_rows_come_back_in_the_order_asked_for() -> None:
    """Against the rows themselves, over the seam of two chunks."""
    rng = np.random.default_rng(5)
    n = CHUNK_ROWS + 7
    values = rng.normal(size=(n, 4, 3))
    marks = rng.integers(0, 100, (n, 3)).astype(np.uint32)
    store = RowStore(3)
    for row, mark in zip(values, marks, strict=True):
        store.append(row, mark)
    order = rng.permutation(n)
    stored, flags = store.columns(order)
    np.testing.assert_array_equal(stored, np.moveaxis(values[order], 1, 0))
    np.testing.assert_array_equal(flags, marks[order])
    assert RowStore(3).columns(np.arange(0))[1].shape == (0, 3)

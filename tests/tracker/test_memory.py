"""Memory while a recording is tracked: it may grow with the result rows, but not with the frames."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator
from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import pytest
from kit.scenes import Recording

from tracker import TrackerSettings, track_source
from tracker.follow import RowStore
from tracker.follow import recording as rows
from tracker.video import Frame, SourceInfo

MARKERS = 1


class _Loop:
    """A source that repeats images forwards and backwards, each as a new array like those of a decoder."""

    def __init__(self, images: list[np.ndarray], frames: int) -> None:
        self._loop, self._frames = images + images[-2:0:-1], frames
        height, width = images[0].shape
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
def images() -> list[np.ndarray]:
    return Recording("blob", markers=MARKERS, frames=89, width_px=80, height_px=80).images()


def _peak_while_tracking(images: list[np.ndarray], frames: int) -> int:
    """Peak memory between calibration and the last frame, in bytes above the memory after calibration."""
    base = 0

    def progress(done: int, _declared: int) -> None:
        nonlocal base
        if done == 200:  # after calibration and the frames decoded ahead
            tracemalloc.reset_peak()
            base = tracemalloc.get_traced_memory()[0]
        if done == frames:
            peaks.append(tracemalloc.get_traced_memory()[1] - base)

    peaks: list[int] = []
    settings = TrackerSettings(fps=Fraction(1000), kind="blob", exposure_s=1e-5)
    tracemalloc.start()
    try:
        tracks = track_source(_Loop(images, frames), "loop", settings, progress)
    finally:
        tracemalloc.stop()
    assert tracks, f"the loop could not be tracked: {tracks}"
    assert tracks.x_px.shape == (frames, MARKERS)
    return peaks[0]


def test_memory_grows_only_with_the_result_rows(images: list[np.ndarray]) -> None:
    """With 3.5 times as many frames, only rows (36 bytes per marker) and time stamps take more memory.

    A time stamp is an int of 28 bytes and an entry of a list that grows by an eighth at a time and is then
    copied: 100 bytes are an upper limit. Rows are allocated in chunks. The film strip has at most 24 images,
    for 2100 frames as for 600. Keeping one frame in a hundred would add 15 frames.
    """
    short, long = 600, 2100
    _peak_while_tracking(images, 210)  # compiles
    more = _peak_while_tracking(images, long) - _peak_while_tracking(images, short)
    per_row = 36 * MARKERS
    allowed = per_row * (long - short + rows.TUNING.chunk_rows) + 100 * (long - short) + 10 * images[0].nbytes
    assert more < allowed, (
        f"{long - short} more frames took {more} more bytes; allowed with a margin of ten frames: {allowed}"
    )


@pytest.mark.parametrize("correlated", [False, True])
def test_rows_are_returned_in_the_requested_order(correlated) -> None:
    """Against the stored rows, across the boundary of two chunks."""
    rng = np.random.default_rng(5)
    n = rows.TUNING.chunk_rows + 7
    values = rng.normal(size=(n, 4, 3))
    marks = rng.integers(0, 100, (n, 3)).astype(np.uint32)
    correlations = rng.uniform(-1.0, 1.0, (n, 3)) if correlated else [None] * n
    store = RowStore(3)
    for out, mark, one in zip(values, marks, correlations, strict=True):
        store.append(SimpleNamespace(out=out, marks=mark, correlation=one))
    order = rng.permutation(n)
    stored, flags, correlation = store.columns(order)
    np.testing.assert_array_equal(stored, np.moveaxis(values[order], 1, 0))
    np.testing.assert_array_equal(flags, marks[order])
    np.testing.assert_array_equal(correlation, correlations[order] if correlated else None)
    assert RowStore(3).columns(np.arange(0))[1].shape == (0, 3)

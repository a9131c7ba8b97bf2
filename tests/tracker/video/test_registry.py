"""A reader registered by a plugin is used by all functions that open recordings."""

from fractions import Fraction

import numpy as np
import pytest

from modalcam.inputs import discover
from tracker.video import (
    Frame,
    Reader,
    SourceInfo,
    UnreadableVideoError,
    input_files,
    open_recording,
    probe,
    register_reader,
    registry,
)


class ArraySource:
    """Frames of a saved NumPy array, shape (n, height, width)."""

    def __init__(self, path):
        self._images = np.load(path, mmap_mode="r", allow_pickle=False)
        count, height, width = self._images.shape
        self.info = SourceInfo(
            codec="npy",
            pixel_format="gray",
            width_px=width,
            height_px=height,
            bit_depth=8,
            white_level=255,
            frames_declared=count,
            lossy=False,
            predictive=False,
            time_base=Fraction(1, 500),
            container_rate=None,
            header_rate=Fraction(500),
        )

    def frames(self):
        for k, image in enumerate(self._images):
            yield Frame(np.array(image), k)

    def stamps(self):
        return list(range(len(self._images)))

    def close(self):
        self._images = None


class ArrayReader(Reader):
    name = "npy"
    suffixes = (".npy",)

    def recognises(self, path, head):
        return head.startswith(b"\x93NUMPY")

    def open(self, path):
        return ArraySource(path)


@pytest.fixture
def npy(tmp_path, monkeypatch):
    path = tmp_path / "shot.npy"
    np.save(path, np.arange(4 * 6 * 8, dtype=np.uint8).reshape(4, 6, 8))
    monkeypatch.setattr(registry, "READERS", list(registry.READERS))
    return path


def test_without_its_reader_the_file_is_rejected(npy):
    with pytest.raises(UnreadableVideoError, match="a NumPy array"):
        open_recording(npy)


def test_a_registered_reader_opens_probes_and_discovers_its_files(npy):
    register_reader(ArrayReader())
    source = open_recording(npy)
    frames = list(source.frames())
    source.close()
    assert [f.pts for f in frames] == [0, 1, 2, 3]
    assert np.array_equal(frames[2].image, np.load(npy)[2])
    report = probe(npy)
    assert (report.packets, report.step_ticks, report.info.header_rate) == (4, {1: 3}, 500)
    assert input_files(npy) == (npy,)
    found = discover(npy.parent).recordings
    assert [(f.file, f.path.name) for f in found] == [("shot.npy", "shot.npy")]


def test_a_second_reader_of_the_same_name_is_rejected(npy):
    register_reader(ArrayReader())
    with pytest.raises(ValueError, match="'npy' is already registered"):
        register_reader(ArrayReader())

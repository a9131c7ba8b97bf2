"""Requirements on all readers: image shape, bit depth, frame count, times, constant memory, damaged files."""

import gc
import os
import subprocess
import sys
import tracemalloc

import numpy as np
import pytest
from kit import camera_files as cases
from kit import camera_files as files
from kit import films as media
from kit.camera_files import read
from support.paths import ROOT

from tracker.video import UnreadableVideoError, input_files, open_recording, probe

# Their index is at the end of the file, or their only key frame is cut.
REJECTED_WHEN_TRUNCATED = {"h264 mp4", "h264 mkv", "mpeg4 mov", "mpeg4 mp4", "mjpeg mov"}


@pytest.mark.parametrize("case", cases.WRITERS)
def test_every_reader_reads_all_frames(case, tmp_path):
    images = cases.images_for(case)
    frames, info = read(cases.WRITERS[case](tmp_path, images))
    assert len(frames) == len(images)
    assert info.frames_declared in (0, len(images))
    assert (info.width_px, info.height_px) == (160, 120)
    assert info.lossy == (case in cases.LOSSY)
    assert info.container_rate in (None, 50)
    assert info.header_rate == {"mraw": 30000, "cine": 5000}.get(info.codec)
    depth = cases.DEEP.get(case, 8)
    full = 2.0**depth - 1
    factor = 1.0 if info.white_level == full or "12 in 16" in case else full / info.white_level
    for frame, image in zip(frames, images, strict=True):
        assert frame.image.shape == (120, 160)
        assert frame.image.dtype == (np.uint8 if info.white_level == 255 else np.uint16)
        assert frame.image.flags.c_contiguous
        assert frame.image.flags.owndata or frame.image.base.flags.owndata
        error = frame.image * factor - image.astype(float)
        # Colour formats store 8 bit times 256: 0.4 % below full scale. A swapped axis or frame is off by 160.
        limit = 4.0 if info.lossy else 1.0 if info.bit_depth != depth else 0.0
        assert np.sqrt(np.mean(error**2)) <= limit or "12 in 16" in case
    if "12 in 16" in case:
        assert np.array_equal(frames[3].image, images[3])


@pytest.mark.parametrize("case", cases.WRITERS)
def test_time_stamps_are_read_without_decoding(case, tmp_path):
    path = cases.WRITERS[case](tmp_path, cases.images_for(case))
    frames, _ = read(path)
    source = open_recording(path)
    stamps = source.stamps()
    source.close()
    assert sorted(stamps) == [frame.pts for frame in frames]
    assert np.all(np.diff([frame.pts for frame in frames]) > 0)
    report = probe(path)
    assert (report.packets, report.stamps_missing) == (20, 0)
    assert np.array_equal(report.first_frame, frames[0].image)


@pytest.fixture(scope="module")
def collected():
    """Cycles of what was imported and of earlier tests are collected once: each time would take half a second."""
    gc.collect()
    gc.freeze()


@pytest.mark.usefixtures("collected")
@pytest.mark.parametrize("case", cases.WRITERS)
def test_memory_does_not_grow_with_length(case, tmp_path):
    peaks = []
    for n in (20, 120):
        folder = tmp_path / str(n)
        folder.mkdir()
        path = cases.WRITERS[case](folder, cases.images_for(case, n, width=64, height=48))
        source = open_recording(path)
        count = 0
        # Objects in cycles, as of a TIFF page, stay until a collection: with the default thresholds at any frame.
        tracemalloc.start()
        for frame in source.frames():
            count += frame.image is not None
            gc.collect()
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        source.close()
        assert count == n
    # 100 more frames of 3 kB would take 300 kB; the page table of a TIFF takes 100 bytes per page.
    assert peaks[1] - peaks[0] < 100_000


@pytest.mark.parametrize("case", cases.WRITERS)
def test_a_truncated_file_is_read_up_to_its_end_or_rejected(case, tmp_path):
    images = cases.images_for(case)
    path = cases.WRITERS[case](tmp_path, images)
    whole, _ = read(path)
    largest = max(
        (p for p in ([*path.iterdir()] if path.is_dir() else input_files(path))),
        key=lambda p: p.stat().st_size,
    )
    largest.write_bytes(largest.read_bytes()[: largest.stat().st_size // 2])
    if case in REJECTED_WHEN_TRUNCATED:
        with pytest.raises(UnreadableVideoError, match=path.name):
            read(path)
        return
    frames, info = read(path)
    good = [k for k, frame in enumerate(frames) if frame.image is not None]
    assert len(good) >= 8 or "folder" in case
    if "folder" in case:
        assert len(frames) == 20
        assert len(good) == 19
    if not info.predictive and info.codec != "mjpeg":
        assert all(np.array_equal(frames[k].image, whole[k].image) for k in good[:-1])


def test_a_camera_header_next_to_a_video_sets_its_rate(tmp_path):
    media.write(tmp_path / "shot.avi", media.images(10))
    files.write_photron(tmp_path / "shot.cih", media.images(10), bits=8, rate=12500, step=5)
    (tmp_path / "shot.mraw").unlink()
    frames, info = read(tmp_path / "shot.avi")
    assert info.header_rate == 12500
    assert info.frames_per_s == 2500
    assert [f.pts for f in frames] == list(range(0, 50, 5))
    assert any("shot.cih" in note for note in info.notes)
    assert input_files(tmp_path / "shot.avi") == (tmp_path / "shot.avi", tmp_path / "shot.cih")


def test_an_unusable_camera_header_gives_a_note(tmp_path):
    path = media.write(tmp_path / "shot.avi", media.images(10))
    files.write_photron(tmp_path / "shot.cih", media.images(2, width=64, height=48), bits=8)
    assert any("64 x 48 px" in note for note in read(path)[1].notes)
    (tmp_path / "shot.cih").write_text("#Camera Information Header\nTotal Frame : 10\n")
    _, info = read(path)
    assert info.header_rate is None
    assert any("Record Rate(fps)" in note for note in info.notes)


def test_a_pixel_file_is_opened_through_its_header(tmp_path):
    files.write_photron(tmp_path / "a.cih", media.images(3), bits=8)
    assert len(read(tmp_path / "a.mraw")[0]) == 3
    (tmp_path / "a.cih").unlink()
    with pytest.raises(UnreadableVideoError, match="without their header"):
        open_recording(tmp_path / "a.mraw")


def test_the_reader_is_selected_by_content_not_by_suffix(tmp_path):
    stack = files.write_stack(tmp_path / "a.tif", media.images(4))
    assert read(stack.rename(tmp_path / "a.avi"))[1].codec == "tiff"
    cine = files.write_cine(tmp_path / "b.cine", media.images(4), bits=8)
    assert read(cine.rename(tmp_path / "b.mp4"))[1].codec == "cine"


@pytest.mark.parametrize("case", ["folder", "pipe", "absent"])
def test_other_file_types_are_rejected(case, tmp_path):
    path = tmp_path / "x.cine"
    if case == "folder":
        path.mkdir()
    elif case == "pipe":
        os.mkfifo(path)
    with pytest.raises(UnreadableVideoError):
        open_recording(path)


def run_fuzzer(case, count, seconds):
    command = [sys.executable, "-X", "faulthandler", "-m", "support.fuzz_readers", case, str(count)]
    path = os.pathsep.join(map(str, (ROOT, ROOT / "tests")))
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        timeout=seconds,
        check=False,
        env={**os.environ, "PYTHONPATH": path},
    )
    assert done.returncode == 0, f"{case}: {done.stdout[-300:]} {done.stderr[-2000:]}"
    return done.stdout


FUZZED = [
    "mjpeg avi",
    "ffv1 mkv",
    "h264 mp4",
    "gif",
    "png folder",
    "tiff stack",
    "mraw 12",
    "cine 12",
    "cine 8",
]


@pytest.mark.parametrize("case", FUZZED)
def test_corrupted_bytes_never_crash_a_reader(case):
    assert "tried 6" in run_fuzzer(case, 6, 60)


@pytest.mark.slow
@pytest.mark.parametrize("case", cases.WRITERS)
def test_many_corrupted_bytes_never_crash_a_reader(case):
    assert "tried 200" in run_fuzzer(case, 200, 280)

"""One contract for all readers: shape, depth, count, times, flat memory, and damage that is seen or refused."""

import os
import subprocess
import sys
import tracemalloc

import numpy as np
import pytest
from support import camera_files as files
from support import reader_cases as cases
from support import tracker_media as media
from support.paths import ROOT

from tracker.video.base import UnreadableVideoError
from tracker.video.registry import input_files, open_recording, probe

REFUSED_WHEN_CUT = {"h264 mp4", "mpeg4 mov"}  # their index stands at the end


def read(path):
    source = open_recording(path)
    try:
        return list(source.frames()), source.info
    finally:
        source.close()


@pytest.mark.parametrize("case", cases.WRITERS)
def test_every_reader_gives_every_frame(case, tmp_path):
    images = cases.pictures_for(case)
    frames, info = read(cases.WRITERS[case](tmp_path, images))
    assert len(frames) == len(images)
    assert info.frames_declared in (0, len(images))
    assert (info.width_px, info.height_px) == (160, 120)
    assert info.lossy == (case in cases.LOSSY)
    assert info.header_rate == {"mraw": 30000, "cine": 5000}.get(info.codec)
    depth = cases.DEEP.get(case, 8)
    full = 2.0**depth - 1
    stated = 1.0 if info.white_level == full or "12 in 16" in case else full / info.white_level
    for frame, image in zip(frames, images, strict=True):
        assert frame.image.shape == (120, 160)
        assert frame.image.dtype == (np.uint8 if info.white_level == 255 else np.uint16)
        assert frame.image.flags.c_contiguous
        assert frame.image.flags.owndata or frame.image.base.flags.owndata
        error = frame.image * stated - image.astype(float)
        # Colour formats hold 8 bit as 256 of 65535: 0.4 % less than full. A swapped axis or frame is off by 160.
        limit = 4.0 if info.lossy else 1.0 if info.bit_depth != depth else 0.0
        assert np.sqrt(np.mean(error**2)) <= limit or "12 in 16" in case
    if "12 in 16" in case:
        assert np.array_equal(frames[3].image, images[3])


@pytest.mark.parametrize("case", cases.WRITERS)
def test_stamps_are_told_without_decoding(case, tmp_path):
    path = cases.WRITERS[case](tmp_path, cases.pictures_for(case))
    frames, _ = read(path)
    source = open_recording(path)
    stamps = source.stamps()
    source.close()
    assert sorted(stamps) == [frame.pts for frame in frames]
    assert np.all(np.diff([frame.pts for frame in frames]) > 0)
    report = probe(path)
    assert (report.packets, report.stamps_missing) == (20, 0)
    assert np.array_equal(report.first_frame, frames[0].image)


@pytest.mark.parametrize("case", cases.WRITERS)
def test_memory_does_not_grow_with_length(case, tmp_path):
    peaks = []
    for n in (20, 120):
        folder = tmp_path / str(n)
        folder.mkdir()
        path = cases.WRITERS[case](folder, cases.pictures_for(case, n, width=64, height=48))
        source = open_recording(path)
        tracemalloc.start()
        count = sum(frame.image is not None for frame in source.frames())
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        source.close()
        assert count == n
    # A hundred more frames of 3 kB or 6 kB would be 300 kB; the table of a TIFF's pages takes 100 bytes a page.
    assert peaks[1] - peaks[0] < 100_000


@pytest.mark.parametrize("case", cases.WRITERS)
def test_a_cut_file_gives_what_is_there_or_is_refused(case, tmp_path):
    images = cases.pictures_for(case)
    path = cases.WRITERS[case](tmp_path, images)
    whole, _ = read(path)
    victim = max(
        (p for p in ([*path.iterdir()] if path.is_dir() else input_files(path))),
        key=lambda p: p.stat().st_size,
    )
    victim.write_bytes(victim.read_bytes()[: victim.stat().st_size // 2])
    if case in REFUSED_WHEN_CUT:
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


def test_a_header_beside_a_video_gives_its_rate(tmp_path):
    media.write(tmp_path / "shot.avi", media.pictures(10))
    files.write_photron(tmp_path / "shot.cih", media.pictures(10), bits=8, rate=12500, step=5)
    (tmp_path / "shot.mraw").unlink()
    frames, info = read(tmp_path / "shot.avi")
    assert info.header_rate == 12500
    assert info.frames_per_s == 2500
    assert [f.pts for f in frames] == list(range(0, 50, 5))
    assert any("shot.cih" in note for note in info.notes)
    assert input_files(tmp_path / "shot.avi") == (tmp_path / "shot.avi", tmp_path / "shot.cih")


def test_a_header_of_other_pictures_and_one_that_cannot_serve_are_named(tmp_path):
    path = media.write(tmp_path / "shot.avi", media.pictures(10))
    files.write_photron(tmp_path / "shot.cih", media.pictures(2, width=64, height=48), bits=8)
    assert any("64 x 48 px" in note for note in read(path)[1].notes)
    (tmp_path / "shot.cih").write_text("#Camera Information Header\nTotal Frame : 10\n")
    _, info = read(path)
    assert info.header_rate is None
    assert any("Record Rate(fps)" in note for note in info.notes)


def test_pixels_stand_for_their_header(tmp_path):
    files.write_photron(tmp_path / "a.cih", media.pictures(3), bits=8)
    assert len(read(tmp_path / "a.mraw")[0]) == 3
    (tmp_path / "a.cih").unlink()
    with pytest.raises(UnreadableVideoError, match="without their header"):
        open_recording(tmp_path / "a.mraw")


def test_what_decides_is_the_content_not_the_ending(tmp_path):
    stack = files.write_stack(tmp_path / "a.tif", media.pictures(4))
    assert read(stack.rename(tmp_path / "a.avi"))[1].codec == "tiff"
    cine = files.write_cine(tmp_path / "b.cine", media.pictures(4), bits=8)
    assert read(cine.rename(tmp_path / "b.mp4"))[1].codec == "cine"


@pytest.mark.parametrize("case", ["folder", "pipe", "absent"])
def test_strange_files_are_refused_at_once(case, tmp_path):
    import os

    path = tmp_path / "x.cine"
    if case == "folder":
        path.mkdir()
    elif case == "pipe":
        os.mkfifo(path)
    with pytest.raises(UnreadableVideoError):
        open_recording(path)


def fuzz(case, count, seconds):
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
def test_flipped_bytes_never_crash(case):
    assert "tried 12" in fuzz(case, 12, 60)


@pytest.mark.slow
@pytest.mark.parametrize("case", cases.WRITERS)
def test_many_flipped_bytes_never_crash(case):
    assert "tried 200" in fuzz(case, 200, 280)

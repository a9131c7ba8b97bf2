"""Phantom recordings: every bit depth, the camera's time stamps, and real files against FFmpeg's decoder."""

from functools import partial

import numpy as np
import pytest
from kit import camera_files as files
from kit import films as media
from kit.camera_files import time_axis_of
from support.paths import REALDATA, REALDATA_ABSENT

from tracker.video import PhantomSource, UnreadableVideoError, VideoSource, linear_10

REAL = REALDATA / "highspeed_formats"
real = pytest.mark.skipif(not REAL.is_dir(), reason=REALDATA_ABSENT)


read = partial(files.read, opened=PhantomSource)


def test_packed_10_bit_is_linearized(tmp_path):
    images = media.images(3, depth=10)
    path = files.write_cine(tmp_path / "a.cine", images, bits=10, packing=0x100)
    frames, info = read(path)
    assert (info.bit_depth, info.white_level) == (10, 65520)
    assert np.array_equal(frames[1].image, linear_10()[images[1]])
    # Entries of the manufacturer's table from 10 to 12 bit: dark, knee, bright and full scale.
    known = {
        1: 5,
        63: 63,
        100: 98,
        160: 156,
        256: 290,
        512: 998,
        768: 2267,
        1000: 3947,
        1014: 4064,
        1023: 4095,
    }
    linear = linear_10() / 16
    assert all(abs(linear[code] - value) < 1.0 for code, value in known.items())
    assert np.all(np.diff(linear[:1016]) > 0)


@pytest.mark.parametrize(("flip_v", "flip_h"), [(0, 0), (1, 0), (0, 1), (1, 1)])
@pytest.mark.parametrize(("bits", "packing"), [(16, 0), (12, 0x400), (8, 0)])
def test_images_are_oriented_as_in_the_camera_software(bits, packing, flip_v, flip_h, tmp_path):
    image = np.zeros((24, 32), dtype=np.uint16 if bits > 8 else np.uint8)
    image[3, 5] = 200
    path = files.write_cine(
        tmp_path / "a.cine", [image, image], bits=bits, packing=packing, flip_v=flip_v, flip_h=flip_h
    )
    assert np.array_equal(read(path)[0][0].image, image)


def test_rows_with_an_odd_number_of_pixels(tmp_path):
    images = [image[:119, :157] for image in media.images(3)]
    frames, _ = read(files.write_cine(tmp_path / "a.cine", images, bits=8))
    assert np.array_equal(frames[2].image, images[2])


def test_the_camera_time_stamps_set_the_time_axis(tmp_path):
    images = media.images(40)
    even = np.arange(40) / 5000
    as_stated = time_axis_of(files.write_cine(tmp_path / "a.cine", images, bits=8, times_s=even))
    assert as_stated.time_axis.fps_recorded == 5000
    assert as_stated.time_axis.notes == ()
    rounded = time_axis_of(files.write_cine(tmp_path / "b.cine", images, bits=8, times_s=even * 0.999))
    assert float(rounded.time_axis.fps_recorded) == pytest.approx(5000 / 0.999, rel=1e-6)
    assert "rounded setting" in rounded.time_axis.notes[0]
    decimated = time_axis_of(files.write_cine(tmp_path / "c.cine", images, bits=8, times_s=even * 10))
    assert decimated.time_axis.fps_recorded == 500
    assert "one frame in 10" in decimated.time_axis.notes[0]
    gap = np.where(np.arange(40) < 20, even, even + 7 / 5000)
    with_gap = time_axis_of(files.write_cine(tmp_path / "d.cine", images, bits=8, times_s=gap))
    assert np.allclose(with_gap.time_s, gap, atol=1e-8)
    assert "uneven" in with_gap.time_axis.notes[0]
    coarse = np.floor(even * 1e6 / 3) * 3e-6
    quantized = time_axis_of(files.write_cine(tmp_path / "e.cine", images, bits=8, times_s=coarse))
    assert quantized.time_axis.fps_recorded == 5000


def test_time_stamps_with_a_jump_are_not_used(tmp_path):
    times = np.arange(20) / 5000
    times[-1] += 1e6
    axis = time_axis_of(files.write_cine(tmp_path / "a.cine", media.images(20), bits=8, times_s=times))
    assert np.allclose(axis.time_s, np.arange(20) / 5000)
    assert "jump at frame 19" in axis.time_axis.notes[0]


def test_a_damaged_frame_keeps_its_index(tmp_path):
    path = files.write_cine(tmp_path / "a.cine", media.images(10), bits=8)
    data = bytearray(path.read_bytes())
    at_table = int.from_bytes(data[32:36], "little")
    data[at_table + 8 * 4 : at_table + 8 * 5] = b"\xff" * 8
    path.write_bytes(bytes(data))
    frames, _ = read(path)
    assert [k for k, f in enumerate(frames) if f.image is None] == [4]
    assert [f.pts for f in frames] == list(range(10))


def test_invalid_headers_are_rejected(tmp_path):
    path = files.write_cine(tmp_path / "a.cine", media.images(2), bits=8)
    whole = path.read_bytes()
    for position, value, words in (
        (84 + 140, b"XX", "setup is damaged"),
        (84 + 768, bytes(4), "0 fps"),
        (48, (10**6).to_bytes(4, "little"), "over the limit"),
        (48, bytes(4), "no image size"),
        (60, b"\x07\x00\x00\x00", "packing 0x7"),
    ):
        data = bytearray(whole)
        data[position : position + len(value)] = value
        path.write_bytes(bytes(data))
        with pytest.raises(UnreadableVideoError, match=words):
            read(path)
    path.write_bytes(whole[:100])
    with pytest.raises(UnreadableVideoError, match="ends within its headers"):
        read(path)


def test_a_frame_count_beyond_the_file_allocates_no_memory(tmp_path):
    path = files.write_cine(tmp_path / "a.cine", media.images(5), bits=8)
    data = bytearray(path.read_bytes())
    data[20:24] = b"\xff\xff\xff\xff"
    path.write_bytes(bytes(data))
    frames, _ = read(path)
    assert sum(f.image is not None for f in frames) == 5


@real
@pytest.mark.parametrize(
    ("name", "shape", "rate", "depth"),
    [
        ("data_small_cine.cine", (235, 32, 256), 100, 10),
        ("cine_legacy.cine", (97, 128, 128), 35087, 14),
        ("cine_781.cine", (15, 256, 256), 90000, 12),
    ],
)
def test_real_files_match_their_headers_and_ffmpeg(name, shape, rate, depth):
    frames, info = read(REAL / name)
    assert (len(frames), *frames[0].image.shape) == shape
    assert (info.header_rate, info.bit_depth) == (rate, depth)
    ffmpeg = VideoSource(REAL / name)
    for frame, other in zip(frames, ffmpeg.frames(), strict=True):
        # FFmpeg scales to 16 bit: the upper bits are those of the file, not linearized.
        stored = other.image >> (16 - depth)
        assert np.array_equal(frame.image, linear_10()[stored] if depth == 10 else stored)
    ffmpeg.close()


@real
def test_decimation_is_detected_from_the_time_stamps():
    axis = time_axis_of(REAL / "cine_781.cine")
    assert float(axis.time_axis.fps_recorded) == pytest.approx(9003.213, abs=0.001)
    assert "one frame in 10" in axis.time_axis.notes[0]
    legacy = time_axis_of(REAL / "cine_legacy.cine")
    assert legacy.time_axis.fps_recorded == 35087
    small = time_axis_of(REAL / "data_small_cine.cine")
    assert small.time_axis.fps_recorded == 100
    assert "jump at frame 234" in small.time_axis.notes[0]

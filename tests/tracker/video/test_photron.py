"""Photron recordings: every bit depth, both header formats, and real files of a FASTCAM."""

from fractions import Fraction
from functools import partial

import numpy as np
import pytest
from kit import camera_files as files
from kit import films as media
from kit.camera_files import time_axis_of
from scipy.ndimage import binary_fill_holes, label
from support.paths import REALDATA as REAL
from support.paths import REALDATA_ABSENT

from tracker import TrackerSettings, track
from tracker.video import PhotronSource, UnreadableVideoError, unpacked

real = pytest.mark.skipif(not REAL.is_dir(), reason=REALDATA_ABSENT)


read = partial(files.read, opened=PhotronSource)


@pytest.mark.parametrize("bits", [10, 12])
def test_unpacking_inverts_packing(bits):
    words = np.random.default_rng(4).integers(0, 1 << bits, 4000).astype(np.uint16)
    data = np.frombuffer(files.packed(words, bits), dtype=np.uint8)
    assert np.array_equal(unpacked(data, bits), words)


@pytest.mark.parametrize("suffix", [".cih", ".cihx"])
def test_words_with_the_data_in_the_upper_bits(suffix, tmp_path):
    images = media.images(4, depth=12)
    path = files.write_photron(tmp_path / f"a{suffix}", images, bits=16, shift=4, depth=12, side="Higher")
    frames, info = read(path)
    assert (info.bit_depth, info.white_level) == (12, 4095)
    assert np.array_equal(frames[2].image, images[2])


def test_the_save_step_divides_the_frame_rate(tmp_path):
    path = files.write_photron(tmp_path / "a.cih", media.images(5), bits=8, rate=30000, step=3)
    axis = time_axis_of(path)
    assert axis.time_axis.fps_recorded == 10000
    assert axis.time_s[-1] == 4 / 10000
    assert "Recorded at 30000 fps" in axis.time_axis.notes[0]


def test_a_fractional_rate(tmp_path):
    path = files.write_photron(tmp_path / "a.cih", media.images(2), bits=8, rate="59.94")
    assert read(path)[1].header_rate == Fraction("59.94")


def test_pixel_files_shorter_and_longer_than_the_header_states(tmp_path):
    images = media.images(6)
    path = files.write_photron(tmp_path / "a.cih", images, bits=8, frames=9)
    frames, info = read(path)
    assert (len(frames), info.frames_declared) == (6, 9)
    pixels = tmp_path / "a.mraw"
    pixels.write_bytes(pixels.read_bytes()[:-100])
    frames, info = read(path)
    assert len(frames) == 5
    assert any("ends within a frame" in note for note in info.notes)
    path = files.write_photron(tmp_path / "b.cih", images, bits=8, frames=4)
    frames, info = read(path)
    assert len(frames) == 4
    assert any("larger than" in note for note in info.notes)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"color": "Color"}, "color type 'Color'"),
        ({"bits": 24}, "24 bit"),
        ({"width": "many"}, "'Image Width' is 'many'"),
        ({"width": "-5"}, "'Image Width' is '-5'"),
        ({"height": 0}, "no image size"),
        ({"width": 10**6}, "over the limit"),
        ({"rate": 0}, "'Record Rate(fps)' is '0'"),
        ({"rate": "nan"}, "expected frames per second"),
        ({"rate": "1e999999999"}, "expected frames per second"),
        ({"frames": "9" * 5000}, "'Total Frame' is"),
    ],
)
def test_invalid_header_values_are_rejected_with_their_key(changes, words, tmp_path):
    path = files.write_photron(tmp_path / "a.cih", media.images(2), bits=8)
    values = {"rate": 30000, "frames": 2, "step": 1, "width": 160, "height": 120, "color": "Mono", "bits": 8}
    path.write_text(files.CIH.format(**{**values, "depth": 8, "side": "Lower", **changes}))
    with pytest.raises(UnreadableVideoError) as info:
        read(path)
    assert words in str(info.value)
    assert "a.cih" in str(info.value)


def test_missing_keys_are_named_as_in_the_header(tmp_path):
    path = files.write_photron(tmp_path / "a.cih", media.images(2), bits=8)
    path.write_text("#Camera Information Header\nRecord Rate(fps) : 500\nImage Width : 160\n")
    with pytest.raises(UnreadableVideoError, match="'Total Frame', 'Image Height', 'Color Bit'"):
        read(path)
    path.write_bytes("#Kamera\nBildrate : 500\nBreite：160\n".encode("utf-16"))
    with pytest.raises(UnreadableVideoError, match="not a Photron header"):
        read(path)


def test_xml_entities_are_rejected_without_expanding_them(tmp_path):
    bomb = "".join(f'<!ENTITY a{k} "{f"&a{k - 1};" * 10 if k else "x"}">' for k in range(12))
    path = tmp_path / "a.cihx"
    path.write_text(f"<?xml version='1.0'?><!DOCTYPE cih [{bomb}]><cih><x>&a11;</x></cih>")
    with pytest.raises(UnreadableVideoError, match="entities"):
        read(path)
    path.write_text("<?xml version='1.0'?><cih><recordInfo><recordRate>&a;</recordRate></recordInfo></cih>")
    with pytest.raises(UnreadableVideoError, match="damaged"):
        read(path)
    path.write_text("<?xml version='1.0'?><cih><recordInfo>")
    with pytest.raises(UnreadableVideoError, match="incomplete"):
        read(path)


def test_a_link_to_pixels_outside_the_folder_is_rejected(tmp_path):
    outside = tmp_path / "outside.mraw"
    outside.write_bytes(bytes(160 * 120 * 2))
    folder = tmp_path / "videos"
    folder.mkdir()
    path = files.write_photron(folder / "a.cih", media.images(2), bits=8)
    (folder / "a.mraw").unlink()
    (folder / "a.mraw").symlink_to(outside)
    with pytest.raises(UnreadableVideoError, match=r"no a\.mraw next to the header"):
        read(path)


@real
@pytest.mark.parametrize(
    ("name", "shape", "rate", "depth"),
    [
        ("highspeed_formats/ball_12bit.cihx", (15, 384, 384), 30000, 12),
        ("highspeed_formats/beam.cihx", (4, 80, 1024), 50000, 12),
        ("highspeed_formats/focus.cih", (1, 40, 640), 50, 8),
        ("photron_beam_impact/data_showcase.cih", (75, 40, 640), 15000, 8),
    ],
)
def test_real_files_match_their_headers(name, shape, rate, depth):
    frames, info = read(REAL / name)
    assert (len(frames), *frames[0].image.shape) == shape
    assert (info.header_rate, info.bit_depth) == (rate, depth)
    assert all(int(f.image.max()) <= info.white_level for f in frames)


def silhouette_y(image):
    """Mean row of the largest dark region above the table, with reflections filled."""
    regions, _ = label(binary_fill_holes(image[:300] < 2000))
    largest = 1 + np.argmax(np.bincount(regions.ravel())[1:])
    return np.nonzero(regions == largest)[0].mean()


@real
def test_the_falling_ball_moves_at_constant_speed():
    path = REAL / "highspeed_formats" / "ball_12bit.cihx"
    k = np.arange(15)
    y = np.array([silhouette_y(frame.image) for frame in read(path)[0]])
    line = np.polyfit(k, y, 1)
    assert line[0] == pytest.approx(2.6456, abs=5e-4)
    assert np.std(y - np.polyval(line, k)) <= 0.0255
    tracks = track(path, TrackerSettings(kind="blob"), recording="ball")
    assert tracks.time_axis.fps_recorded == 30000
    line = np.polyfit(k, tracks.y_px[:, 0], 1)
    # Contours of the ball at other gray levels move at 2.647 to 2.650 px per frame, because it is lit unevenly:
    # this is the uncertainty of the speed. Its reflections move at 2.66 and must not be tracked.
    assert line[0] == pytest.approx(2.6456, abs=0.0045)
    assert tracks.x_px[0, 0] == pytest.approx(175.1, abs=0.5)
    assert np.std(tracks.y_px[:, 0] - np.polyval(line, k), ddof=2) <= 0.025

"""Image folders and TIFF stacks: natural order, gaps as missing frames, equal size, size limits."""

from fractions import Fraction

import cv2
import numpy as np
import pytest
import tifffile
from kit import camera_files as files
from kit import films as media
from kit.camera_files import read

from tracker import TrackerSettings, flags, track
from tracker.video import ImageFolder, TiffSource, UnreadableVideoError, image_series, is_stack
from tracker.video import source as limits

BLOB = TrackerSettings(kind="blob", fps=Fraction(500))


def test_images_are_in_natural_order(tmp_path):
    images = media.images(12)
    frames, _ = read(files.write_folder(tmp_path / "a", images, ".png", name="shot_{}"))
    assert all(np.array_equal(f.image, i) for f, i in zip(frames, images, strict=True))


def test_series_differ_in_all_but_the_last_number():
    names = [f"cam1_{k}.png" for k in range(12)] + [f"cam2_{k}.png" for k in range(10)]
    names += [f"cam1_{k}.txt" for k in range(30)] + ["cam1_99.PNG", ".cam1_5.png", "photo.png"]
    first, second = image_series(names)
    assert (first.prefix, len(first.files), first.files[-1]) == ("cam1_", 13, (99, "cam1_99.PNG"))
    assert (second.prefix, len(second.files)) == ("cam2_", 10)
    assert image_series(names[13:20]) == ()


def test_missing_numbers_are_missing_frames(tmp_path):
    numbers = [k for k in range(100, 140) if k not in (107, 120, 121)]
    images = media.images(40)
    folder = files.write_folder(tmp_path / "a", [images[k - 100] for k in numbers], ".png", numbers=numbers)
    frames, info = read(folder)
    assert len(frames) == info.frames_declared == 40
    assert [k for k, f in enumerate(frames) if f.image is None] == [7, 20, 21]
    assert np.array_equal(frames[39].image, images[39])
    assert any("3 of 40 numbers have no image (107, 120 to 121)" in note for note in info.notes)
    tracks = track(folder, BLOB, recording="a")
    assert np.allclose(tracks.time_s, np.arange(40) / 500)
    assert np.flatnonzero(np.isnan(tracks.x_px[:, 0])).tolist() == [7, 20, 21]
    assert np.all(tracks.flags[[7, 20, 21], 0] & flags.DECODE_CORRUPT.value)


def test_an_image_folder_has_no_frame_rate(tmp_path):
    folder = files.write_folder(tmp_path / "a", media.images(12), ".png")
    failed = track(folder, TrackerSettings(kind="blob"), recording="a")
    assert not failed
    assert "--fps" in failed.reason


def test_the_camera_header_in_an_image_folder_sets_the_rate(tmp_path):
    folder = files.write_folder(tmp_path / "a", media.images(12), ".tif")
    files.write_photron(folder / "C001.cih", media.images(12), bits=8, rate=12000)
    (folder / "C001.mraw").unlink()
    _, info = read(folder)
    assert info.header_rate == 12000
    assert track(folder, TrackerSettings(kind="blob"), recording="a").time_axis.source == "camera header"


def test_numbers_with_a_constant_step(tmp_path):
    folder = files.write_folder(tmp_path / "a", media.images(12), ".png", numbers=range(0, 120, 10))
    frames, info = read(folder)
    assert len(frames) == 12
    assert any("steps of 10" in note for note in info.notes)


def test_unusable_frame_numbers_are_rejected(tmp_path):
    numbers = [*range(11), 10**9]
    folder = files.write_folder(tmp_path / "a", media.images(12), ".png", numbers=numbers)
    with pytest.raises(UnreadableVideoError, match="leave room for 1000000001 frames"):
        ImageFolder(folder)
    twice = files.write_folder(tmp_path / "b", media.images(12), ".png")
    (twice / "frame007.png").write_bytes((twice / "frame7.png").read_bytes())
    with pytest.raises(UnreadableVideoError, match=r"frame0*7.png and frame0*7.png have the same number"):
        ImageFolder(twice)


def test_several_series_or_none_are_rejected(tmp_path):
    folder = files.write_folder(tmp_path / "a", media.images(12), ".png", name="left{}")
    for k, image in enumerate(media.images(12)):
        cv2.imwrite(str(folder / f"right{k}.png"), image)
    with pytest.raises(UnreadableVideoError, match="2 series of images"):
        ImageFolder(folder)
    (tmp_path / "b").mkdir()
    with pytest.raises(UnreadableVideoError, match="at least 10"):
        ImageFolder(tmp_path / "b")


def test_an_image_of_other_size_or_type_is_rejected_with_its_name(tmp_path):
    images = media.images(12)
    folder = files.write_folder(tmp_path / "a", [*images[:8], images[8][:100], *images[9:]], ".png")
    with pytest.raises(UnreadableVideoError, match=r"frame9.png: the image is 160 x 100 px"):
        read(folder)
    mixed = files.write_folder(
        tmp_path / "b", [*images[:8], images[8].astype(np.uint16), *images[9:]], ".png"
    )
    with pytest.raises(UnreadableVideoError, match=r"frame9.png: the image is png gray16be"):
        read(mixed)
    failed = track(folder, BLOB, recording="a")
    assert not failed
    assert "frame9.png" in failed.reason


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp", ".tif"])
def test_a_damaged_image_is_a_missing_frame(suffix, tmp_path):
    folder = files.write_folder(tmp_path / "a", media.images(12), suffix)
    damaged = folder / f"frame5{suffix}"
    damaged.write_bytes(damaged.read_bytes()[: damaged.stat().st_size // 2])
    (folder / f"frame8{suffix}").write_bytes(b"")
    (folder / f"frame9{suffix}").write_text("plain text in place of the image data, one line")
    frames, _ = read(folder)
    assert [k for k, f in enumerate(frames) if f.image is None] == [4, 7, 8]


def test_links_to_files_outside_the_folder_are_ignored(tmp_path):
    folder = files.write_folder(tmp_path / "a", media.images(12), ".png")
    outside = tmp_path / "secret.png"
    outside.write_bytes((folder / "frame1.png").read_bytes())
    (folder / "frame13.png").symlink_to(outside)
    assert len(read(folder)[0]) == 12


def test_too_many_pixels_are_rejected_before_decoding(tmp_path, monkeypatch):
    for side in (60000, 2**32 - 1):
        folder = tmp_path / str(side)
        folder.mkdir()
        for k in range(12):
            (folder / f"{k}.png").write_bytes(files.announced_png(side, side))
        with pytest.raises(UnreadableVideoError, match=f"{side} x {side} px is over the limit"):
            ImageFolder(folder)
    stack = tmp_path / "a.tif"
    tifffile.imwrite(stack, np.zeros((200, 300), np.uint8))
    monkeypatch.setattr("tracker.video.source.TUNING", limits.Tuning(max_pixels=50_000))
    with pytest.raises(UnreadableVideoError, match="over the limit"):
        TiffSource(stack)


def test_imagej_stack_with_a_single_page(tmp_path):
    images = np.stack(media.images(9))
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, images, imagej=True)
    assert is_stack(path)
    frames, _ = read(path)
    assert len(frames) == 9
    # A stack over 4 GB has one page, followed by the data of the other images. Without the link to its second
    # page, this stack has the same layout.
    with tifffile.TiffFile(path) as file:
        link_at = file.pages[0].offset + 2 + 12 * len(file.pages[0].tags)
    data = bytearray(path.read_bytes())
    data[link_at : link_at + 4] = bytes(4)
    path.write_bytes(bytes(data))
    assert is_stack(path)
    frames, info = read(path)
    assert (len(frames), info.frames_declared) == (9, 9)
    assert all(np.array_equal(f.image, i) for f, i in zip(frames, images, strict=True))


def test_tiff_variants(tmp_path):
    pytest.importorskip("imagecodecs", reason="the extra modalcam[tiff] is not installed")
    image = media.images(1)[0]
    for name, options in {
        "be": {"byteorder": ">"},
        "big": {"bigtiff": True},
        "zip": {"compression": "zlib"},
        "lzw": {"compression": "lzw"},
        "lzw of differences": {"compression": "lzw", "predictor": True},
        "zstd": {"compression": "zstd"},
        "tiles": {"tile": (32, 32)},
        "strips": {"rowsperstrip": 7},
    }.items():
        path = tmp_path / f"{name}.tif"
        tifffile.imwrite(path, image.astype(np.uint16) * 16, **options)
        assert np.array_equal(read(path)[0][0].image, image.astype(np.uint16) * 16), name
    white = tmp_path / "white.tif"
    tifffile.imwrite(white, 255 - image, photometric="miniswhite")
    assert np.array_equal(read(white)[0][0].image, image)
    rgb = tmp_path / "rgb.tif"
    tifffile.imwrite(rgb, np.repeat(image[..., None], 3, axis=2), photometric="rgb")
    assert np.array_equal(read(rgb)[0][0].image, image.astype(np.uint16) * 256)
    real = tmp_path / "float.tif"
    tifffile.imwrite(real, image.astype(np.float32))
    with pytest.raises(UnreadableVideoError, match="8 to 16 bit"):
        TiffSource(real)


def test_a_damaged_page_of_a_compressed_stack_is_a_missing_frame(tmp_path):
    pytest.importorskip("imagecodecs", reason="the extra modalcam[tiff] is not installed")
    images = media.images(5)
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, np.stack(images), compression="lzw", photometric="minisblack")
    with tifffile.TiffFile(path) as file:
        start, count = file.pages[2].dataoffsets[0], file.pages[2].databytecounts[0]
    data = bytearray(path.read_bytes())
    data[start : start + count] = bytes(count)
    path.write_bytes(bytes(data))
    frames, _ = read(path)
    assert [f.image is None for f in frames] == [False, False, True, False, False]
    assert np.array_equal(frames[3].image, images[3])


def test_a_stack_of_changing_size_is_rejected_with_the_page(tmp_path):
    images = media.images(6)
    path = files.write_stack(tmp_path / "a.tif", [*images[:4], images[4][:100], images[5]])
    with pytest.raises(UnreadableVideoError, match="160 x 100 px at page 4"):
        read(path)


def test_a_cyclic_page_chain_ends(tmp_path):
    path = files.write_stack(tmp_path / "a.tif", media.images(4))
    with tifffile.TiffFile(path) as file:
        first, last = file.pages[0], file.pages[3]
        link_at = last.offset + 2 + 12 * len(last.tags)
        target = first.offset
    data = bytearray(path.read_bytes())
    data[link_at : link_at + 4] = target.to_bytes(4, "little")
    path.write_bytes(bytes(data))
    assert len(read(path)[0]) == 4

import os

import numpy as np
import pytest
import tifffile

from modalcam.common import ExitCode, InputError, NoInputError
from modalcam.inputs import discover


def test_recordings_in_natural_order_and_in_folders(tmp_path):
    (tmp_path / "sub").mkdir()
    (tmp_path / ".hidden").mkdir()
    for name in ["take10.avi", "take2.AVI", "sub/take3.mp4", ".hidden/x.mp4", "notes.txt"]:
        (tmp_path / name).write_bytes(b"x")
    found = discover(tmp_path)
    assert [f.file for f in found.recordings] == ["sub/take3.mp4", "take2.AVI", "take10.avi"]
    assert all(f.path.is_file() for f in found.recordings)


def test_an_empty_folder_names_the_expected_formats(tmp_path):
    with pytest.raises(NoInputError, match=r"\.avi") as info:
        discover(tmp_path)
    assert info.value.exit_code == ExitCode.NO_INPUT
    (tmp_path / "a.txt").write_text("x")
    with pytest.raises(NoInputError, match=r"found only \.txt"):
        discover(tmp_path)


def test_a_missing_folder_and_a_file_are_usage_errors(tmp_path):
    with pytest.raises(InputError, match="no such folder") as info:
        discover(tmp_path / "absent")
    assert info.value.exit_code == ExitCode.USAGE
    file = tmp_path / "a.mp4"
    file.write_bytes(b"x")
    with pytest.raises(InputError, match="found a file"):
        discover(file)


def test_links_pipes_and_folders_with_the_suffix_of_a_video_are_ignored(tmp_path):
    outside = tmp_path / "outside.mp4"
    outside.write_bytes(b"x")
    folder = tmp_path / "videos"
    folder.mkdir()
    (folder / "real.mp4").write_bytes(b"x")
    (folder / "link.mp4").symlink_to(outside)
    (folder / "loop").symlink_to(folder)
    (folder / "dir.mp4").mkdir()
    os.mkfifo(folder / "pipe.mp4")
    found = discover(folder)
    assert [f.file for f in found.recordings] == ["real.mp4"]
    text = " ".join(found.notes)
    assert "link.mp4 is a symbolic link" in text
    assert "pipe.mp4 is not a regular file" in text
    followed = discover(folder, follow_symlinks=True)
    assert "link.mp4" in [f.file for f in followed.recordings]


def test_results_inside_the_folder_are_ignored(tmp_path):
    (tmp_path / "a.mp4").write_bytes(b"x")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "b.mp4").write_bytes(b"x")
    assert [f.file for f in discover(tmp_path, exclude=tmp_path / "out").recordings] == ["a.mp4"]


def images(folder, count=12, suffix=".png", name="f{}"):
    folder.mkdir(parents=True, exist_ok=True)
    for k in range(count):
        (folder / (name.format(k) + suffix)).write_bytes(b"x")
    return folder


def names(folder, **options):
    return [(f.name, f.file) for f in discover(folder, **options).recordings]


def test_a_folder_of_numbered_images_is_one_recording_named_after_it(tmp_path):
    images(tmp_path / "take.10")
    images(tmp_path / "take.2", suffix=".TIF")
    images(tmp_path / "photos", count=5)
    (tmp_path / "a.avi").write_bytes(b"x")
    assert names(tmp_path) == [("a", "a.avi"), ("take.2", "take.2"), ("take.10", "take.10")]
    assert discover(tmp_path).recordings[1].path == (tmp_path / "take.2").resolve()


def test_the_folder_itself_can_be_the_recording(tmp_path):
    folder = images(tmp_path / "shot")
    assert names(folder) == [("shot", "shot")]
    assert discover(folder).recordings[0].path == folder.resolve()
    images(folder / "shot")
    assert len(set(names(folder))) == 2


def test_images_next_to_recordings_are_ignored_with_a_note(tmp_path):
    images(tmp_path)
    (tmp_path / "a.avi").write_bytes(b"x")
    found = discover(tmp_path)
    assert [f.file for f in found.recordings] == ["a.avi"]
    assert "f0.png" in found.notes[0]
    assert "folder of their own" in found.notes[0]


def test_too_few_images_are_listed_as_found(tmp_path):
    images(tmp_path, count=3)
    with pytest.raises(NoInputError, match=r"found only \.png"):
        discover(tmp_path)


def test_stacks_are_recordings_and_single_pages_are_images(tmp_path):
    for k in range(11):
        tifffile.imwrite(tmp_path / f"take{k}.tif", np.zeros((3, 8, 8), np.uint8), photometric="minisblack")
    assert [file for _, file in names(tmp_path)] == [f"take{k}.tif" for k in range(11)]
    pages = tmp_path / "pages"
    pages.mkdir()
    for k in range(11):
        tifffile.imwrite(pages / f"take{k}.tif", np.zeros((8, 8), np.uint8))
    tifffile.imwrite(pages / "stack.tif", np.zeros((3, 8, 8), np.uint8), photometric="minisblack")
    assert [file for _, file in names(pages)] == ["stack.tif"]
    (pages / "stack.tif").unlink()
    assert names(pages) == [("pages", "pages")]


def test_a_header_is_listed_for_its_pixels_but_not_next_to_a_video(tmp_path):
    for name in ("a.cih", "a.cihx", "a.mraw", "b.avi", "b.cih", "c.mraw", "d.cih"):
        (tmp_path / name).write_bytes(b"x")
    found = discover(tmp_path)
    assert [f.file for f in found.recordings] == ["a.cihx", "b.avi", "d.cih"]
    assert "c.mraw holds raw pixels" in found.notes[0]
    shot = images(tmp_path / "shot", suffix=".tif")
    (shot / "C001.cih").write_bytes(b"x")
    assert names(shot) == [("shot", "shot")]


def test_output_of_an_earlier_run_and_hidden_images_are_ignored(tmp_path):
    images(tmp_path / "out")
    images(tmp_path / ".thumbnails")
    images(tmp_path / "shot")
    assert names(tmp_path, exclude=tmp_path / "out") == [("shot", "shot")]

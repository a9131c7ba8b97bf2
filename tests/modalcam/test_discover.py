import os

import pytest

from modalcam.discover import discover
from modalcam.errors import ExitCode, InputError, NoInputError


def test_recordings_in_natural_order_and_in_folders(tmp_path):
    (tmp_path / "sub").mkdir()
    (tmp_path / ".hidden").mkdir()
    for name in ["take10.avi", "take2.AVI", "sub/take3.mp4", ".hidden/x.mp4", "notes.txt"]:
        (tmp_path / name).write_bytes(b"x")
    found = discover(tmp_path)
    assert [f.file for f in found.recordings] == ["sub/take3.mp4", "take2.AVI", "take10.avi"]
    assert all(f.path.is_file() for f in found.recordings)


def test_empty_folder_says_what_was_looked_for(tmp_path):
    with pytest.raises(NoInputError, match=r"\.avi") as info:
        discover(tmp_path)
    assert info.value.exit_code == ExitCode.NO_INPUT
    (tmp_path / "a.txt").write_text("x")
    with pytest.raises(NoInputError, match=r"found only \.txt"):
        discover(tmp_path)


def test_missing_folder_and_file_are_wrong_usage(tmp_path):
    with pytest.raises(InputError, match="no such folder") as info:
        discover(tmp_path / "absent")
    assert info.value.exit_code == ExitCode.USAGE
    file = tmp_path / "a.mp4"
    file.write_bytes(b"x")
    with pytest.raises(InputError, match="found a file"):
        discover(file)


def test_links_pipes_and_folders_with_a_recordings_name(tmp_path):
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
    assert "link.mp4 is a link" in text
    assert "pipe.mp4 is no regular file" in text
    followed = discover(folder, follow_symlinks=True)
    assert "link.mp4" in [f.file for f in followed.recordings]


def test_results_inside_the_folder_are_left_out(tmp_path):
    (tmp_path / "a.mp4").write_bytes(b"x")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "b.mp4").write_bytes(b"x")
    assert [f.file for f in discover(tmp_path, exclude=tmp_path / "out").recordings] == ["a.mp4"]

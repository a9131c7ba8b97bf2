"""The model of a studio: which files its requests reach, hostile names and links, and recordings that disappear."""

import shutil
import tomllib

import numpy as np
import pytest
from kit import films as media
from kit.films import write_decay
from support.paths import ROOT

from modalcam.apps.studio import Pools, Stand, Studio, options_error, overlay
from modalcam.common import ConfigError, InputError, ModalcamError, NoInputError
from modalcam.config import load_config
from tracker import FailedTracking, Failure

SAMPLE_BARE = ROOT / "sample_bare"
HOSTILE = '"]]\n[beam]\nlength_mm = 1 #<script>.avi'


class InThisProcess:
    """The interface of `modalcam.pipeline.pool.WorkerPool`, without processes."""

    def map(self, function, tasks):
        return [function(task) for task in tasks]


POOLS = Pools(InThisProcess(), InThisProcess())


@pytest.fixture
def folder(tmp_path):
    videos = tmp_path / "videos"
    videos.mkdir()
    media.write(videos / "a.avi", media.images(12))
    return videos


def new_studio(folder, **options):
    return Studio(folder, folder.parent / "out", POOLS, **options)


def test_frames_are_counted_and_shown(folder):
    import cv2

    studio = new_studio(folder)
    assert studio.frame_count(0) == 12
    shown = cv2.imdecode(np.frombuffer(studio.frame(0, 11), np.uint8), cv2.IMREAD_UNCHANGED)
    assert shown.shape == (120, 160)
    assert np.corrcoef(shown.ravel(), media.images(12)[11].ravel())[0, 1] > 0.95
    small = cv2.imdecode(np.frombuffer(studio.frame(0, 0, 40), np.uint8), cv2.IMREAD_UNCHANGED)
    assert small.shape == (30, 40)
    assert studio.stand() == Stand(is_read=False)
    assert studio.probes()[0].packets == 12
    assert studio.stand().without_rate == ("a.avi",)
    studio.draft.set_for("a.avi", {"fps": 100, "kind": "patch", "points_px": [[80, 60]]})
    assert studio.stand() == Stand(markers_seen=True)


def test_a_tall_film_is_turned_in_the_list(tmp_path):
    """A column of the film from its top is a row of the picture from its left."""
    import cv2

    folder = tmp_path / "videos"
    folder.mkdir()
    tall = media.images(12, width=40, height=160)
    media.write(folder / "a.avi", tall)
    small = cv2.imdecode(np.frombuffer(new_studio(folder).frame(0, 0, 160), np.uint8), cv2.IMREAD_UNCHANGED)
    assert small.shape == (40, 160)
    assert np.corrcoef(small.ravel(), np.rot90(tall[0]).ravel())[0, 1] > 0.95


@pytest.mark.parametrize(("number", "index"), [(-1, 0), (1, 0), (10**9, 0), (0, 12), (0, -1), (0, 10**12)])
def test_what_does_not_exist_is_refused(folder, number, index):
    studio = new_studio(folder)
    studio.frame_count(0)
    found = studio.frame(number, index)
    assert isinstance(found, Failure)
    assert "there is no" in found.reason


def test_links_are_not_followed(folder, tmp_path):
    media.write(tmp_path / "secret.avi", media.images(12))
    (folder / "link.avi").symlink_to(tmp_path / "secret.avi")
    (folder / "inner").symlink_to(tmp_path, target_is_directory=True)
    studio = new_studio(folder)
    assert [found.file for found in studio.recordings] == ["a.avi"]
    (folder / "a.avi").unlink()
    (folder / "a.avi").symlink_to(tmp_path / "secret.avi")
    found = studio.frame(0, 0)
    assert isinstance(found, Failure)
    assert "no longer there" in found.reason


def test_a_recording_that_was_deleted_is_named(folder):
    studio = new_studio(folder)
    (folder / "a.avi").unlink()
    answers = [studio.frame(0, 0), studio.frame_count(0), studio.detect(0), studio.propose(0)]
    answers.append(studio.track_some(0, 64))
    assert not any(answers)
    assert "no longer there" in studio.missing(0)
    assert all("a.avi: the recording is no longer there" in answer.reason for answer in answers)


def test_a_file_that_is_no_video_is_a_problem(folder):
    (folder / "b.avi").write_text("no video at all\n" * 10)
    studio = new_studio(folder)
    assert "looks like a text file" in studio.frame(1, 0).reason
    assert "looks like a text file" in studio.frame_count(1).reason
    assert "looks like a text file" in studio.probes()[1].problem
    assert studio.frame_count(0) == 12


def test_a_hostile_name_stays_a_name(folder):
    media.write(folder / "x.avi", media.images(12))
    (folder / "x.avi").rename(folder / HOSTILE)
    studio = new_studio(folder)
    number = next(k for k, found in enumerate(studio.recordings) if found.file == HOSTILE)
    assert studio.frame_count(number) == 12
    studio.draft.set_for(HOSTILE, {"fps": 100})
    assert tomllib.loads(studio.draft.text) == {"recordings": [{"file": HOSTILE, "fps": 100}]}


def test_hostile_configurations_are_refused_at_the_start(folder):
    for text in ("a." * 5000 + "b = 1\n", "x = " + "[" * 5000, "[camera]\nfps = 1e999999999\n", "\x00"):
        (folder / "experiment.toml").write_text(text)
        with pytest.raises(ConfigError, match=r"experiment\.toml"):
            new_studio(folder)


def test_two_pages_edit_one_draft(folder):
    studio = new_studio(folder)
    seen = studio.draft.version
    studio.draft.set_for("a.avi", {"fps": 100})
    studio.draft.set_for("a.avi", {"mode": 2})
    assert studio.draft.version == seen + 2
    assert studio.draft.recording("a.avi").fps == 100
    again = new_studio(folder)
    assert again.draft.text == studio.draft.text


def test_results_never_go_into_the_folder_of_recordings(folder):
    with pytest.raises(InputError, match="never written among the recordings"):
        Studio(folder, folder, POOLS)
    other = folder.parent / "other"
    other.mkdir()
    (other / "thesis.txt").write_text("mine")
    with pytest.raises(InputError, match="not results of modalcam"):
        Studio(folder, other, POOLS)
    assert sorted(p.name for p in other.iterdir()) == ["thesis.txt"]
    new_studio(folder).draft.set_for("a.avi", {"fps": 100})
    assert [p.name for p in folder.iterdir()] == ["a.avi"]


def test_a_folder_without_recordings_is_refused(tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(NoInputError, match="no recordings"):
        new_studio(tmp_path / "empty")


def test_one_recording_alone(folder, tmp_path):
    media.write(folder / "b.avi", media.images(12))
    studio = Studio(folder, None, POOLS, only="b.avi")
    assert [found.file for found in studio.recordings] == ["b.avi"]
    studio.draft.set_for("b.avi", {"fps": 5})
    assert not studio.draft.can_be_saved
    assert sorted(p.name for p in folder.iterdir()) == ["a.avi", "b.avi"]
    with pytest.raises(ModalcamError, match="no folder for results"):
        studio.start_run()
    with pytest.raises(InputError, match="not a recording"):
        Studio(folder, None, POOLS, only="c.avi")
    edited = Studio(folder, None, POOLS, only="b.avi", config=tmp_path / "own.toml")
    edited.draft.set_for("b.avi", {"fps": 7})
    edited.draft.save()
    assert tomllib.loads((tmp_path / "own.toml").read_text())["recordings"] == [{"file": "b.avi", "fps": 7}]


def test_the_first_frames_are_tracked_with_the_options_of_the_draft(tmp_path):
    folder = write_decay(tmp_path / "videos")
    studio = new_studio(folder)
    (marker,) = studio.detect(0)
    assert (marker.x_px, marker.y_px) == pytest.approx((36, 16), abs=1.5)
    trial = studio.track_some(0, 70)
    assert trial.tracks.x_px.shape == (70, 1)
    assert np.nanmedian(trial.tracks.sd_x_px) < 0.05
    assert [window.name for window in trial.windows] == [marker.name]
    assert studio.trial(0) == (trial, None)
    studio.expect(0)
    kept, expected = studio.trial(0)
    assert kept is trial
    assert expected.frequency_hz == pytest.approx(10.2, abs=0.1), "the dot oscillates at 10.2 Hz"
    studio.track_some(0, 10**9)
    decay = studio.decay_of_trial(0)
    (mode,) = decay.modes
    assert mode.frequency_hz == pytest.approx(10.2, abs=0.02)
    studio.draft.set_for("take.mkv", {"reject_hz": [10.2]})
    assert studio.decay_of_trial(0).modes == ()
    studio.draft.undo()
    studio.draft.set_for("take.mkv", {"add_hz": [31.0]})
    added = studio.decay_of_trial(0)
    assert len(added.modes) == 1
    assert any("does not determine a mode at 31 Hz" in note for note in added.doubts)
    studio.draft.undo()
    studio.draft.set_for("take.mkv", {"onset_s": 1.39})
    refused = studio.decay_of_trial(0)
    assert "samples lie within onset_s" in refused.doubts[0]
    assert len(refused.curve) == 140
    studio.draft.undo()
    studio.draft.set_for("take.mkv", {"kind": "aruco"})
    failed = studio.track_some(0, 70)
    assert isinstance(failed, FailedTracking)
    assert "ArUco" in failed.reason
    assert studio.trial(0) is None
    assert "there is no test track" in studio.decay_of_trial(0).reason
    assert isinstance(studio.detect(0), Failure)


def test_a_test_track_begins_at_any_frame_and_calls_no_driven_part_a_decay(tmp_path):
    """A dot is driven for 2 s, hardly weaker with time, and then decays at 1 / s, which 200 frames show to a 20th."""
    folder = write_decay(tmp_path / "videos", frames=440, onset_s=2.0, weaker_1_s=0.05)
    studio = new_studio(folder)
    frames = studio.frame_count(0)
    whole = studio.track_some(0, 400).tracks
    driven = studio.track_some(0, 128).tracks
    assert np.array_equal(driven.x_px, whole.x_px[:128])
    found = studio.decay_of_trial(0)
    assert [np.isnan(m.damping_ratio) and "DRIVEN" in m.flags for m in found.modes] == [True]
    assert any(f"hardly decays in frames 0 to 127 of {frames}" in note for note in found.doubts)
    later = studio.track_some(0, 200, 200)
    assert np.array_equal(later.tracks.x_px, whole.x_px[200:])
    assert later.tracks.time_s[0] == whole.time_s[200]
    target = next(m for m in studio.decay_of_trial(0).modes if m.target)
    assert target.damping_ratio == pytest.approx(1.0 / (2.0 * np.pi * 10.2), rel=0.05)
    assert "DRIVEN" not in target.flags
    studio.expect(0)
    assert studio.trial(0)[1].seconds == pytest.approx((frames - 200) * whole.time_s[1])
    assert f"at least 12 frames from frame {frames - 6} on" in studio.track_some(0, 64, frames - 6).reason


def test_the_bare_beam_of_the_sample_is_proposed(tmp_path):
    """The ends in its configuration were set by hand, to about a px; the search takes steps of 2 px."""
    folder = tmp_path / "videos"
    folder.mkdir()
    shutil.copy(SAMPLE_BARE / "mode3.avi", folder)
    found = new_studio(folder).propose(0)
    given = load_config(SAMPLE_BARE / "experiment.toml").markers.line_px
    assert np.all(np.hypot(*(np.array(found.line) - given).T) < 4.0)
    assert found.no_line == ""


def test_what_is_followed_already_is_not_proposed(folder):
    """The only thing that moves is the dot; a run that seeks codes does not follow it."""
    media.write(folder / "a.avi", media.images(40))
    studio = new_studio(folder)
    assert studio.propose(0).points == ()
    studio.draft.set_for("a.avi", {"kind": "aruco"})
    (point,) = studio.propose(0).points
    assert point == pytest.approx((80, 60), abs=8)
    studio.draft.set_for("a.avi", {"kind": "patch", "points_px": [point]})
    assert studio.propose(0).points == ()


def test_a_test_track_tells_how_far_it_is_and_can_be_cancelled(tmp_path):
    folder, seen = write_decay(tmp_path / "videos"), []

    class Watched(InThisProcess):
        def map(self, function, tasks):
            if seen:
                studio.cancel_trial()
            results = super().map(function, tasks)
            seen.append(studio.frames_tracked())
            return results

    studio = Studio(folder, None, Pools(InThisProcess(), Watched()))
    assert studio.track_some(0, 70)
    assert seen == [(64, 70)], "counted every eight frames"
    assert "was cancelled" in studio.track_some(0, 70).reason


def test_windows_are_drawn_as_a_run_chooses_them(tmp_path):
    folder = write_decay(tmp_path / "videos")
    studio = new_studio(folder)
    studio.draft.set_for("take.mkv", {"kind": "patch", "points_px": [[36, 16]]})
    (size,) = studio.window_sizes(0)
    assert f"Patch m1 is a window of {size:.0f} px around (36, 16)." in studio.track_some(0, 64).tracks.notes
    assert f'width="{size:.2f}"' in overlay(studio.draft.recording("take.mkv"), (), (size,))
    studio.draft.set_for("take.mkv", {"points_px": [[900, 16]]})
    assert studio.window_sizes(0) == ()


def test_options_that_contradict_each_other_are_told(folder):
    studio = new_studio(folder)
    studio.draft.set_for("a.avi", {"kind": "patch"})
    assert "set points_px" in options_error(studio.draft, "a.avi")
    assert "set points_px" in studio.track_some(0, 64).reason
    studio.draft.undo()
    assert options_error(studio.draft, "a.avi") == ""

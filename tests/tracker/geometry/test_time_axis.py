"""The time axis: priority of its sources, rejected inputs, notes."""

from fractions import Fraction

import numpy as np
import pytest
from support import camera_files as files
from support import tracker_media as media

from tracker.geometry.time_axis import resolve_time_axis
from tracker.settings import TrackerSettings
from tracker.track import track


def resolve(stamps, *, base=Fraction(1, 50), rate=Fraction(50), header=None, user=None, ppm=None):
    return resolve_time_axis(
        stamps, time_base=base, container_rate=rate, header_rate=header, user_fps=user, rate_sd_ppm=ppm
    )


def test_the_users_rate_has_priority_and_the_ratio_is_noted():
    axis = resolve(list(range(5)), header=Fraction(240), user=Fraction(1000))
    assert axis.time_axis.source == "user"
    assert axis.time_s.tolist() == [0.0, 0.001, 0.002, 0.003, 0.004]
    assert any("20 times slower" in note for note in axis.time_axis.notes)
    assert not axis.time_axis.is_playback_guess


def test_the_camera_header_has_priority_over_the_container():
    axis = resolve(list(range(3)), base=Fraction(1, 35087), header=Fraction(35087))
    assert axis.time_axis.source == "camera header"
    assert axis.time_axis.fps_recorded == 35087


@pytest.mark.parametrize(
    ("stamps", "given", "ppm"),
    [
        ([0, 1, 2, 3], {"user": Fraction(1000)}, 0.0),
        ([0, 1, 2, 3], {"header": Fraction(50)}, 50.0),
        ([0, 1, 2, 3], {}, 1000.0),
        ([0, 20, 30, 50], {"base": Fraction(1, 500)}, 1000.0),
    ],
)
def test_the_uncertainty_of_the_rate_depends_on_its_source(stamps, given, ppm):
    assert resolve(stamps, **given).time_axis.rate_sd_ppm == ppm
    assert resolve(stamps, **given, ppm=7.0).time_axis.rate_sd_ppm == 7.0


def test_the_container_rate_is_used_last_with_a_warning():
    axis = resolve([7, 8, 9, 10])
    assert axis.time_axis.is_playback_guess
    assert axis.time_s[0] == 0.0
    assert "50 fps is a playback rate" in axis.time_axis.notes[0]
    assert "--fps" in axis.time_axis.notes[0]


def test_fractional_rates_are_exact():
    rate = Fraction(60000, 1001)
    axis = resolve(list(range(60001)), base=1 / rate, rate=rate)
    assert axis.time_s[60000] == 1001.0


def test_steps_within_one_tick_are_a_constant_rate():
    stamps = [round(k * 1000 / 60) for k in range(100)]
    axis = resolve(stamps, base=Fraction(1, 1000), rate=Fraction(60))
    assert axis.time_axis.source == "container"
    assert np.allclose(np.diff(axis.time_s), 1 / 60)


def test_uneven_time_stamps_are_used_as_times():
    stamps = [100, 140, 160, 200, 220]
    axis = resolve(stamps, base=Fraction(1, 1000), rate=Fraction(36))
    assert axis.time_axis.source == "time stamps"
    assert axis.time_axis.fps_recorded is None
    assert np.allclose(axis.time_s, [0, 0.04, 0.06, 0.1, 0.12])
    assert "uneven" in axis.time_axis.notes[0]


def test_uneven_time_stamps_with_a_given_rate_are_missing_frames():
    stamps = [0, 40, 60, 100, 120, 160, 180]
    axis = resolve(stamps, base=Fraction(1, 1000), rate=Fraction(36), user=Fraction(500))
    assert np.allclose(axis.time_s * 500, [0, 2, 3, 5, 6, 8, 9])
    assert any("not in the file" in note for note in axis.time_axis.notes)


@pytest.mark.parametrize(
    ("stamps", "base", "words"),
    [
        ([0, 1, None, 3], Fraction(1, 50), "no time stamp"),
        ([0, 1, 3, 2, 4, 8, 12], Fraction(1, 50), "do not increase"),
        ([0, 0, 1, 1, 2, 2, 3], Fraction(1, 1000), "too coarse"),
        ([0, 2, 3, 5, 6, 8, 9], Fraction(1, 1000), "too coarse"),
        ([0, 1, 2], None, "no time base"),
    ],
)
def test_invalid_time_stamps_are_rejected_unless_the_rate_is_given(stamps, base, words):
    failed = resolve(stamps, base=base)
    assert not failed
    assert words in failed.reason
    assert "--fps" in failed.reason
    given = resolve(stamps, base=base, user=Fraction(2000))
    assert np.allclose(given.time_s[-1], (len(stamps) - 1) / 2000)


@pytest.mark.parametrize("fps", [0, -50, float("nan"), float("inf")])
def test_invalid_rates_are_rejected(fps):
    with pytest.raises(ValueError, match="fps: expected frames per second, a positive number"):
        TrackerSettings(fps=fps)


def test_matroska_at_2000_fps_needs_the_rate(tmp_path):
    path = media.write(tmp_path / "a.mkv", media.images(), codec="ffv1", rate=2000)
    failed = track(path, TrackerSettings(kind="blob"), recording="a")
    assert not failed
    assert "too coarse" in failed.reason
    tracks = track(path, TrackerSettings(kind="blob", fps=Fraction(2000)), recording="a")
    assert tracks.time_s[-1] == pytest.approx(39 / 2000)


def test_a_variable_rate_file_uses_its_time_stamps(tmp_path):
    pts = [k for k in range(60) if k % 3 != 1][:40]
    path = media.write(
        tmp_path / "a.mp4", media.images(), codec="libx264", pts=pts, time_base=Fraction(1, 50)
    )
    tracks = track(path, TrackerSettings(kind="blob"), recording="a")
    assert tracks.time_axis.source == "time stamps"
    assert np.allclose(tracks.time_s, (np.array(pts) - pts[0]) / 50, atol=1e-4)


def test_the_playback_warning_is_in_the_tracks(tmp_path):
    path = media.write(tmp_path / "a.mp4", media.images(), codec="libx264")
    tracks = track(path, TrackerSettings(kind="blob"), recording="a")
    assert tracks.time_axis.is_playback_guess
    assert tracks.time_s[1] == pytest.approx(0.02)


def tracked(path, fps=None):
    return track(path, TrackerSettings(kind="blob", fps=fps), recording=path.name)


def test_time_starts_at_zero_whatever_the_first_time_stamp(tmp_path):
    for name, codec in (("a.mkv", "ffv1"), ("a.mp4", "libx264")):
        pts = range(75, 115)
        path = media.write(tmp_path / name, media.images(), codec=codec, pts=pts, time_base=Fraction(1, 50))
        tracks = tracked(path)
        assert tracks.time_s[0] == 0.0
        assert np.allclose(np.diff(tracks.time_s), 0.02)
        assert tracks.time_axis.source == "container"


def test_time_stamps_rounded_to_milliseconds_are_a_constant_rate(tmp_path):
    tracks = tracked(media.write(tmp_path / "a.mkv", media.images(), codec="ffv1", rate=60))
    assert tracks.time_axis.source == "container"
    assert np.allclose(np.diff(tracks.time_s), 1 / 60, atol=1e-12)


def test_unordered_time_stamps_are_rejected_unless_the_rate_is_given(tmp_path):
    path = media.write(tmp_path / "a.avi", media.images(), codec="libx264", options={"bf": "2"})
    failed = tracked(path)
    assert not failed
    assert "do not increase" in failed.reason
    assert tracked(path, Fraction(1000)).time_s[-1] == pytest.approx(0.039)


def test_a_stream_without_time_stamps_needs_the_rate(tmp_path):
    """A raw H.264 stream contains no time stamps, whatever its file name."""
    path = tmp_path / "a.mp4"
    media.write(path, media.images(), codec="libx264", options={"bf": "0"}, container_format="h264")
    failed = tracked(path)
    assert not failed
    assert "40 of 40 frames have no time stamp" in failed.reason
    assert "--fps" in failed.reason
    tracks = tracked(path, Fraction(1000))
    assert tracks.time_axis.source == "user"
    assert np.array_equal(tracks.time_s, np.arange(40) / 1000)


def test_frames_hidden_by_an_edit_list_are_read(tmp_path):
    options = {"bf": "0", "g": "12"}
    path = media.write(tmp_path / "a.mp4", media.images(48), codec="libx264", rate=240, options=options)
    data = bytearray(path.read_bytes())
    entry = data.index(b"elst") + 12
    data[entry + 4 : entry + 8] = (15360 // 10).to_bytes(
        4, "big"
    )  # players begin 0.1 s later: 24 of 48 frames
    path.write_bytes(bytes(data))
    tracks = tracked(path)
    assert len(tracks.time_s) == 48
    assert tracks.time_axis.fps_container == 240
    assert np.allclose(np.diff(tracks.time_s), 1 / 240)


def test_repeated_frames_give_a_note(tmp_path):
    repeated = [image for image in media.images(20) for _ in range(2)]
    tracks = tracked(media.write(tmp_path / "a.mkv", repeated, codec="ffv1"), Fraction(240))
    assert any("20 of 40 frames repeat" in note and "(user)" in note for note in tracks.notes)


def test_the_ratio_of_rates_is_noted_for_files(tmp_path):
    tracks = tracked(media.write(tmp_path / "a.mkv", media.images(), codec="ffv1"), Fraction(1000))
    assert (tracks.time_axis.fps_recorded, tracks.time_axis.fps_container) == (1000, 50)
    assert any("20 times slower" in note for note in tracks.time_axis.notes)


def test_a_camera_header_next_to_the_video_sets_the_time_axis(tmp_path):
    path = media.write(tmp_path / "a.avi", media.images())
    files.write_photron(tmp_path / "a.cih", media.images(40), bits=8, rate=12500)
    tracks = tracked(path)
    assert tracks.time_axis.source == "camera header"
    assert tracks.time_s[-1] == pytest.approx(39 / 12500)
    assert tracks.time_axis.fps_container == 50
    assert tracked(path, Fraction(500)).time_axis.source == "user"


def test_a_gif_has_the_rate_of_its_frame_delays(tmp_path):
    tracks = tracked(files.write_gif(tmp_path / "a.gif", media.images()))
    assert tracks.time_axis.is_playback_guess
    assert np.allclose(np.diff(tracks.time_s), 0.02)


def test_a_jump_of_the_time_stamps_does_not_add_millions_of_frames():
    stamps = [*range(0, 400, 10), 10**9]
    axis = resolve(stamps, base=Fraction(1, 1000), rate=Fraction(36), user=Fraction(500))
    assert axis.time_s[-1] == 40 / 500
    assert any("jump" in note for note in axis.time_axis.notes)


def test_jitter_of_a_phone_recording_is_a_constant_rate():
    """Time stamps of a real clip: steps of 2997 and 3007 of 1/90000 s, whatever rate the phone recorded at."""
    steps = np.where(np.arange(300) % 29 == 0, 3007, 2997)
    stamps = [0, *np.cumsum(steps).tolist()]
    axis = resolve_time_axis(
        stamps,
        time_base=Fraction(1, 90000),
        container_rate=Fraction(30),
        header_rate=None,
        user_fps=None,
    )
    assert axis.time_axis.source == "container"
    assert "30 fps is a playback rate" in axis.time_axis.notes[0]

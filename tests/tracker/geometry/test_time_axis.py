"""The time axis: priority of its sources, rejected inputs, notes."""

from fractions import Fraction

import numpy as np
import pytest
from kit import camera_files as files
from kit import films as media
from kit.camera_files import time_axis_of

from tracker import TrackerSettings, track
from tracker.geometry import resolve_time_axis


def resolve(stamps, *, base=Fraction(1, 50), rate=Fraction(50), header=None, user=None, ppm=None):
    return resolve_time_axis(
        stamps, time_base=base, container_rate=rate, header_rate=header, user_fps=user, rate_sd_ppm=ppm
    )


def tracked(path, fps=None):
    # The exposure is given, so that it is not estimated.
    return track(path, TrackerSettings(kind="blob", fps=fps, exposure_s=1e-5), recording=path.name)


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
    failed = time_axis_of(path)
    assert not failed
    assert "too coarse" in failed.reason
    axis = time_axis_of(path, Fraction(2000))
    assert axis.time_s[-1] == pytest.approx(39 / 2000)


def test_a_variable_rate_file_uses_its_time_stamps(tmp_path):
    pts = [k for k in range(60) if k % 3 != 1][:40]
    path = media.write(
        tmp_path / "a.mp4", media.images(), codec="libx264", pts=pts, time_base=Fraction(1, 50)
    )
    tracks = tracked(path)
    assert tracks.time_axis.source == "time stamps"
    assert np.allclose(tracks.time_s, (np.array(pts) - pts[0]) / 50, atol=1e-4)


def test_time_starts_at_zero_whatever_the_first_time_stamp(tmp_path):
    for name, codec in (("a.mkv", "ffv1"), ("a.mp4", "libx264")):
        pts = range(75, 115)
        path = media.write(tmp_path / name, media.images(), codec=codec, pts=pts, time_base=Fraction(1, 50))
        tracks = tracked(path)
        assert tracks.time_s[0] == 0.0
        assert np.allclose(np.diff(tracks.time_s), 0.02)
        assert tracks.time_axis.source == "container"


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
    failed = time_axis_of(path)
    assert not failed
    assert "40 of 40 frames have no time stamp" in failed.reason
    assert "--fps" in failed.reason
    axis = time_axis_of(path, Fraction(1000))
    assert axis.time_axis.source == "user"
    assert np.array_equal(axis.time_s, np.arange(40) / 1000)


def test_the_ratio_of_rates_is_noted_for_files(tmp_path):
    axis = time_axis_of(media.write(tmp_path / "a.mkv", media.images(), codec="ffv1"), Fraction(1000))
    assert (axis.time_axis.fps_recorded, axis.time_axis.fps_container) == (1000, 50)
    assert any("20 times slower" in note for note in axis.time_axis.notes)


def test_a_gif_has_the_rate_of_its_frame_delays(tmp_path):
    # Its colours are read as gray levels of 16 bit, for which other kernels are compiled.
    tracks = tracked(files.write_gif(tmp_path / "a.gif", media.images()))
    assert tracks.time_axis.is_playback_guess
    assert np.allclose(np.diff(tracks.time_s), 0.02)


def test_a_jump_of_the_time_stamps_is_refused():
    """No frame is placed millions of frame intervals away, and none where the stamps say that it was not."""
    stamps = [*range(0, 400, 10), 10**9]
    for user in (None, Fraction(500)):
        failed = resolve(stamps, base=Fraction(1, 1000), rate=Fraction(36), user=user)
        assert not failed
        assert "jump" in failed.reason
        assert "between frames 39 and 40" in failed.reason


def test_jitter_of_a_phone_recording_is_a_constant_rate():
    """Time stamps of a real clip: steps of 2997 and 3007 of 1/90000 s, whatever rate the phone recorded at."""
    steps = np.where(np.arange(300) % 29 == 0, 3007, 2997)
    stamps = [0, *np.cumsum(steps).tolist()]
    axis = resolve(stamps, base=Fraction(1, 90000), rate=Fraction(30))
    assert axis.time_axis.source == "container"
    assert "30 fps is a playback rate" in axis.time_axis.notes[0]


# Frames that a phone or converter left out of a film of 600 fps that plays at 30: the true indices of those it kept.
KEPT = {
    "every third missing": [k for k in range(240) if k % 3 != 2],
    "every second missing": list(range(0, 240, 2)),
    "one missing": [k for k in range(120) if k != 50],
    "a gap of 90": [*range(60), *range(150, 240)],
    "two of five": [k for k in range(240) if k % 5 in (0, 2)],
    "at random": sorted(np.random.default_rng(4).choice(400, 200, replace=False).tolist()),
}


@pytest.mark.parametrize("kept", KEPT.values(), ids=KEPT)
@pytest.mark.parametrize("ticks_per_s", [1000, 15360, 90000])
def test_missing_frames_are_found_from_stamps_in_any_ticks(kept, ticks_per_s):
    """Stamps are rounded to whole ticks: 33, 67 and 66 ms for one and two intervals of 33.33 ms."""
    stamps = [round(k * ticks_per_s / 30) for k in kept]
    axis = resolve(stamps, base=Fraction(1, ticks_per_s), rate=Fraction(30), user=Fraction(600))
    true_index = np.array(kept) - kept[0]
    if np.all(np.diff(kept) == 2):
        true_index = (
            true_index // 2
        )  # evenly spaced stamps cannot show it: the rate is that of the frames in the file
    assert np.allclose(axis.time_s * 600, true_index, atol=1e-9)


@pytest.mark.parametrize("seed", range(40))
def test_random_stamps_give_the_true_times_or_none(seed):
    """Intervals of random length, some frames missing, the time of each rounded down to a tick."""
    rng = np.random.default_rng([11, seed])
    interval = float(rng.uniform(3.0, 60.0))
    true_index = np.cumsum(rng.choice([1, 1, 1, 2, 3, 40], 300))
    stamps = np.floor(true_index * interval + rng.uniform()).astype(int).tolist()
    axis = resolve(stamps, base=Fraction(1, 1000), rate=None, user=Fraction(600))
    # Below five ticks an interval is not told from its neighbours for certain: then none.
    assert axis or interval < 5.0
    if axis:
        assert np.allclose(axis.time_s * 600, true_index - true_index[0], atol=1e-9)


def test_stamps_that_contradict_a_given_rate_are_refused():
    """A rate that falls from 60 to 30 fps within the film: no constant rate is right."""
    steps = np.linspace(1500, 3000, 200)
    stamps = np.rint(np.cumsum(steps)).astype(int).tolist()
    failed = resolve(stamps, base=Fraction(1, 90000), rate=Fraction(40), user=Fraction(600))
    assert not failed
    assert "contradict" in failed.reason
    assert "leave out fps" in failed.reason
    times = resolve(stamps, base=Fraction(1, 90000), rate=Fraction(40))
    assert times.time_axis.source == "time stamps"
    assert np.allclose(times.time_s, (np.array(stamps) - stamps[0]) / 90000, atol=1e-12)


def test_jitter_of_stamps_does_not_contradict_a_given_rate():
    jitter = np.random.default_rng(2).uniform(-0.15, 0.15, 400)
    stamps = np.rint((np.arange(400) + jitter) * 3000).astype(int).tolist()
    axis = resolve(stamps, base=Fraction(1, 90000), rate=Fraction(30), user=Fraction(600))
    assert np.allclose(axis.time_s * 600, np.arange(400))


# A phone's slow motion: frames in each part and their rate, and the resolution of the time stamps.
SLOW_MOTION = [(45, 30), (179, 960), (45, 30)]


def slow_motion(ticks_per_s, parts=SLOW_MOTION):
    """True times and stamps of the frames."""
    steps = np.concatenate([np.full(count, 1.0 / rate) for count, rate in parts])
    time_s = np.concatenate([[0.0], np.cumsum(steps)[:-1]])
    return time_s, np.rint(time_s * ticks_per_s).astype(int).tolist()


@pytest.mark.parametrize("ticks_per_s", [15360, 90000, 1000000])
@pytest.mark.parametrize("user", [None, Fraction(960), Fraction(30)])
def test_each_frame_of_a_changing_rate_keeps_its_time(ticks_per_s, user):
    """Whichever part the given rate names; rounding of single stamps to ticks is removed."""
    time_s, stamps = slow_motion(ticks_per_s)
    axis = resolve(stamps, base=Fraction(1, ticks_per_s), rate=Fraction(83), user=user)
    assert axis.time_axis.fps_recorded is None
    note = " ".join(axis.time_axis.notes)
    assert "rate changes inside the file" in note
    assert "at 960 fps" in note
    assert "frames 0 to 45 at 30 fps" in note
    # A line through 45 and more stamps that are each rounded by half a tick at most.
    assert np.allclose(axis.time_s, time_s, rtol=1e-4, atol=0.6 / ticks_per_s)
    slow = np.r_[0:45, 225:269]
    if user == 30:
        # Both parts at 30 fps; the frame between two parts belongs to both.
        assert np.array_equal(np.flatnonzero(axis.used), np.r_[0:46, 224:269])
    else:
        assert np.array_equal(np.flatnonzero(~axis.used), slow)


def test_a_given_rate_applies_to_the_part_that_is_most_of_the_file():
    """Slowed down eight times: 30 and 960 fps play at 3.75 and 120; the rate given is that of the 900 frames."""
    time_s, stamps = slow_motion(90000, [(45, 3.75), (900, 120), (45, 3.75)])
    axis = resolve(stamps, base=Fraction(1, 90000), rate=Fraction(25), user=Fraction(960))
    assert np.allclose(axis.time_s, time_s / 8, atol=1e-5)
    assert "fps given are those of frames 45 to 945" in axis.time_axis.notes[-1]


def test_a_given_rate_that_no_part_has_is_refused():
    _, stamps = slow_motion(90000)
    failed = resolve(stamps, base=Fraction(1, 90000), rate=Fraction(83), user=Fraction(240))
    assert not failed
    assert "240 fps is the rate of none of these parts" in failed.reason
    assert "frames 45 to 224 at 960 fps" in failed.reason


def test_a_gap_does_not_make_a_playback_rate_real():
    """One gap in evenly spaced stamps says which frames are missing, but not how fast the camera was."""
    stamps = [512 * k for k in (*range(40), *range(55, 90))]
    axis = resolve(stamps, base=Fraction(1, 15360), rate=Fraction(30 * 75, 90))
    assert axis.time_axis.is_playback_guess
    assert axis.time_axis.fps_recorded == 30
    assert np.allclose(axis.time_s * 30, [*range(40), *range(55, 90)])
    assert "gaps of 15 frames" in axis.time_axis.notes[-1]


def test_frames_missing_from_an_avi_are_found_although_a_tick_is_a_frame():
    stamps = [0, 1, 2, 3, 5, 6, 7, 8, 9, 11, *range(12, 40)]
    for user, rate in ((None, 50), (Fraction(500), 500)):
        axis = resolve(stamps, base=Fraction(1, 50), rate=Fraction(50), user=user)
        assert np.allclose(axis.time_s * rate, stamps)


def test_a_film_with_missing_frames_has_the_true_times_in_matroska(tmp_path):
    """The dot swings as 5 sin(0.5 k) px in true frame k: its positions at the times found show them to be right."""
    kept = [k for k in range(120) if k % 3 != 2]
    images = media.images(120)
    path = media.write(
        tmp_path / "a.mkv", [images[k] for k in kept], codec="ffv1", pts=kept, time_base=Fraction(1, 30)
    )
    tracks = tracked(path, Fraction(600))
    assert np.allclose(tracks.time_s * 600, np.array(kept), atol=1e-9)
    x = tracks.x_px[:, 0] - 79.5
    swing = 5.0 * np.sin(0.5 * 600 * tracks.time_s)
    # The noise of 2 levels on a dot of contrast 160 is 0.01 px; half a pixel of offset is that of the generator.
    assert np.ptp(x - swing) < 0.2

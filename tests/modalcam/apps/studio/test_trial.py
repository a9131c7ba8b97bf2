"""What a test track shows: the window that follows a marker, what a run would give, and what to change."""

from dataclasses import replace
from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import pytest
from kit import scenes
from kit.tracks import decoded, sample_tracks, tracks_of
from support.paths import REALDATA, REALDATA_ABSENT

from modal_id import IdentifySettings, identify
from modal_id.posterior import modal_bound
from modalcam.apps.studio import (
    ExpectedTask,
    Trial,
    TrialRow,
    TrialTask,
    advice,
    detected,
    evenly,
    expected_intervals,
    followed_windows,
    summarised,
    trial_track,
)
from tracker import Failure, TrackerSettings, displacement_series, track
from tracker.geometry import TimeAxis

SD_PX, FPS, FRAMES = 0.01, 500.0, 300
LOSSLESS = {"lossy": False, "predictive": False}
MJPG = {"lossy": True, "predictive": False}
H264 = {"lossy": True, "predictive": True}
FORKS = REALDATA / "ordinary"


def oscillating(amplitude_px, frequency_hz=40.0, markers=("m1",), frames=FRAMES, zeta=0.0, codec=LOSSLESS):
    """Tracks of markers that oscillate in x with known standard deviation."""
    rng = np.random.default_rng(3)
    time_s = np.arange(frames) / FPS
    phase = 2 * np.pi * frequency_hz * time_s
    size = np.broadcast_to(amplitude_px, len(markers))
    swing = np.multiply.outer(np.exp(-zeta * phase) * np.cos(phase + 0.4), size)
    return tracks_of(
        100.0 + swing + rng.normal(0.0, SD_PX, swing.shape),
        50.0 + rng.normal(0.0, SD_PX, swing.shape),
        fps=FPS,
        sd_px=SD_PX,
        markers=tuple(markers),
        decode=decoded(frames, **codec),
    )


def test_the_expected_interval_is_that_of_a_sinusoid_in_white_noise():
    """Rife and Boorstyn (1974): var(f) = 6 sd^2 / (pi^2 A^2 T^2 N).

    30 px and 160 cycles: the errors of the template and the drift, which the formula leaves out, add under 5 %, as does
    the decay. As in a run, the noise is that of the 24 lines beside the mode: 10 %. Here and below, 2.5 times that.
    """
    found = expected_intervals(ExpectedTask(oscillating(30.0), 2000, (5e-5,)))
    (row,) = found.rows
    length_s = 2000 / FPS
    classical_hz = np.sqrt(6.0 / 2000) * SD_PX / (np.pi * 30.0 * length_s)
    assert found.frequency_hz == pytest.approx(40.0, abs=0.02)
    assert found.amplitude_px == pytest.approx(30.0, rel=0.01)
    assert found.seconds == pytest.approx(length_s)
    assert row.frequency_hz == pytest.approx(1.645 * classical_hz, rel=0.25)


def test_the_expected_interval_is_that_of_a_decay_in_white_noise():
    """Cramer-Rao bound of a decay to 5 % of 30 px."""
    (row,) = expected_intervals(ExpectedTask(oscillating(30.0, zeta=3e-3), 2000, (3e-3,))).rows
    time_s = np.arange(2000) / FPS
    bound = modal_bound(time_s, 40.0, 3e-3, np.array([30.0]), 0.4, np.array([SD_PX]))
    assert row.frequency_hz == pytest.approx(1.645 * bound.frequency_sd_hz, rel=0.25)
    assert row.damping == pytest.approx(1.645 * bound.damping_sd, rel=0.25)


def test_markers_add_their_information():
    """Four equal markers halve a standard deviation; the noise of each is estimated, to 14 % in the ratio."""
    one, four = (
        expected_intervals(ExpectedTask(oscillating(30.0, markers=names), 2000, (3e-3,))).rows[0]
        for names in (("m1",), ("m1", "m2", "m3", "m4"))
    )
    assert one.damping / four.damping == pytest.approx(2.0, rel=0.35)


@pytest.mark.parametrize("codec", [LOSSLESS, MJPG, H264])
@pytest.mark.parametrize("amplitude_px", [0.5, 5.0])
def test_a_run_gives_what_was_expected(amplitude_px, codec):
    """The whole record against its first 128 frames: the noise of each is estimated, to 14 % in the ratio."""
    motion = {"amplitude_px": amplitude_px, "zeta": 2e-3, "codec": codec}
    (row,) = expected_intervals(ExpectedTask(oscillating(frames=128, **motion), 1500, (2e-3,))).rows
    whole = displacement_series(oscillating(frames=1500, **motion), unit="px")
    target = identify(whole, IdentifySettings(onset_s=0.0)).target
    low, high = target.damping_interval()
    assert row.damping == pytest.approx(0.5 * (high - low), rel=0.35)


def test_small_motions_from_h264_are_expected_with_the_errors_of_the_codec():
    """docs/studies/films.md: about five times the interval of noise alone for motions below 1 px."""
    lossless, h264 = (
        expected_intervals(ExpectedTask(oscillating(0.5, codec=codec), 1500, (2e-3,))).rows[0]
        for codec in (LOSSLESS, H264)
    )
    assert 2.5 < h264.damping / lossless.damping < 10.0


@pytest.mark.slow  # the same with synthetic tracks is above
@pytest.mark.skipif(not FORKS.is_dir(), reason=REALDATA_ABSENT)
@pytest.mark.parametrize(
    ("file", "points_px"),
    [
        ("fork32_beside_machine_fps250_repeated_last_frames.mp4", ((168.0, 46.0), (222.0, 52.0))),
        ("fork64_on_bricks_fps250.mp4", ((456.0, 176.0), (554.0, 179.0))),
        ("fork128_on_bricks_fps250.mp4", ((451.0, 198.0), (530.0, 201.0))),
    ],
)
def test_a_filmed_fork_gives_what_its_test_track_says(file, points_px):
    """H.264, motions of 1.9, 2.1 and 0.8 px; measured: 1.02, 1.15 and 1.64 of the width in the run."""
    settings = TrackerSettings(fps=250.0, kind="patch", points_px=points_px)
    trial = trial_track(TrialTask(FORKS / file, "fork", settings, 128))
    series = displacement_series(track(FORKS / file, settings, recording="fork"))
    target = identify(series, IdentifySettings(seed=1)).target
    task = ExpectedTask(trial.tracks, series.time_s.size, (target.damping_ratio,))
    (row,) = expected_intervals(task).rows
    low, high = target.damping_interval()
    assert 0.5 < row.damping / (0.5 * (high - low)) < 2.0


@pytest.mark.parametrize(
    ("amplitude_px", "frequency_hz", "reason"),
    [(0.0, 40.0, "rises above the noise"), (5.0, 3.0, "shorter than three cycles")],
)
def test_without_a_motion_there_is_no_prediction(amplitude_px, frequency_hz, reason):
    found = expected_intervals(ExpectedTask(oscillating(amplitude_px, frequency_hz), 2000))
    assert isinstance(found, Failure)
    assert reason in found.reason


def test_the_rate_of_playback_gives_no_prediction():
    tracks = replace(oscillating(5.0), time_axis=TimeAxis("container", Fraction(50)))
    assert "the recorded rate is not known" in expected_intervals(ExpectedTask(tracks, 2000)).reason


def textured(seed, size=96):
    """Smooth texture whose spectrum ends well below the limit of the grid: it can be shifted without an error."""
    rng = np.random.default_rng(seed)
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(size), np.fft.fftfreq(size)))
    spectrum = np.fft.fft2(rng.normal(size=(size, size))) * (frequency < 0.15)
    texture = np.fft.ifft2(spectrum).real
    return 120.0 + 40.0 * texture / texture.std()


def shifted(image, dx):
    phase = np.exp(-2j * np.pi * np.fft.fftfreq(image.shape[1]) * dx)
    return np.fft.ifft(np.fft.fft(image, axis=1) * phase, axis=1).real


@pytest.mark.parametrize(("fixed_rows", "least", "most"), [(0, 0.0, 0.03), (48, 0.35, 1.5)])
def test_what_does_not_move_with_the_marker_is_not_explained(fixed_rows, least, most):
    """A window of one texture, and one of which half is a second texture at rest, moved by 3 px either way.

    Rounding to gray levels leaves 0.3 of a contrast of 40. The half at rest, correlated over about 3 px, changes by
    about its own contrast over half of the area.
    """
    moving, still = textured(1), textured(2)
    swing = 3.0 * np.sin(0.7 * np.arange(40))
    images = []
    for dx in swing:
        image = shifted(moving, dx)
        image[:fixed_rows] = still[:fixed_rows]
        images.append(np.clip(np.rint(image), 0, 255).astype(np.uint8))
    tracks = SimpleNamespace(
        markers=("m1",), time_s=np.arange(40), x_px=48.0 + swing[:, None], y_px=np.full((40, 1), 48.0)
    )
    (window,) = followed_windows(tracks, [*images[:5], None, *images[6:]], (0,))
    assert least <= window.unexplained <= most
    assert window.mean_png.startswith(b"\x89PNG")
    assert window.residual_png.startswith(b"\x89PNG")


def test_blur_follows_from_the_exposure():
    """A step between frames and the exposed share of their distance in time."""
    tracks = oscillating(30.0)
    step = 2 * 30.0 * np.sin(np.pi * 40.0 / FPS)  # the largest chord of the motion
    (row,) = summarised(Trial(tracks, (), 0.25)).rows
    assert row.step_px == pytest.approx(step, rel=0.01)
    assert row.blur_px == pytest.approx(0.25 * row.step_px)
    (unknown,) = summarised(Trial(tracks, (), None)).rows
    assert unknown.as_text()[5] == "–"


GOOD = TrialRow("m1", 0.004, 0.004, 3.0, 1.0, 0.1, 0.0, 0.05)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({}, None),
        ({"sd_px": 0.08}, "more contrast"),
        ({"lost": 0.1}, "lost in some frames"),
        ({"blur_px": 8.0}, "shorten the exposure"),
        ({"step_px": 5.0, "blur_px": float("nan")}, "give the exposure time"),
        ({"unexplained": 0.6}, "smaller or a round window"),
        ({"motion_px": 0.001}, "farther from the clamp"),
    ],
)
def test_each_problem_of_a_marker_has_its_advice(change, words):
    found = advice([GOOD, replace(GOOD, name="m2", **change)])
    assert len(found) == (words is not None)
    assert words is None or (found[0].startswith("m2: ") and words in found[0])


def test_markers_are_chosen_evenly_with_both_ends():
    assert evenly(3, 6) == (0, 1, 2)
    assert evenly(101, 6) == (0, 20, 40, 60, 80, 100)


def test_the_sd_of_a_station_is_that_across_its_line():
    """A line at 0.1 rad to the pixels, followed to 0.01 px across: along the pixels, its error is a tenth of that."""
    tracks = sample_tracks()
    sd_x, sd_y = (np.full_like(tracks.x_px, 0.01 * part) for part in (np.sin(0.1), np.cos(0.1)))
    line = replace(tracks, sd_x_px=sd_x, sd_y_px=sd_y, correlation_xy=-np.ones_like(sd_x))
    rows = summarised(Trial(line, (), None)).rows
    assert [row.sd_px for row in rows] == pytest.approx([0.01] * len(rows))


@pytest.mark.parametrize("kind", ["blob", "aruco"])
def test_detected_markers_stand_where_they_are_in_the_first_frame(tmp_path, kind):
    """Each is detected where it is sharpest, up to 6 px away."""
    scene = scenes.Recording(kind, frames=32, markers=3, width_px=240, height_px=90, amplitude_px=6.0)
    scene.write(tmp_path / "film.mkv")
    settings = TrackerSettings(kind=kind, fps=scenes.FPS, dictionary="DICT_4X4_50")
    markers = detected(TrialTask(tmp_path / "film.mkv", "film.mkv", settings, 32))
    assert [m.frame for m in markers] == [0, 0, 0]
    places = np.array([(m.x_px, m.y_px) for m in markers])
    assert np.hypot(*(places - scene.truth_px()[0]).T).max() < 1.0, "detection is accurate to a pixel"

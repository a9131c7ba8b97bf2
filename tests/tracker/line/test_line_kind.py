"""The kind "line" from a file to modes, its settings, and what it refuses."""

from fractions import Fraction

import numpy as np
import pytest
from kit.lines import SMALL

from benchmarks.line_scenes import LineScene
from modal_id import IdentifySettings, identify
from modalcam.inputs import read_table, tracks_from_table
from modalcam.tables import write_tracks
from sim.render import write_video
from tracker import Failure, TrackerSettings, displacement_series, track
from tracker.line import calibrate, find_line

FPS, RATE, ZETA = 500.0, 0.0371, 0.008
SCENE = LineScene(
    **SMALL | {"tip_px": (4.0, 0.0), "clamp_px": (26.3, 16.6)},
    cycles_per_frame=(RATE, 0.2),
    decay=2.0 * np.pi * RATE * ZETA,
    angle_rad=0.5 * np.pi - 0.2,
)
FRAMES = 160


@pytest.fixture(scope="module")
def film(tmp_path_factory):
    path = tmp_path_factory.mktemp("line") / "bare.mkv"
    write_video(path, iter(SCENE.frames(FRAMES)), fps_container=Fraction(50), codec="ffv1")
    return path


def settings(**options):
    ends = SCENE.points(0.0, np.array([0.0, SCENE.length_px]))[0].round()
    return TrackerSettings(**{"fps": FPS, "kind": "line", "line_px": ends.tolist()} | options)


@pytest.fixture(scope="module")
def tracks(film):
    found = track(film, settings(positions_mm=(0.0, 220.0), stations=12))
    assert found, found.reason
    return found


def test_a_bare_strip_gives_frequency_and_damping(tracks):
    found = identify(displacement_series(tracks), IdentifySettings(seed=1))
    mode = found.modes[0]
    true_hz = FPS * RATE / np.sqrt(1.0 - ZETA**2)
    assert abs(mode.frequency_hz - true_hz) < 4.0 * mode.frequency_sd_hz, (mode.frequency_hz, true_hz)
    assert abs(mode.damping_ratio - ZETA) < 4.0 * mode.damping_ratio_sd, mode.damping_ratio


def test_stations_have_positions_and_the_free_length_gives_the_scale(tracks):
    assert tracks.markers == tuple(f"s{k + 1}" for k in range(12))
    assert tracks.kind == "line"
    # The ends are placed to a px of 110, the free end is found: 1 %.
    assert tracks.scale.mm_per_px == pytest.approx(2.0, rel=0.01)
    spacing = np.diff(tracks.positions_mm)
    assert spacing == pytest.approx(np.full(11, spacing[0]))
    assert tracks.positions_mm[0] == pytest.approx(0.5 * spacing[0], abs=5.0)
    assert 220.0 - tracks.positions_mm[-1] == pytest.approx(0.5 * spacing[0], abs=5.0)


def test_the_sd_along_any_direction_is_that_of_the_normal(tracks):
    """Without the correlation of x and y, the sd along the normal of a slanted line would be too small."""
    normal = SCENE.points(0.0, np.array([50.0]))[1][0]
    series = displacement_series(tracks, direction=(normal[0], -normal[1]), unit="px")
    whole = np.hypot(tracks.sd_x_px, tracks.sd_y_px)
    assert series.sd == pytest.approx(whole, rel=0.02)
    along = displacement_series(tracks, direction=(normal[1], normal[0]), unit="px")
    assert np.nanmax(along.sd) < 0.2 * np.nanmin(whole)
    in_mm = displacement_series(tracks, direction=(normal[0], -normal[1]))
    assert in_mm.sd == pytest.approx(tracks.scale.mm_per_px * whole, rel=0.02)


def test_a_tracks_file_keeps_the_correlation(tracks, tmp_path):
    write_tracks(tmp_path / "tracks.csv", tracks)
    table = read_table(tmp_path / "tracks.csv")
    back = tracks_from_table(table, name="tracks", positions_mm=None, reference=())
    assert np.array_equal(back.correlation_xy, tracks.correlation_xy, equal_nan=True)
    one, other = (displacement_series(t, direction=(0.6, 0.8), unit="px") for t in (tracks, back))
    assert other.sd == pytest.approx(one.sd, rel=1e-6)


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"line_px": [[5.0, 5.0], [500.0, 5.0]]}, "outside the image"),
        ({"line_px": [[5.0, 5.0], [9.0, 5.0]]}, "px long"),
        ({"positions_mm": (0.0, 1.0, 2.0)}, "give two"),
        ({"line_px": [[5.0, 8.0], [5.0, 140.0]]}, "no strip or edge"),
    ],
)
def test_what_cannot_be_a_line_is_refused(film, options, reason):
    refused = track(film, settings(**options))
    assert not refused
    assert reason in refused.reason


def test_the_line_is_found_by_its_motion(film, tracks):
    found = track(film, settings(line_px=None, positions_mm=(0.0, 220.0), stations=12))
    assert found, found.reason
    assert any("line_px was not given" in note for note in found.notes)
    # The clamp is found where the contrast ends, to the blur of the lens and half a step of the search.
    apart = np.hypot(found.x_px[0] - tracks.x_px[0], found.y_px[0] - tracks.y_px[0])
    assert np.all(apart < 3.0)


@pytest.mark.parametrize("mode", [1, 2, 3, 4, 5])
def test_a_line_with_nodes_is_found_from_its_clamp(mode):
    """To the accuracy that a calibration requires of given ends, `calibrate.TUNING.ends_px`."""
    scene = LineScene(
        **SMALL
        | {
            "length_px": 300.0,
            "shape": (340, 76),
            "modes": (mode,),
            "tip_px": (5.0,),
            "cycles_per_frame": (0.0913,),
        }
    )
    found = find_line(scene.frames(16))
    assert not isinstance(found, Failure), found.reason
    ends = scene.points(0.0, np.array([0.0, scene.length_px]))[0]
    assert np.all(np.hypot(*(found - ends).T) < calibrate.TUNING.ends_px)


def test_two_lines_beside_each_other_are_not_one():
    frames = [np.hstack([image, image]) for image in SCENE.frames(16)]
    assert "more than one object" in find_line(frames).reason


def test_a_picture_at_rest_has_no_line_to_find(tmp_path):
    rng = np.random.default_rng(3)
    image = SCENE.image(0.0)
    noisy = (np.rint(image + rng.normal(0.0, 2.0, image.shape)) for _ in range(12))
    path = tmp_path / "still.mkv"
    still = (np.clip(levels, 0, 255).astype(np.uint8) for levels in noisy)
    write_video(path, still, fps_container=Fraction(50), codec="ffv1")
    refused = track(path, settings(line_px=None))
    assert not refused
    assert "nothing moves" in refused.reason
    assert "set line_px" in refused.reason


def test_the_lossy_film_has_a_larger_sd(film, tracks, tmp_path):
    path = tmp_path / "bare.mp4"
    write_video(path, iter(SCENE.frames(64)), fps_container=Fraction(50), codec="libx264", crf=23)
    lossy = track(path, settings(stations=12))
    assert np.nanmedian(lossy.sd_x_px) > 1.5 * np.nanmedian(tracks.sd_x_px)

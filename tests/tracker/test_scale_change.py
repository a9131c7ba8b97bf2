"""Slow zoom: followed by the spacing of the markers, and nothing else taken for it."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.camera_motion import CameraCase, answer, film
from tracker import ScaleChange, displacement_series
from tracker.markers import aruco

ZOOM = CameraCase(zoom=0.02)


def series(case):
    return displacement_series(case.tracks(), unit="px")


@pytest.mark.parametrize("markers", [2, 3, 6])
@pytest.mark.parametrize("hz", [0.0, 0.3])
def test_the_scale_is_that_of_the_camera(markers, hz):
    case = CameraCase(zoom=0.02, zoom_hz=hz, markers=markers)
    found = series(case).scale_change
    assert found is not None
    scale = found.scale(case.time_s) * case.scale()[0]
    # Two markers 200 px from the middle with 0.02 px of noise: 1e-4 in one frame. A spline averages dozens of frames.
    error = float(np.sqrt(np.mean((scale / case.scale() / np.mean(scale / case.scale()) - 1.0) ** 2)))
    assert error < 1e-4, f"rms error of the scale {error:.2g}, noise of one frame is 1e-4"


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("zoom", [-0.02, 0.01, 0.03])
def test_damping_is_right_in_spite_of_a_zoom(zoom, seed):
    case = CameraCase(zoom=zoom, markers=3, seed=seed)
    found = answer(case, case.tracks())
    assert abs(found.damping_z) < 3.5, f"off by {found.damping_z:.2g} sd; without a correction by 16 to 40"


@pytest.mark.parametrize("markers", [1, 2, 3, 6])
@pytest.mark.parametrize("amplitude_px", [1.0, 2.9, 20.0, 60.0])
def test_a_camera_at_rest_does_not_zoom(markers, amplitude_px):
    """Large vibrations shorten the beam at twice their frequency and by a slow part: that is no zoom."""
    for seed in range(5):
        found = series(CameraCase(markers=markers, amplitude_px=amplitude_px, seed=seed))
        assert found.scale_change is None
        assert not [note for note in found.notes if "zoom" in note]


def test_one_marker_does_not_show_a_zoom_and_says_so():
    found = series(CameraCase(zoom=0.03, markers=1))
    assert found.scale_change is None
    assert [note for note in found.notes if "One marker does not show which" in note]


def moved(tracks, k, by_px):
    """The tracks with one marker displaced along the beam by a function of time."""
    y = tracks.y_px.copy()
    y[:, k] += by_px
    return replace(tracks, y_px=y)


def greville(knots):
    """Coefficients of the function t itself: means of three neighbouring knots."""
    return np.array([np.mean(knots[k + 1 : k + 4]) for k in range(knots.size - 4)])


def test_blurred_frames_of_a_shortening_beam_are_no_zoom():
    """In 5 exposed frames a cycle the fast part of the shortening is a quarter smaller than the slow part tells."""
    case = CameraCase(frames=1000, fps=50.0, amplitude_px=60.0, damping_ratio=0.002)
    fine = replace(case, frames=10_000, fps=500.0)
    tracks = case.tracks()
    noise = np.stack([tracks.x_px, tracks.y_px]) - case.xy_px()
    blurred = fine.xy_px().reshape(2, 1000, 10, 3).mean(axis=2)
    x, y = blurred + noise
    assert displacement_series(replace(tracks, x_px=x, y_px=y)).scale_change is None


def test_slow_motion_of_one_marker_among_three_is_no_zoom():
    tracks = CameraCase().tracks()
    creep = np.sin(2.0 * np.pi * 0.3 * tracks.time_s)
    assert displacement_series(moved(tracks, 1, creep)).scale_change is None
    # The same with the motion of all in proportion to the distance from the middle is one.
    zoomed = moved(moved(tracks, 0, -creep), 2, creep)
    assert displacement_series(zoomed).scale_change is not None


def test_a_fixed_reference_shows_the_zoom_beside_one_marker():
    tracks = replace(replace(ZOOM, markers=2).tracks(), reference=("m1",))
    series = displacement_series(tracks)
    assert series.channels == ("m2",)
    assert np.ptp(series.scale_change.scale(series.time_s)) == pytest.approx(0.02, rel=0.02)


def test_lost_frames_and_outliers_do_not_hide_a_zoom():
    tracks = ZOOM.tracks()
    jumps = np.zeros(tracks.time_s.size)
    jumps[100:103] = 7.0
    tracks = moved(tracks, 2, jumps)
    tracks.y_px[300:360, 1] = tracks.x_px[300:360, 1] = np.nan
    series = displacement_series(tracks)
    assert np.ptp(series.scale_change.scale(series.time_s)) == pytest.approx(0.02, rel=0.02)
    assert np.isnan(series.values[300:360, 1]).all()


def test_stations_of_a_line_have_no_spacing():
    series = displacement_series(replace(ZOOM.tracks(), kind="line"))
    assert series.scale_change is None
    assert not any("scale" in note for note in series.notes)


def test_a_pause_of_an_hour_is_survived():
    tracks = ZOOM.tracks()
    time_s = tracks.time_s + np.where(np.arange(1000) > 500, 3600.0, 0.0)
    assert displacement_series(replace(tracks, time_s=time_s)).scale_change is None


def test_rate_errors_are_weighted_slopes():
    knots = np.array([0.0, 0.0, 0.0, 0.0, 1.0, 2.0, 3.0, 4.0, 4.0, 4.0, 4.0])
    of_time = greville(knots)
    root = np.stack(
        [0.01 * of_time, np.full(of_time.size, 0.3), np.random.default_rng(1).normal(size=of_time.size)]
    )
    change = ScaleChange(knots, 1.0 + 0.1 * of_time, root.T)
    time_s = np.linspace(1.0, 4.0, 301)
    np.testing.assert_allclose(change.scale(time_s), 1.0 + 0.1 * time_s, rtol=1e-12)
    power = np.exp(-time_s)
    random = replace(change, coefficients=root[2]).scale(time_s)
    expected = [0.01, 0.0, np.polyfit(time_s, random, 1, w=np.sqrt(power))[0]]
    np.testing.assert_allclose(change.rate_errors(time_s, power), expected, atol=1e-12)


def test_codes_move_with_their_fixed_points_where_the_scale_changes(tmp_path, monkeypatch):
    # The film has codes of this family only; all are searched for in markers/test_detection.py.
    own = tuple(family for family in aruco.FAMILIES if "DICT_4X4_50" in family)
    monkeypatch.setattr(aruco, "FAMILIES", own)
    case = CameraCase(zoom=0.02, frames=100, amplitude_px=20.0, markers=2)
    tracks = film(case, tmp_path, "aruco")
    beside = np.stack([tracks.x_px, tracks.y_px]) - case.xy_px()
    slopes = np.array([[np.polyfit(case.scale(), column, 1)[0] for column in axis.T] for axis in beside])
    # The sd of the points is a tenth and 0.1 px; of the slope over 2 %, 0.05 px, as the misfit grows with the scale.
    assert np.abs(slopes).max() > 1.0
    np.testing.assert_allclose(tracks.fixed_points_px, slopes, atol=4 * 0.05 + 2 * np.hypot(0.1, 0.15))


@pytest.mark.slow
def test_intervals_of_damping_include_the_error_of_the_correction():
    z = []
    for seed in range(100):
        case = CameraCase(zoom=0.02, zoom_hz=0.1, markers=3, seed=seed)
        z.append(answer(case, case.tracks()).damping_z)
    # 100 values of unit variance have an rms of 1 with a standard error of 0.07.
    assert 0.8 < float(np.sqrt(np.mean(np.square(z)))) < 1.2

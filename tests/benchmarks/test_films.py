"""Intervals on a few rendered, encoded and tracked films (docs/studies/films.md has many), and on a moving camera."""

import numpy as np
import pandas as pd
import pytest
from scipy.stats import chi2, norm

from benchmarks.camera_motion import CameraCase
from benchmarks.film_scenes import Film
from benchmarks.films import row, run_film, table, tracked
from tracker import displacement_series

SHORT, LONG = 600, pytest.param(1500, marks=pytest.mark.slow)


@pytest.mark.parametrize("frames", [SHORT, LONG])
@pytest.mark.parametrize(
    ("kind", "codec"),
    [
        ("patch", "lossless"),
        ("dots", "MJPG"),
        # fast: the interval of a real film in H.264 in test_fork_prongs.py
        pytest.param("aruco", "H.264", marks=pytest.mark.slow),
    ],
)
def test_intervals_on_film_contain_the_truth(kind, codec, frames):
    """Damping and frequency of each film, at a false alarm of one in a thousand for each film."""
    limit = norm.isf(0.0005)
    for seed in (1,) if frames == SHORT else (1, 2):
        film = Film(kind, codec, 1.0, frames, seed)
        trial = run_film(film, tracked(film))
        z = (trial.zeta_found - trial.zeta) / trial.zeta_sd
        assert abs(z) < limit, f"{film}: damping is off by {z:.1f} sd"
        z = (trial.frequency_found_hz - trial.frequency_hz) / trial.frequency_sd_hz
        assert abs(z) < limit, f"{film}: frequency is off by {z:.1f} sd"
        # No sd is below the bound but for the scatter of the film's rms error, from which the bound is computed.
        assert trial.zeta_sd > 0.8 * trial.bound, f"{film}: sd {trial.zeta_sd:.1e}, bound {trial.bound:.1e}"


def test_a_rendered_film_is_where_its_truth_says():
    """The tracker finds each position within its noise: 300 errors over stated sd, 99.9 % band of chi-square."""
    film = Film("dots", "lossless", 1.0, 300, 5)
    tracks, truth = tracked(film), film.truth()
    x = (tracks.x_px[:, 0] - truth.xy_px[0]) / tracks.sd_x_px[:, 0]
    y = (tracks.y_px[:, 0] - truth.xy_px[1]) / tracks.sd_y_px[:, 0]
    # Both the renderer and the tracker place the centre of pixel 0 at 0: no constant offset.
    assert abs(x.mean()) < 0.5
    assert abs(y.mean()) < 0.5
    low, high = chi2.ppf([0.0005, 0.9995], 298)
    # The noise level is estimated from 64 frames: 5 % of the variance.
    for errors in (x - x.mean(), y - y.mean()):
        assert 0.95 * low < errors @ errors < 1.1 * high
    assert displacement_series(tracks, unit="px").position_errors.period_px == 1.0


def test_a_table_row_counts_and_scores():
    trial = {"kind": "dots", "codec": "MJPG", "amplitude_px": 1.0, "frames": 1500, "frequency_hz": 10.0}
    trial |= {"zeta": 0.004, "zeta_sd": 1e-5, "zeta_low": 0.00398, "zeta_high": 0.00402, "bound": 5e-6}
    trial |= {"frequency_found_hz": 10.0002, "frequency_sd_hz": 1e-4, "frequency_low_hz": 10.00003}
    trial |= {"frequency_high_hz": 10.00037, "position_error": 0.02, "position_sd": 0.01}
    failed = {**trial, **dict.fromkeys(("zeta_found", "zeta_sd", "zeta_low", "zeta_high"), np.nan)}
    trials = pd.DataFrame([{**trial, "zeta_found": 0.00401}, {**trial, "zeta_found": 0.00403}, failed])
    cells = [cell.strip() for cell in row(trials).split("|")]
    assert cells == ["3", "2.00", "2.00", "0", f"{np.sqrt(5.0):.2f}", "2", "0.25", "2.0"]
    assert table(trials).count("\n") == 4, "head, rule, the cell, all markers, all films"


@pytest.mark.parametrize(
    ("kind", "amplitude_px", "seed", "missing"),
    [
        # fast: the same at twice the speed
        pytest.param("patch", 20.0, 6, 0, marks=pytest.mark.slow),
        ("patch", 40.0, 0, 0),
        pytest.param("aruco", 80.0, 2, 0, marks=pytest.mark.slow),
        pytest.param("dots", 80.0, 0, 10, marks=pytest.mark.slow),
    ],
)
def test_a_marker_that_is_at_full_speed_in_its_first_frames_is_followed(kind, amplitude_px, seed, missing):
    """6 to 24 px between frames: the start of the next fit is not known, and a window of the surface may fit, too.

    A dot without code is found again when it turns, after half a cycle of 21 frames.
    """
    film = Film(kind, "lossless", amplitude_px, 80, seed)
    tracks, truth = tracked(film), film.truth()
    errors = np.array([tracks.x_px[:, 0], tracks.y_px[:, 0]]) - truth.xy_px
    lost = int(np.count_nonzero(np.isnan(errors[0])))
    assert lost <= missing, f"{lost} positions are missing"
    # A patch's centre is a whole pixel. Of 160 normal errors one exceeds 5 sd in 10 000 tests.
    errors -= np.nanmedian(errors, axis=1, keepdims=True)
    sd = np.array([tracks.sd_x_px[:, 0], tracks.sd_y_px[:, 0]])
    worst = np.nanmax(np.abs(errors) / sd)
    assert worst < 5.0, f"a position is off by {worst:.1f} sd"
    assert np.nanmedian(sd) < 2.0 * np.sqrt(np.nanmean(errors**2)), "sd is far above the error"


def test_displacements_beside_a_drifting_camera_are_along_the_vibration():
    series = displacement_series(CameraCase(drift_px=8.0).tracks())
    assert series.direction == pytest.approx((1.0, 0.0), abs=1e-3)
    assert any("motion of the camera" in note for note in series.notes)
    assert not any("camera" in note for note in displacement_series(CameraCase().tracks()).notes)

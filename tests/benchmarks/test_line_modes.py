"""Modes of bare strips in drawn films against what was drawn."""

from fractions import Fraction

import numpy as np
import pytest

from benchmarks.line_modes import LENGTH_MM, ModeFilm, compared, tracked
from benchmarks.line_scenes import ROOTS, mode_shape
from modal_id import IdentifySettings, identify
from modal_id.modes import Curvature, beam_curvature, row_delay
from modalcam.pipeline import image_rows
from sim.render import write_video
from tracker import TrackerSettings, displacement_series, harmonics, track


def test_a_mode_of_a_film_is_found_exactly(tmp_path):
    """One short film; the slow test has some of each mode."""
    film = ModeFilm(3, 1, frames=100)
    found = compared(film, tracked(film, tmp_path))
    assert abs(found.frequency_z) < 4.0, found
    assert abs(found.damping_z) < 4.0, found
    assert found.damping_sd < 0.01, "the film tells little of the damping"
    assert found.mac_lacks < 1e-4, found


@pytest.mark.slow
def test_intervals_of_modes_hold_the_truth_as_often_as_stated(tmp_path):
    films = [ModeFilm(mode, seed, frames=300) for mode in range(1, 6) for seed in range(100, 103)]
    films.append(ModeFilm(1, 100, frames=300, large=True))
    found = [compared(film, tracked(film, tmp_path)) for film in films]
    for trial in found:
        assert abs(trial.frequency_off) < 5e-4, trial
        assert abs(trial.damping_off) < 0.03, trial
        assert trial.mac_lacks < 1e-4, trial
    assert found[-1].largest_px < 0.1, found[-1]
    for z in ([t.frequency_z for t in found], [t.damping_z for t in found]):
        # The rms of 16 standard normal numbers is below 1.5 with a probability of 0.998.
        assert np.sqrt(np.mean(np.square(z))) < 1.5, z


@pytest.mark.slow
def test_intervals_are_not_too_narrow_in_lossy_films(tmp_path):
    """Errors of compression return with the motion: noise alone would not explain them."""
    films = [ModeFilm(mode, 200, frames=300, codec="MJPG") for mode in range(1, 6)]
    found = [compared(film, tracked(film, tmp_path)) for film in films]
    for trial in found:
        assert abs(trial.frequency_off) < 5e-4, trial
        assert abs(trial.damping_off) < 0.03, trial
    for z in ([t.frequency_z for t in found], [t.damping_z for t in found]):
        # The rms of 5 standard normal numbers is below 1.95 with a probability of 0.998.
        assert np.sqrt(np.mean(np.square(z))) < 1.95, z


def mode_curvature(mode, x):
    """Second derivative of `mode_shape` by the share of the length."""
    root = ROOTS[mode - 1]
    ratio = (np.cosh(root) + np.cos(root)) / (np.sinh(root) + np.sin(root))
    tip = np.cosh(root) - np.cos(root) - ratio * (np.sinh(root) - np.sin(root))
    z = root * x
    return root**2 * (np.cosh(z) + np.cos(z) - ratio * (np.sinh(z) + np.sin(z))) / tip


@pytest.mark.slow
@pytest.mark.parametrize("mode", [2, 5])
def test_bands_hold_the_curvature_of_a_filmed_strip(mode, tmp_path):
    """From pixels to curvature: the sd of the ends and of the shape are those of the tracker and the identification."""
    z, at_mm = [], np.array([0.0, 60.0, 140.0, 220.0, 300.0, 380.0, 450.0])
    for seed in range(3):
        tracks = tracked(ModeFilm(mode, 300 + seed, frames=200), tmp_path)
        answer = identify(displacement_series(tracks, unit="px"), IdentifySettings(onset_s=0.0, seed=seed))
        found = max(answer.modes, key=lambda each: each.amplitude)
        positions_mm = answer.series.positions_mm
        bend = beam_curvature(positions_mm, found.shape, found.shape_sd, LENGTH_MM, at_mm, tracks.ends_sd_mm)
        assert isinstance(bend, Curvature), bend.reason
        used = np.isfinite(found.shape)
        drawn = mode_shape(mode, positions_mm[used] / LENGTH_MM)
        # The amplitude is not compared: it is that of the drawn shape which fits best.
        scale = np.abs(np.vdot(drawn, found.shape[used]) / np.vdot(drawn, drawn))
        true = scale * mode_curvature(mode, at_mm / LENGTH_MM) * (1e3 / LENGTH_MM) ** 2
        z.append((bend.value * np.sign(bend.value @ true) - true) / bend.sd)
        assert np.all(bend.sd < 0.05 * np.abs(true).max())
    # Errors at seven places of a shape are correlated: of 9 independent ones, 0.6 are in the band of 90 % with a
    # probability of 0.998.
    assert np.mean(np.abs(z) < 1.645) > 0.6, z
    assert np.abs(z).max() < 4.5, z


class RollingScene:
    """A drawn scene whose rows are exposed one after another, in bands of one time each."""

    def __init__(self, scene, delay_frames, bands=10):
        self._scene, self._delay = scene, delay_frames
        self._bands = np.array_split(np.arange(scene.shape[0]), bands)

    def frames(self, count):
        rng = np.random.default_rng(5)
        middle = 0.5 * (self._scene.shape[0] - 1)
        for k in range(count):
            image = np.empty(self._scene.shape)
            for rows in self._bands:
                image[rows] = self._scene.image(k + self._delay * (rows.mean() - middle))[rows]
            noisy = image + rng.normal(0.0, self._scene.noise, image.shape)
            yield np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


@pytest.mark.slow
def test_the_readout_of_a_rolling_shutter_is_named(tmp_path):
    """Rows that are read over 0.4 of the time between frames: that is found, and nothing where it was given."""
    film = ModeFilm(2, 400)
    scene, readout_s = film.scene(), 0.4 / film.fps
    path = tmp_path / "rolling.mkv"
    rows = scene.shape[0]
    frames = RollingScene(scene, readout_s * film.fps / (rows - 1)).frames(80)
    write_video(path, frames, fps_container=Fraction(50), codec="ffv1")
    ends = scene.points(0.0, np.array([0.0, scene.length_px]))[0]
    settings = TrackerSettings(fps=film.fps, kind="line", line_px=ends.round().tolist(), stations=44)
    notes = []
    for given in (None, readout_s):
        tracks = track(path, settings.model_copy(update={"readout_s": given}))
        series = displacement_series(tracks, unit="px")
        found = identify(series, IdentifySettings(onset_s=0.0, seed=1))
        seen = image_rows(tracks, series.channels)
        notes.append(row_delay(found, seen.at_rest_px))
    # Bands of 26 rows: their mean times are exact, the strip of a band moves as one.
    assert notes[0] is not None
    assert abs(notes[0].per_row_s * (rows - 1) - readout_s) < max(
        4.0 * notes[0].sd_s * (rows - 1), 0.02 * readout_s
    )
    assert notes[1] is None


@pytest.mark.slow
@pytest.mark.parametrize("codec", ["MJPG", "H.264"])
def test_a_global_shutter_gets_no_note_in_lossy_films(codec, tmp_path):
    for mode in (1, 3, 5):
        tracks = tracked(ModeFilm(mode, 500, frames=200, codec=codec), tmp_path)
        series = displacement_series(tracks, unit="px")
        found = identify(series, IdentifySettings(onset_s=0.0, seed=1))
        assert row_delay(found, image_rows(tracks, series.channels).at_rest_px) is None, mode


@pytest.mark.slow
def test_errors_that_return_with_the_motion_are_as_large_as_assumed(tmp_path):
    """The true errors of lossy stations over their place in the block, relative to the sd that intervals assume."""
    found = []
    for mode in range(1, 6):
        film = ModeFilm(mode, 700, frames=200, codec="MJPG")
        scene, tracks = film.scene(), tracked(film, tmp_path)
        at_px = scene.length_px * tracks.positions_mm[1:-1] / LENGTH_MM
        error = np.empty((len(tracks.time_s), at_px.size))
        for k in range(len(error)):
            points, normals = scene.points(float(k), at_px)
            off = np.stack([tracks.x_px[k, 1:-1], tracks.y_px[k, 1:-1]], axis=1) - points
            error[k] = np.sum(off * normals, axis=1) / np.linalg.norm(normals, axis=1)
        errors = displacement_series(tracks, unit="px").position_errors
        waves = harmonics(tracks.x_px[:, 1:-1].ravel(), errors.period_px).reshape(*error.shape, -1)
        design = (waves - waves.mean(axis=0)).reshape(error.size, -1)
        # With the sd of a position and of the multiples as weights: those that the motion does not show stay at zero.
        sd = np.median(np.hypot(tracks.sd_x_px, tracks.sd_y_px))
        share = np.median(errors.periodic_sd[0]) / sd
        normal = design.T @ design + np.eye(design.shape[1]) / share**2
        found.append(np.linalg.solve(normal, design.T @ (error - error.mean(axis=0)).ravel()) / (share * sd))
    # Of ten standard normal numbers, the rms is between 0.4 and 1.65 with a probability of 0.998. In 25 films: 0.8,
    # and 0.35 for the shorter waves.
    longest = np.sqrt(np.mean(np.array(found)[:, :2] ** 2))
    assert 0.4 < longest < 1.65, found
    assert np.sqrt(np.mean(np.array(found)[:, 2:] ** 2)) < 1.0

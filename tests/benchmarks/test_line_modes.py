"""Modes of bare strips in drawn films against what was drawn."""

import numpy as np
import pytest

from benchmarks.line_modes import ModeFilm, compared, tracked


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

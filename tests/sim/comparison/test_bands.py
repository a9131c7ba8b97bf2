"""Bands from draws that are simulated with longer steps than the curve."""

from dataclasses import replace

import numpy as np
import pytest
from kit.identified import identification

from sim import MEASURED_DAMPING_RATIO, sample_beam
from sim.beam import AncfBeam, beam_modes
from sim.comparison import Candidate, match_modes, problem, simulate_candidates, start_draws
from sim.damping import GenericDamping

POSITIONS_MM = np.array([90.0, 190.0, 290.0, 390.0, 490.0])
DRAWS = 8


@pytest.fixture(scope="module")
def setting():
    """A decay of mode 2 with 4 mm at the outermost marker."""
    beam = AncfBeam(sample_beam())
    modes = beam_modes(beam, 8)
    shape = modes.transverse_at(1e-3 * POSITIONS_MM)[:, 1]
    mode = (
        modes.frequency_hz[1],
        MEASURED_DAMPING_RATIO[1],
        4.0 * shape / np.abs(shape).max() * np.exp(0.7j),
        2,
    )
    found = identification(
        [mode], time_s=np.arange(0.0, 1.2, 2e-3), positions_mm=POSITIONS_MM, fit_from_s=0.0
    )
    return problem.decay_setting(beam, modes, found, match_modes(found, modes)), found


def simulated(setting, found):
    scores = np.random.default_rng(5).standard_normal((DRAWS, 5))
    draws = tuple(
        GenericDamping(tuple(np.array(MEASURED_DAMPING_RATIO) * (1 + 5e-3 * row))) for row in scores
    )
    candidates = {"generic": Candidate(GenericDamping(MEASURED_DAMPING_RATIO), draws)}
    return simulate_candidates(setting, candidates, start_draws(setting, found, DRAWS))["generic"]


def test_longer_steps_leave_the_bands(setting, monkeypatch):
    setting, found = setting
    assert setting.coarse.step_s == pytest.approx(8.0 * setting.step_s)
    coarse = simulated(setting, found)
    fine_steps = replace(problem.TUNING, longest_coarse_step_s=setting.step_s)
    monkeypatch.setattr(problem, "TUNING", fine_steps)
    fine = simulated(setting, found)
    np.testing.assert_array_equal(coarse.central, fine.central)
    width = np.sqrt(np.mean((fine.high - fine.low) ** 2))
    for name in ("low", "high", "sd"):
        moved = np.sqrt(np.mean((getattr(coarse, name) - getattr(fine, name)) ** 2))
        # A band from 32 draws is itself uncertain by a tenth.
        assert moved < 0.02 * width, f"{name} moved by {moved / width:.3f} of the band's width"

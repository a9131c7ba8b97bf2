"""Comparison with a stored run of Exudyn's ANCFCable2D, written by ``python -m benchmarks.exudyn_free_decay``."""

from pathlib import Path

import numpy as np
import pytest

from sim import MEASURED_DAMPING_RATIO, paper_beam
from sim.beam import AncfBeam, beam_modes
from sim.damping import GenericDamping
from sim.dynamics import released_state, simulate

STORED = np.loadtxt(Path(__file__).parent / "exudyn_free_decay.csv", delimiter=",")
AMPLITUDE_M = 0.2


def decay(gauss_points, step_s):
    """Repeat the stored run; the initial state is computed with three Gauss points, as it was for Exudyn."""
    three_points = AncfBeam(paper_beam())
    beam = AncfBeam(paper_beam(), gauss_points)
    modes = beam_modes(three_points, 8)
    run = simulate(
        beam,
        GenericDamping(MEASURED_DAMPING_RATIO, residual_ratio=0.0),
        state=released_state(three_points, modes, 1, AMPLITUDE_M),
        duration_s=0.5,
        step_s=step_s,
        output_positions_m=np.array([0.5]),
        output_every=round(0.01 / step_s),
        modes=modes,
    )
    return np.column_stack([run.time_s, run.axial_m, run.transverse_m])


@pytest.mark.parametrize("step_s", [2e-5, pytest.param(1e-5, marks=pytest.mark.slow)])
def test_decay_from_200_mm_matches_exudyn(step_s):
    ours = decay(5, step_s)
    np.testing.assert_allclose(ours[:, 0], STORED[:, 0], atol=1e-9)
    difference = np.abs(ours[:, 1:] - STORED[:, 1:]).max() / AMPLITUDE_M
    assert difference < 1e-5, (
        "Exudyn integrates the axial strain with five points and uses the exact curvature, ours has an error of 1e-6; "
        f"both are converged in time to 3e-6. The difference is {difference:.1e} of the amplitude"
    )


def test_three_gauss_points_change_the_decay_by_the_mesh_error():
    """Reduced integration is a different discretisation of the same beam; the difference is the mesh error, 1e-4."""
    difference = np.abs(decay(3, 1e-4)[:, 1:] - STORED[:, 1:]).max() / AMPLITUDE_M
    assert 2e-5 < difference < 3e-4

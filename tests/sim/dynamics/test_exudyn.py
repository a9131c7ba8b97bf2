"""Our beam against Exudyn's ANCFCable2D: a stored run, made by ``python -m benchmarks.exudyn_free_decay``."""

from pathlib import Path

import numpy as np
import pytest

from sim.beam.ancf import AncfBeam
from sim.beam.modes import beam_modes
from sim.damping import GenericDamping
from sim.dynamics.excitation import released_state
from sim.dynamics.simulate import simulate
from sim.reference.paper_beam import MEASURED_DAMPING_RATIO, paper_beam

STORED = np.loadtxt(Path(__file__).parent / "exudyn_free_decay.csv", delimiter=",")
AMPLITUDE_M = 0.2


def decay(gauss_points, step_s):
    """The stored run, by our code: the state is that of three Gauss points, as it was given to Exudyn."""
    given = AncfBeam(paper_beam())
    beam = AncfBeam(paper_beam(), gauss_points)
    modes = beam_modes(given, 8)
    run = simulate(
        beam,
        GenericDamping(MEASURED_DAMPING_RATIO, residual_ratio=0.0),
        state=released_state(given, modes, 1, AMPLITUDE_M),
        duration_s=0.5,
        step_s=step_s,
        output_positions_m=np.array([0.5]),
        output_every=round(0.01 / step_s),
        modes=modes,
    )
    return np.column_stack([run.time_s, run.axial_m, run.transverse_m])


@pytest.mark.parametrize("step_s", [2e-5, pytest.param(1e-5, marks=pytest.mark.slow)])
def test_a_decay_from_200_mm_is_exudyns(step_s):
    ours = decay(5, step_s)
    np.testing.assert_allclose(ours[:, 0], STORED[:, 0], atol=1e-9)
    apart = np.abs(ours[:, 1:] - STORED[:, 1:]).max() / AMPLITUDE_M
    assert apart < 1e-5, (
        "Exudyn integrates the axial strain with five points and bends with the exact curvature, of which ours is "
        f"short by 1e-6; both are converged in time to 3e-6. They are {apart:.1e} of the amplitude apart"
    )


def test_three_gauss_points_move_the_decay_by_what_the_mesh_leaves():
    """The reduced integration is another discretisation of the same beam: apart by the mesh's error, 1e-4."""
    apart = np.abs(decay(3, 1e-4)[:, 1:] - STORED[:, 1:]).max() / AMPLITUDE_M
    assert 2e-5 < apart < 3e-4

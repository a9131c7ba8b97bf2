import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from sim.beam.ancf import AncfBeam
from sim.beam.modes import beam_modes
from sim.comparison.posterior_decays import posterior_decays
from sim.damping import GenericDamping, RayleighDamping
from sim.dynamics.excitation import released_state
from sim.dynamics.simulate import simulate
from sim.dynamics.trajectory import State
from sim.reference.paper_beam import MEASURED_DAMPING_RATIO, paper_beam

POINTS = np.array([0.2, 0.5])


@pytest.fixture(scope="module")
def modes():
    return beam_modes(AncfBeam(paper_beam("horizontal")), 8)


def test_each_draw_is_the_single_simulation_at_the_times_asked_for(modes):
    """A horizontal beam, which sags, so that the direction and the equilibrium count; times off the steps."""
    beam = modes.beam
    rng = np.random.default_rng(8)
    models = [
        GenericDamping(tuple(np.array(MEASURED_DAMPING_RATIO) * (1.0 + 0.1 * rng.normal(size=5)))),
        RayleighDamping.from_modes((12.0, 60.0), (0.02, 0.01)),
    ]
    omega = modes.omega_rad_s[:3] * (1.0 + 0.01 * rng.normal(size=(2, 3)))
    state = released_state(beam, modes, 1, 0.01)
    time_s = np.sort(rng.uniform(0.0, 0.15, 40))
    direction = (0.6, 0.8)
    decays = posterior_decays(
        beam, modes, models, states=state, time_s=time_s, positions_m=POINTS, step_s=1e-3, direction=direction,
        target_omega_rad_s=omega,
    )  # fmt: skip
    assert decays.failed == (None, None)
    rest_x, rest_y, _ = beam.points(POINTS, modes.equilibrium)
    for d, model in enumerate(models):
        run = simulate(
            beam, model, state=state, duration_s=0.15, step_s=1e-3, output_positions_m=POINTS, modes=modes,
            target_omega_rad_s=omega[d],
        )  # fmt: skip
        moved = (run.x_m - rest_x) * direction[0] + (run.y_m - rest_y) * direction[1]
        expected = CubicSpline(run.time_s, moved)(time_s)
        # what the iterations of lane and single run leave, as in test_draws.py
        np.testing.assert_allclose(decays.displacement_m[d], expected, atol=1e-7 * 0.01)
    assert np.abs(np.diff(decays.displacement_m, axis=0)).max() > 1e-5, "draws differ"


def test_a_draw_that_fails_is_nan_with_a_reason(modes):
    rng = np.random.default_rng(5)
    beam = modes.beam
    wild = State(rng.normal(size=80) * 0.02 / beam.dof_scale, rng.normal(size=80) * 500.0 / beam.dof_scale)
    rest = State(modes.equilibrium, np.zeros(80))
    decays = posterior_decays(
        beam, modes, [GenericDamping(MEASURED_DAMPING_RATIO)] * 2, states=[wild, rest], time_s=np.array([0.1, 0.15]),
        positions_m=POINTS, step_s=0.05,
    )  # fmt: skip
    assert decays.failed[0] is not None
    assert "did not converge" in decays.failed[0].reason
    assert np.all(np.isnan(decays.displacement_m[0]))
    np.testing.assert_allclose(decays.displacement_m[1], 0.0, atol=1e-12)


@pytest.mark.parametrize("time_s", [[], [0.1, np.nan], [-0.1]])
def test_times_that_are_none_are_refused(modes, time_s):
    with pytest.raises(ValueError, match="time_s must hold finite times from 0 on"):
        posterior_decays(
            modes.beam, modes, [GenericDamping(MEASURED_DAMPING_RATIO)], states=State(modes.equilibrium, np.zeros(80)),
            time_s=np.array(time_s), positions_m=POINTS, step_s=1e-3,
        )  # fmt: skip

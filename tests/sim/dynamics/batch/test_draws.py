import numpy as np
import pytest

from sim.beam.ancf import AncfBeam
from sim.beam.modes import beam_modes
from sim.damping import GenericDamping, NoDamping, RayleighDamping, WithAirDrag
from sim.dynamics.batch.draws import simulate_draws
from sim.dynamics.excitation import HarmonicThenStop, released_state
from sim.dynamics.simulate import simulate
from sim.dynamics.trajectory import BaseMotion, FailedSimulation, State
from sim.reference.paper_beam import MEASURED_DAMPING_RATIO, paper_beam

TIP = np.array([0.25, 0.5])


@pytest.fixture(scope="module")
def beam():
    return AncfBeam(paper_beam())


@pytest.fixture(scope="module")
def modes(beam):
    return beam_modes(beam, 8)


def drawn_models(count):
    ratios = np.array(MEASURED_DAMPING_RATIO) * (
        1.0 + 0.05 * np.random.default_rng(3).normal(size=(count, 5))
    )
    return [GenericDamping(tuple(row)) for row in ratios]


# the iteration ends at 2e-9 of a step's displacement beside 5e-10; what it leaves adds up over 200 steps
AGREE = 1e-7


def test_draws_are_what_single_simulations_are(beam, modes):
    models = [*drawn_models(5), RayleighDamping(0.2, 3e-5), NoDamping()]
    states = [released_state(beam, modes, number, 2e-3 / number) for number in (1, 2, 3, 1, 2, 3, 1)]
    omega = np.tile(modes.omega_rad_s[:3], (7, 1)) * (1.0 + 1e-3 * np.arange(7))[:, np.newaxis]
    common = {"duration_s": 0.2, "step_s": 1e-3, "output_positions_m": TIP, "modes": modes, "output_every": 4}
    together = simulate_draws(beam, models, states=states, target_omega_rad_s=omega, **common)
    assert together.alone == 0
    assert together.failed == (None,) * 7
    for d, (model, state) in enumerate(zip(models, states, strict=True)):
        alone = simulate(beam, model, state=state, target_omega_rad_s=omega[d], **common)
        np.testing.assert_allclose(together.time_s, alone.time_s)
        np.testing.assert_allclose(together.transverse_m[d], alone.transverse_m, atol=AGREE * 2e-3)
        np.testing.assert_allclose(together.axial_m[d], alone.axial_m, atol=AGREE * 2e-3)
        np.testing.assert_allclose(
            together.final[d].v, alone.final.v, atol=1e-5 * np.abs(alone.final.v).max()
        )


@pytest.mark.parametrize("velocity", ["relative", "absolute"])
def test_draws_follow_the_base(beam, modes, velocity):
    model = GenericDamping(MEASURED_DAMPING_RATIO, velocity=velocity)
    motion = HarmonicThenStop(1e-4, float(modes.omega_rad_s[1]), 0.15, 0.01)
    common = {
        "duration_s": 0.2, "step_s": 1e-3, "output_positions_m": TIP, "modes": modes,
        "base": BaseMotion.sample(motion, 1e-3, 200),
    }  # fmt: skip
    rest = State(modes.equilibrium, np.zeros(beam.ndof))
    together = simulate_draws(beam, [model] * 2, states=[rest] * 2, **common)
    alone = simulate(beam, model, state=rest, **common)
    np.testing.assert_allclose(together.base_m, alone.base_m)
    np.testing.assert_allclose(together.transverse_m[1], alone.transverse_m, atol=AGREE * 1e-3)


def test_more_draws_than_lanes_and_any_order(beam, modes, monkeypatch):
    monkeypatch.setattr("sim.dynamics.batch.draws.LANES_AT_ONCE", 3)
    models, state = drawn_models(7), released_state(beam, modes, 1, 5e-3)
    common = {"duration_s": 0.05, "step_s": 1e-3, "output_positions_m": TIP, "modes": modes}
    split = simulate_draws(beam, models, states=[state] * 7, **common)
    monkeypatch.setattr("sim.dynamics.batch.draws.LANES_AT_ONCE", 64)
    whole = simulate_draws(beam, models, states=[state] * 7, **common)
    np.testing.assert_allclose(split.transverse_m, whole.transverse_m, atol=AGREE * 5e-3)


def test_what_has_no_lane_is_simulated_alone(beam, modes):
    models = [NoDamping(), WithAirDrag(NoDamping()), RayleighDamping(0.1, 1e-5, constant_stiffness=True)]
    state = released_state(beam, modes, 1, 5e-3)
    common = {"duration_s": 0.05, "step_s": 1e-3, "output_positions_m": TIP, "modes": modes}
    drawn = simulate_draws(beam, models, states=[state] * 3, **common)
    assert drawn.alone == 2
    for d, model in enumerate(models):
        alone = simulate(beam, model, state=state, **common)
        np.testing.assert_allclose(drawn.transverse_m[d], alone.transverse_m, atol=AGREE * 5e-3)


def test_a_hopeless_draw_fails_by_itself(beam, modes):
    rng = np.random.default_rng(5)
    wild = State(rng.normal(size=80) * 0.02 / beam.dof_scale, rng.normal(size=80) * 500.0 / beam.dof_scale)
    rest = released_state(beam, modes, 1, 5e-3)
    drawn = simulate_draws(
        beam, [NoDamping()] * 3, states=[rest, wild, rest], duration_s=0.2, step_s=0.05, output_positions_m=TIP,
        modes=modes,
    )  # fmt: skip
    assert isinstance(drawn.failed[1], FailedSimulation)
    assert drawn.final[1] is None
    assert np.all(np.isnan(drawn.transverse_m[1])), "missing is NaN"
    assert np.all(np.isfinite(drawn.transverse_m[[0, 2]]))
    np.testing.assert_array_equal(drawn.transverse_m[0], drawn.transverse_m[2])


def test_draws_that_do_not_fit_are_refused(beam, modes):
    rest = State(modes.equilibrium, np.zeros(80))
    common = {"duration_s": 0.1, "step_s": 1e-3, "output_positions_m": TIP, "modes": modes}
    with pytest.raises(ValueError, match="one entry a draw each, got 2 and 1"):
        simulate_draws(beam, [NoDamping()] * 2, states=[rest], **common)
    with pytest.raises(ValueError, match="one row a draw: 1, got 2"):
        simulate_draws(beam, [NoDamping()], states=[rest], target_omega_rad_s=np.ones((2, 3)), **common)
    with pytest.raises(ValueError, match=r"state.q must be finite, shape \(80,\)"):
        simulate_draws(beam, [NoDamping()], states=[State(np.zeros(84), np.zeros(80))], **common)

import numpy as np
import pytest

from docs.reference_solutions import (
    damping_and_frequency_error,
    damping_over_a_decay,
    dissipated_damping_ratio,
    energy_above_rest,
    energy_damping_ratio,
    log_energy_slope,
    small_decay,
)
from sim import MEASURED_DAMPING_RATIO, paper_beam
from sim.beam import AncfBeam, beam_modes
from sim.damping import GenericDamping, NoDamping, RayleighDamping
from sim.dynamics import (
    BaseMotion,
    FailedSimulation,
    HarmonicThenStop,
    State,
    released_state,
    shake_and_stop,
    simulate,
    state_from_modes,
)

TIP = np.array([0.5])
GENERIC = GenericDamping(MEASURED_DAMPING_RATIO)


@pytest.fixture(scope="module")
def beam():
    return AncfBeam(paper_beam())


@pytest.fixture(scope="module")
def modes(beam):
    return beam_modes(beam, 8)


@pytest.mark.parametrize("number", range(1, 6))
@pytest.mark.parametrize("step_s", [1e-3, 5e-4])
def test_prescribed_damping_and_frequency_are_reproduced(beam, modes, number, step_s):
    omega = modes.omega_rad_s[number - 1]
    run = small_decay(beam, modes, GENERIC, number, step_s)
    zeta_error, omega_error = damping_and_frequency_error(run, omega, MEASURED_DAMPING_RATIO[number - 1])
    # the discrete pole is exact; the error is the solver tolerance per step, 1e-12 m of 1e-5 m
    assert abs(zeta_error) < 1e-5, f"zeta of mode {number} off by {zeta_error:.2e}"
    assert abs(omega_error) < 1e-6, f"frequency of mode {number} off by {omega_error:.2e}"


@pytest.mark.parametrize("constant_stiffness", [False, True])
def test_rayleigh_damping_follows_its_curve(beam, modes, constant_stiffness):
    model = RayleighDamping.from_modes(
        tuple(modes.omega_rad_s[:2]), MEASURED_DAMPING_RATIO[:2], constant_stiffness=constant_stiffness
    )
    for number in (1, 3, 5):
        omega = modes.omega_rad_s[number - 1]
        zeta = float(model.damping_ratio(omega))
        run = small_decay(beam, modes, model, number, 5e-4)
        # the constant stiffness also damps axial strain, even at 10 um: second order in the amplitude
        tolerance = 1e-3 if constant_stiffness else 1e-5
        assert abs(damping_and_frequency_error(run, omega, zeta)[0]) < tolerance


def test_integrator_has_no_numerical_damping(beam, modes):
    for number in (1, 5):
        run = small_decay(beam, modes, NoDamping(), number, 1e-3)
        zeta = damping_and_frequency_error(run, modes.omega_rad_s[number - 1], 0.0)[0]
        assert abs(zeta) < 1e-6, f"numerical damping ratio {zeta:.1e} of mode {number}"


def test_uncorrected_modes_have_the_period_error_of_the_midpoint_rule(beam, modes):
    """Period error without corrections: 0.7 % for mode 5 at 0.5 ms."""
    coordinate = np.zeros(5)
    coordinate[-1] = 1e-5 / modes.transverse_at(TIP)[0, 4]
    state = state_from_modes(beam, modes, coordinate, np.zeros(5))
    run = simulate(
        beam,
        NoDamping(),
        state=state,
        duration_s=0.5,
        step_s=5e-4,
        output_positions_m=TIP,
        modes=modes.first(1),
    )
    omega, half = modes.omega_rad_s[4], 0.5 * modes.omega_rad_s[4] * 5e-4
    expected = np.arctan(half) / half - 1.0
    assert expected == pytest.approx(-0.0072, abs=3e-4)
    guess = omega * (1.0 + expected)
    assert damping_and_frequency_error(run, guess, 0.0)[1] == pytest.approx(0.0, abs=1e-5)


def test_energy_is_conserved_for_a_minute_at_200_mm(beam, modes):
    state = released_state(beam, modes, 1, 0.2)
    run = simulate(
        beam, NoDamping(), state=state, duration_s=60.0, step_s=1e-3, output_positions_m=TIP, modes=modes,
        output_every=50,
    )  # fmt: skip
    drift = np.abs(run.energy_j / run.energy_j[0] - 1.0).max()
    # 60 000 steps, each with a residual of up to 5e-12 of the displacement per step
    assert drift < 5e-9, f"exact within the solver tolerance; drift of {drift:.1e} in 60 000 steps"
    assert np.abs(run.transverse_m).max() == pytest.approx(0.2, rel=0.02)
    assert run.counts.halvings == 0


def test_mode_2_softens_with_the_square_of_its_amplitude(beam, modes):
    """Axial inertia due to foreshortening: -0.053 % at 5 mm."""
    shifts = []
    for tip_m in (2.5e-3, 5e-3):
        state = released_state(beam, modes, 2, tip_m)
        run = simulate(
            beam, GENERIC, state=state, duration_s=1.0, step_s=1e-3, output_positions_m=TIP, modes=modes
        )
        shifts.append(damping_and_frequency_error(run, modes.omega_rad_s[1], MEASURED_DAMPING_RATIO[1])[1])
    assert shifts[1] == pytest.approx(-5.3e-4, rel=0.05)
    assert shifts[1] / shifts[0] == pytest.approx(4.0, rel=0.02)


def test_rayleigh_damping_with_current_stiffness_at_large_amplitude(beam, modes):
    """From 200 mm: the ratio rises from the prescribed value with the squared amplitude, as the work of C predicts."""
    damping = RayleighDamping.from_modes(tuple(modes.omega_rad_s[:2]), MEASURED_DAMPING_RATIO[:2])
    start = released_state(beam, modes, 1, 0.2)

    def run(model, seconds):
        return simulate(
            beam, model, state=start, duration_s=seconds, step_s=1e-3, output_positions_m=TIP, modes=modes,
            output_every=5,
        )  # fmt: skip

    square, ratio = damping_over_a_decay(run(damping, 12.0), beam, modes, 3.2)
    slope, at_zero = np.polyfit(square, ratio, 1)
    assert at_zero == pytest.approx(MEASURED_DAMPING_RATIO[0], rel=3e-4)
    assert 0.002 < slope / at_zero < 0.005, "0.37 % more at 200 mm"
    # with weak damping the amplitude stays at 200 mm; the ratio there is proportional to the damping
    weak = RayleighDamping(0.01 * damping.alpha_1_s, 0.01 * damping.beta_s)
    weak_run = run(weak, 8.0)
    large = (
        100.0
        * log_energy_slope(weak_run.time_s, energy_above_rest(weak_run, beam, modes))
        / (2.0 * modes.omega_rad_s[0])
    )
    assert large == pytest.approx(dissipated_damping_ratio(beam, modes, damping, start), rel=5e-4)


def test_constant_stiffness_overestimates_the_damping_ratio(beam, modes):
    damping = RayleighDamping.from_modes(
        tuple(modes.omega_rad_s[:2]), MEASURED_DAMPING_RATIO[:2], constant_stiffness=True
    )
    run = simulate(
        beam, damping, state=released_state(beam, modes, 1, 0.02), duration_s=0.6, step_s=1e-3,
        output_positions_m=TIP, modes=modes,
    )  # fmt: skip
    period = 1.0 / modes.frequency_hz[0]
    second = run.transverse_m[(run.time_s > 0.7 * period) & (run.time_s < 1.1 * period), 0].max()
    ratio = np.log(0.02 / second) / (2.0 * np.pi)
    assert ratio > 0.1, f"prescribed 1 %; damping of the axial strain at 20 mm gives {100 * ratio:.1f} %"


def test_generic_damping_decreases_at_large_rotation(beam, modes):
    """Phi is constant while the beam rotates, so C_g acts on a smaller part of the motion."""
    run = simulate(
        beam, GENERIC, state=released_state(beam, modes, 1, 0.2), duration_s=1.1, step_s=1e-3,
        output_positions_m=TIP, modes=modes,
    )  # fmt: skip
    ratio = energy_damping_ratio(run, beam, modes, modes.frequency_hz[0])
    assert 0.008 < ratio < 0.0097


def test_order_of_convergence_is_two(beam, modes):
    damping = RayleighDamping.from_modes(tuple(modes.omega_rad_s[:2]), MEASURED_DAMPING_RATIO[:2])
    state = released_state(beam, modes, 1, 0.05)

    def final(step_s):
        run = simulate(
            beam, damping, state=state, duration_s=0.256, step_s=step_s, output_positions_m=TIP, modes=modes,
            axial_relaxation_s=1e-4,
        )  # fmt: skip
        return run.transverse_m[-1, 0]

    # differences between successively halved steps, without a reference
    ends = [final(h) for h in (2e-3, 1e-3, 5e-4, 2.5e-4)]
    orders = np.log2(np.abs(np.diff(ends)[:-1] / np.diff(ends)[1:]))
    assert np.all((orders > 1.8) & (orders < 2.9)), f"the midpoint rule is of order 2; observed {orders}"
    assert orders[-1] == pytest.approx(2.0, abs=0.15)


def test_target_frequency_is_reached(beam, modes):
    target = modes.omega_rad_s[:3] * np.array([1.0, 1.0, 1.004])
    coordinate = np.array([0.0, 0.0, 1e-5 / modes.transverse_at(TIP)[0, 2]])
    run = simulate(
        beam, GENERIC, state=state_from_modes(beam, modes, coordinate, np.zeros(3)), duration_s=2.0, step_s=5e-4,
        output_positions_m=TIP, modes=modes, target_omega_rad_s=target,
    )  # fmt: skip
    zeta_error, omega_error = damping_and_frequency_error(run, target[2], MEASURED_DAMPING_RATIO[2])
    assert abs(omega_error) < 1e-6
    assert abs(zeta_error) < 1e-4


def test_steady_state_has_the_requested_amplitude(beam, modes):
    run = shake_and_stop(
        beam, GENERIC, modes, mode_number=3, tip_amplitude_m=2e-4, shake_s=1.5, decay_s=1.0, step_s=1e-3, stop_s=2e-3,
        output_positions_m=TIP,
    )  # fmt: skip
    shaking = run.time_s < 1.49
    column = np.exp(1j * modes.omega_rad_s[2] * run.time_s)
    tip = run.transverse_m[:, 0]
    for part in (run.time_s < 0.5, shaking & (run.time_s > 1.0)):
        basis = np.stack([column.real, column.imag], axis=1)[part]
        fitted = np.linalg.lstsq(basis, tip[part], rcond=None)[0]
        assert np.hypot(*fitted) == pytest.approx(2e-4, rel=1e-4)
        assert np.abs(tip[part] - basis @ fitted).max() < 1e-6, "the steady state is harmonic within 0.5 %"
    after = run.time_s > 1.6
    assert np.all(run.base_m[after] == 0.0)
    decay = damping_and_frequency_error(
        type("Run", (), {"time_s": run.time_s[after], "transverse_m": run.transverse_m[after]}),
        modes.omega_rad_s[2],
        MEASURED_DAMPING_RATIO[2],
    )
    assert abs(decay[0]) < 0.01, "modes excited by the stop change a one-mode fit by less than 1 %"


def test_excitation_from_rest_reaches_the_computed_steady_state(beam, modes):
    """Mode 3 of a beam with heavily damped lower modes, so that the transient decays within two seconds."""
    damping = GenericDamping((0.5, 0.1, 0.03))
    direct = shake_and_stop(
        beam, damping, modes, mode_number=3, tip_amplitude_m=2e-4, shake_s=2.0, decay_s=0.1, step_s=1e-3, stop_s=2e-3,
        output_positions_m=TIP,
    )  # fmt: skip
    motion = HarmonicThenStop(float(np.abs(direct.base_m).max()), float(modes.omega_rad_s[2]), 2.0, 2e-3)
    from_rest = simulate(
        beam, damping, state=State(modes.equilibrium, np.zeros(beam.ndof)), duration_s=2.1, step_s=1e-3,
        base=BaseMotion.sample(motion, 1e-3, 2100), output_positions_m=TIP, modes=modes, axial_relaxation_s=1e-4,
    )  # fmt: skip
    late = (direct.time_s > 1.7) & (direct.time_s < 2.0)
    # remaining transient: exp(-0.5 omega_1 1.7 s) = 4e-5, exp(-0.03 omega_3 1.7 s) = 8e-5
    difference = np.abs(direct.transverse_m - from_rest.transverse_m)[late].max()
    assert difference < 2e-3 * 2e-4


def test_base_motion_at_a_stop_ends_at_rest():
    motion = HarmonicThenStop(1e-3, 50.0, 1.0, 0.01)
    time = np.linspace(0.9, 1.1, 20001)
    displacement, velocity = motion(time)
    np.testing.assert_allclose(np.gradient(displacement, time)[1:-1], velocity[1:-1], atol=1e-3 * 0.05)
    assert np.all(displacement[time > 1.0101] == 0.0)
    assert np.abs(np.diff(np.gradient(velocity, time))[1:-1]).max() < 1.0, "the acceleration is continuous"


def test_points_in_image_coordinates(beam, modes):
    state = released_state(beam, modes, 1, 0.05)
    x, y, angle = beam.points(np.array([0.0, 0.25, 0.5]), state.q, 0.01)
    assert x[0] == pytest.approx(0.01)
    assert y[0] == pytest.approx(0.0)
    assert x[2] == pytest.approx(0.06)
    assert -0.5 < y[2] < -0.49, "a hanging beam points down"
    assert angle[2] > 0.1, "deflected to the right, its tip rotates counter-clockwise"
    standing = AncfBeam(paper_beam("standing"))
    deflected = released_state(standing, beam_modes(standing, 2), 1, 0.05)
    x, y, angle = standing.points(TIP, deflected.q)
    assert x[0] == pytest.approx(0.05)
    assert 0.49 < y[0] < 0.5
    assert angle[0] < -0.1, "deflected to the right, the tip of a standing beam rotates clockwise"


def test_too_large_a_step_is_a_failure_with_time_and_reason(beam, modes):
    rng = np.random.default_rng(5)
    extreme = State(rng.normal(size=80) * 0.02 / beam.dof_scale, rng.normal(size=80) * 500.0 / beam.dof_scale)
    failed = simulate(
        beam, NoDamping(), state=extreme, duration_s=1.0, step_s=0.05, output_positions_m=TIP, modes=modes
    )
    assert not failed
    assert isinstance(failed, FailedSimulation)
    assert "did not converge" in failed.reason
    assert failed.time_s == pytest.approx(failed.step * 0.05)


def test_high_modes_at_large_amplitude_do_not_diverge_at_1_ms(beam, modes):
    for number, tip_m in ((3, 0.01), (5, 0.002), (5, 0.003)):
        run = simulate(
            beam, GENERIC, state=released_state(beam, modes, number, tip_m), duration_s=1.0, step_s=1e-3,
            output_positions_m=TIP, modes=modes,
        )  # fmt: skip
        assert run, getattr(run, "reason", "")
        assert run.counts.halvings == 0
        assert np.all(np.isfinite(run.transverse_m))
        assert np.abs(run.transverse_m).max() < 1.3 * tip_m


def test_simulation_is_reproducible(beam, modes):
    runs = [small_decay(beam, modes, GENERIC, 3, 1e-3, 0.2) for _ in range(2)]
    assert runs[0].transverse_m.tobytes() == runs[1].transverse_m.tobytes()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"step_s": 0.0}, "step_s must be finite and positive"),
        ({"duration_s": 1e-4}, "duration_s must be finite and at least 0.001"),
        ({"output_every": 0}, "output_every must be at least 1"),
        ({"state": State(np.zeros(84), np.zeros(80))}, r"state.q must be finite, shape \(80,\)"),
        ({"base": BaseMotion(np.zeros(5), np.zeros(5))}, "must have 101 samples"),
        ({"output_positions_m": np.array([0.6])}, "points must lie between 0 and 0.5 m"),
    ],
)
def test_inconsistent_input_is_refused(beam, modes, change, message):
    arguments = {
        "state": State(modes.equilibrium, np.zeros(80)),
        "duration_s": 0.1,
        "step_s": 1e-3,
        "output_positions_m": TIP,
        "modes": modes,
    } | change
    with pytest.raises(ValueError, match=message):
        simulate(beam, GENERIC, **arguments)

import numpy as np
import pytest
from matplotlib.figure import Figure

from sim.beam import Beam
from sim.damping import GenericDamping, RayleighDamping
from sim.dynamics import SimulationError, simulate_free_decay

BEAM = Beam(length_mm=500, width_mm=5, thickness_mm=0.5, density_kg_m3=8000, elastic_modulus_mpa=210_000)


@pytest.fixture(scope="module")
def decay():
    return simulate_free_decay(BEAM, [0.01, 0.02], mode=2, tip_amplitude_mm=0.5, duration_s=0.5)


def test_tip_starts_at_the_amplitude_and_decays_with_the_damping_ratio(decay):
    assert decay.tip_mm[0] == pytest.approx(0.5, rel=1e-9)
    assert decay.damping == GenericDamping((0.01, 0.02))
    omega = 2 * np.pi * decay.frequency_hz
    expected = 0.5 * np.exp(-0.02 * omega * decay.time_s[-1])
    late = np.abs(decay.tip_mm[decay.time_s > 0.4])
    assert late.max() == pytest.approx(expected * np.exp(0.02 * omega * 0.09), rel=0.1)


def test_tables_and_figures(decay):
    table = decay.to_dataframe()
    assert table.columns.tolist() == ["time_s", "tip_mm"]
    assert len(table) == decay.time_s.size == 1001
    assert repr(decay) == "FreeDecay(mode 2, 10.58 Hz, 0.5 mm at the tip, 0.5 s, 1001 samples)"
    assert repr(decay.trajectory) == "Trajectory(1 points, 1001 times to 0.5 s)"
    ax = Figure().add_subplot()
    assert decay.plot(ax) is ax
    assert decay.trajectory.plot(ax) is ax
    assert decay.trajectory.to_dataframe()["position_mm"].eq(500.0).all()


def test_damping_is_a_ratio_for_every_mode_or_a_model():
    assert simulate_free_decay(
        BEAM, 0.01, mode=3, tip_amplitude_mm=0.1, duration_s=0.01
    ).damping == GenericDamping((0.01, 0.01, 0.01))
    model = RayleighDamping(0.2, 3e-5)
    assert simulate_free_decay(BEAM, model, tip_amplitude_mm=1, duration_s=0.01).damping is model


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"mode": 0}, "mode must be 1 or more"),
        ({"mode": 60}, "mode must be at most 40"),
        ({"duration_s": -1}, "duration_s"),
    ],
)
def test_invalid_arguments_are_refused(changes, expected):
    with pytest.raises(ValueError, match=expected):
        simulate_free_decay(BEAM, 0.01, **{"tip_amplitude_mm": 1, "duration_s": 0.01, **changes})


def test_a_simulation_that_diverges_raises():
    with pytest.raises(SimulationError, match="did not converge"):
        simulate_free_decay(
            BEAM, RayleighDamping(0.0, -1e-2), tip_amplitude_mm=100, duration_s=1.0, step_s=1e-2
        )

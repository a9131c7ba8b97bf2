import numpy as np
import pytest
from scipy.integrate import solve_ivp

from modal_id import flags
from modal_id.fit.decay import (
    complex_amplitude,
    damping_ratio,
    free_decay,
    frequency_hz,
    initial_conditions,
    pole,
)


def test_equation_1_solves_the_equation_of_motion():
    omega, zeta, x0, v0 = 11.6, 0.02, 3.0, -8.0
    t = np.linspace(0.0, 4.0, 50)
    solution = solve_ivp(
        lambda _, s: [s[1], -2.0 * zeta * omega * s[1] - omega**2 * s[0]],
        (0.0, 4.0),
        [x0, v0],
        t_eval=t,
        rtol=1e-10,
        atol=1e-12,
    )
    # The integrator's tolerance, a hundredfold for its accumulation over 7 cycles.
    np.testing.assert_allclose(free_decay(t, omega, zeta, x0, v0), solution.y[0], atol=1e-8)


def test_complex_amplitude_is_equation_1():
    omega, zeta, x0, v0 = 64.0, 0.0028, -1.2, 30.0
    t = np.linspace(0.0, 2.0, 301)
    root = complex(pole(omega, zeta))
    c = complex_amplitude(root, x0, v0)
    np.testing.assert_allclose((c * np.exp(root * t)).real, free_decay(t, omega, zeta, x0, v0), atol=1e-12)
    np.testing.assert_allclose(initial_conditions(root, c), (x0, v0), rtol=1e-12)


def test_pole_gives_back_frequency_and_damping():
    root = pole(2.0 * np.pi * 26.84, 0.0028)
    assert float(frequency_hz(root)) == pytest.approx(26.84, rel=1e-12)
    assert float(damping_ratio(root)) == pytest.approx(0.0028, rel=1e-12)


def test_every_flag_has_a_text_and_unknown_ones_are_refused():
    names = [flag.name for flag in flags.REGISTRY]
    assert len(set(names)) == len(names)
    assert all(len(flags.describe(name)) > 20 for name in names)
    with pytest.raises(ValueError, match="SHORT_RECORD"):
        flags.describe("SHORT_RECRD")

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from modal_id.fit.poles import damping_ratio, frequency_hz, mode_functions, pole


def test_eq_1_solves_the_equation_of_motion():
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
    root = complex(pole(omega, zeta))
    # Displacement and velocity at 0 of Re(c exp(root t)).
    c = complex(x0, -(v0 - root.real * x0) / root.imag)
    motion = np.real(mode_functions(t, np.array([root]))[:, 0] * c)
    # The integrator's tolerance times 100, for the accumulation over 7 cycles.
    np.testing.assert_allclose(motion, solution.y[0], atol=1e-8)


def test_pole_converts_to_frequency_and_damping():
    root = pole(2.0 * np.pi * 26.84, 0.0028)
    assert float(frequency_hz(root)) == pytest.approx(26.84, rel=1e-12)
    assert float(damping_ratio(root)) == pytest.approx(0.0028, rel=1e-12)

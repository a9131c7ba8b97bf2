import numpy as np
import pytest
from scipy.integrate import solve_ivp

from modal_id.data import FitData, baseline_matrix
from modal_id.solve import (
    ModeColumns,
    Problem,
    damping_ratio,
    frequency_hz,
    mode_functions,
    pole,
    solve_linear,
)


def test_eq_1_solves_the_equation_of_motion():
    omega, zeta, x0, v0 = 11.6, 0.02, 3.0, -8.0
    t = np.linspace(0.0, 4.0, 50)

    def slopes(_, s):
        return [s[1], -2.0 * zeta * omega * s[1] - omega**2 * s[0]]

    solution = solve_ivp(slopes, (0.0, 4.0), [x0, v0], t_eval=t, rtol=1e-10, atol=1e-12)
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


@pytest.mark.parametrize("used", [1, 2])
def test_amplitudes_that_the_used_samples_do_not_determine_are_finite(used):
    """The offset explains one sample; rounding leaves a Gram matrix of either sign."""
    for n in range(8, 40):
        time = np.arange(n) * 0.004
        weights = np.zeros((n, 1))
        weights[-used:] = 0.98368132
        problem = Problem(FitData(time, np.cos(767.0 * time)[:, None], weights), np.ones((n, 1)))
        linear = solve_linear(problem, ModeColumns(time, np.array([-5.0 + 767.0j])))
        assert np.all(np.isfinite(linear.amplitudes))
        # the ridge of 1e-13 of the products allows an error of their square root
        assert float(linear.rss[0]) < 1e-6


def test_a_motion_that_is_over_where_the_samples_count_has_no_amplitude():
    """Its columns are 0 there but for rounding errors of the products, which no factorisation may take for values."""
    step_s, unused = 0.068176407, 20
    t = np.arange(1257) * step_s
    weights = np.where(t[:, None] < (unused - 0.5) * step_s, 0.0, 1.0)
    noise = np.random.default_rng(1).standard_normal((t.size, 1))
    problem = Problem(FitData(t, noise, weights), baseline_matrix(t, 0.4613))
    found = solve_linear(problem, ModeColumns(t, np.array([-12.85026537 + 17.06402828j])))
    # Less than the noise is left of it at the first sample that counts.
    assert abs(found.amplitudes[0, 0]) * np.exp(-12.85 * unused * step_s) < 1.0

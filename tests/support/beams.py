"""Roots of the frequency equations of beams in closed form, and the slopes of a family of beams."""

import numpy as np
from scipy.optimize import brentq

from sim.beam import AncfBeam, beam_modes


def first_roots(determinant, count):
    """The lowest `count` roots, of which the last is below (count + 1) pi, and none below 0.5 but rigid motion."""
    grid = np.linspace(0.5, (count + 1) * np.pi, 400)
    values = np.array([determinant(x) for x in grid])
    at = np.flatnonzero(values[:-1] * values[1:] < 0.0)[:count]
    return np.array([brentq(determinant, grid[i], grid[i + 1], xtol=1e-13) for i in at])


def assert_exact_sensitivities(family, u):
    """Frequencies of the beam at `u`, and their slopes by the last two variables as central differences."""
    found = family.modes(u, slopes=True)
    exact = beam_modes(AncfBeam(family.properties(u)), 4).frequency_hz
    np.testing.assert_allclose(found.frequency_hz[0], exact, rtol=1e-9)
    step = 1e-3
    for k in (-2, -1):
        moved = np.zeros(u.size)
        moved[k] = step
        ends = [np.log(family.modes(u + sign * moved).frequency_hz[0]) for sign in (1, -1)]
        # the square of the step, and an equilibrium known to 1e-12 of the length, 1e-9 of a frequency, over the step
        expected = (ends[0] - ends[1]) / (2 * step)
        np.testing.assert_allclose(found.log_frequency_slopes[0][:, k], expected, atol=5e-7)

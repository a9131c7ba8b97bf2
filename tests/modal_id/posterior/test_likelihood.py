"""Density from moments, compared with sums over all samples."""

import numpy as np
import pytest
from support.modal_decays import dirty

from modal_id.data.prepare import prepare
from modal_id.fit.linear import solve_linear
from modal_id.fit.model_order import find_modes
from modal_id.fit.poles import mode_functions
from modal_id.posterior.mode_posterior import determine_mode


def test_reduced_density_equals_that_of_all_samples():
    """log p from moments agrees with the projection of all samples, within 5 sd of the centre."""
    model = find_modes(prepare(dirty(1, 1)).data, 8)
    mode = determine_mode(model, 0)
    density = mode.density
    positions = np.random.default_rng(0).uniform(-5, 5, (40, 2)) / np.sqrt(2)
    got = density(positions)
    others = model.fit.poles[1:]

    def chi_square(omega, zeta):
        pole = omega * (-zeta + 1j * np.sqrt(1 - zeta**2))
        functions = mode_functions(model.data.time_s, np.concatenate([[pole], others]))
        return solve_linear(model.problem, functions).rss[0] / model.fit.linear.noise_variance[0]

    best = chi_square(*density.centre)
    nu, factor = density.noise.dof, density.noise.factor
    for position, value in zip(positions, got, strict=True):
        omega, zeta = (density.centre[i] + density.scale[i] * position[i] for i in range(2))
        drop = chi_square(omega, zeta) - best
        # The density also shifts the pole of the other mode; the coupling is below 2 % here.
        expected = -0.5 * (nu + 2) * np.log1p(drop / (nu * factor**2))
        assert value == pytest.approx(expected, abs=1e-3 * (1 + abs(expected)))

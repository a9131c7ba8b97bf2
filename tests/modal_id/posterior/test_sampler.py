"""Sampling of a mode: the ensembles are independent of each other, and draw from the density."""

import emcee
import numpy as np
import pytest
from kit.series import one_mode
from scipy.special import stdtrit

from modal_id import SamplerSettings
from modal_id.data import prepare
from modal_id.fit import find_modes
from modal_id.posterior import autocorrelation_times, determine_mode, polar_proposal, sample


@pytest.fixture(scope="module")
def density():
    series, _ = one_mode(2, 1, fps=500.0, duration_s=5.0)
    return determine_mode(find_modes(prepare(series).data, 1), 0).density


def streams(seeds):
    return tuple(np.random.SeedSequence(seed) for seed in seeds)


def test_the_draws_of_an_ensemble_do_not_depend_on_the_others(density):
    settings = SamplerSettings(max_steps=100)
    one, other = (sample(density, 0.0, settings, streams(s)) for s in ((1, 2, 3, 4), (9, 2, 7, 8, 6)))
    assert np.array_equal(one.zeta[1], other.zeta[1])
    assert np.array_equal(one.omega_n_rad_s[1], other.omega_n_rad_s[1])
    assert not np.array_equal(one.zeta[0], other.zeta[0])


def test_draws_have_the_quantiles_of_the_density(density):
    draws = sample(density, 0.0, SamplerSettings(), streams(range(4)))
    standard = (draws.zeta - density.centre[1]) / density.scale[1]
    # Near its centre the density is that of Student's t: chi-square is a parabola there.
    expected = stdtrit(density.noise.dof, np.array([0.05, 0.25, 0.5, 0.75, 0.95]))
    found = np.quantile(standard, [0.05, 0.25, 0.5, 0.75, 0.95])
    # Of the extreme quantiles, p = 0.05: the sd is sqrt(p (1 - p) / n) over the density, about 0.11.
    sd = np.sqrt(0.05 * 0.95 / draws.ess[1]) / 0.11
    assert np.all(np.abs(found - expected) < 4.0 * sd + 0.02), f"{found} for {expected}, sd {sd:.3f}"


@pytest.mark.parametrize(("correlation", "least"), [(0.0, 0.9), (-0.9, 0.7)])
def test_draws_of_a_truncated_skewed_density_far_from_its_approximation(correlation, least):
    """Means and standard deviations are those of sums over a fine grid; the corner of a wedge is 1.5 sd away."""

    def log_density(x):
        inside = (np.hypot(*x.T) < 10.0) & (x[:, 1] > -1.5)
        value = -2.5 * np.log1p((0.3 * (x[:, 0] - 1.0) ** 2 + 0.1 * (x[:, 1] - x[:, 0]) ** 2) / 3.0)
        return np.where(inside, value, -np.inf)

    proposal = polar_proposal(log_density, correlation, 10.0)
    rng = np.random.default_rng(1)
    draws = proposal.draw(rng.random((100_000, 3)))
    weight = np.exp(log_density(draws) - proposal(draws))
    effective = np.sum(weight) ** 2 / np.sum(weight**2)
    # Importance weights that vary by a third on average leave 90 % of the draws; cells that lie across the density, as
    # those with a correlation of the wrong sign do, leave fewer.
    assert effective > least * len(draws), f"{effective:.0f} effective draws of {len(draws)}"
    grid = np.stack(np.meshgrid(*2 * [np.linspace(-10.0, 10.0, 801)]), axis=-1).reshape(-1, 2)
    density = np.exp(log_density(grid))
    mean = np.average(grid, axis=0, weights=density)
    sd = np.sqrt(np.average((grid - mean) ** 2, axis=0, weights=density))
    found = np.average(draws, axis=0, weights=weight)
    spread = np.sqrt(np.average((draws - found) ** 2, axis=0, weights=weight))
    # Kurtosis of at most 6; the grid's cells at the edge of the density add 0.0125 at most.
    error = 4.0 * sd / np.sqrt(effective)
    assert np.all(np.abs(found - mean) < error + 0.0125), f"means {found} for {mean}, error {error}"
    assert np.all(np.abs(spread - sd) < 1.5 * error + 0.0125), f"sd {spread} for {sd}"


def test_autocorrelation_times_are_those_of_emcee():
    rng = np.random.default_rng(0)
    size = (2, 80, 16, 2)
    chains = 0.3 * np.cumsum(rng.standard_normal(size), axis=1) + rng.standard_normal(size)
    expected = [emcee.autocorr.integrated_time(one, tol=0) for one in chains]
    np.testing.assert_allclose(autocorrelation_times(chains), expected, rtol=1e-9)

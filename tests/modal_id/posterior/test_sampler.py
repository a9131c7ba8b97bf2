"""Sampling of a mode: the ensembles are independent of each other, and draw from the density."""

import numpy as np
import pytest
from scipy.special import stdtrit
from support.modal_decays import one_mode

from modal_id.data.prepare import prepare
from modal_id.fit.model_order import find_modes
from modal_id.posterior.mode_posterior import determine_mode
from modal_id.posterior.sampler import sample
from modal_id.settings import SamplerSettings


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

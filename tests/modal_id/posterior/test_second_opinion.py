"""The subspace method beside the order selection, and the sampler's density against sums over every sample."""

import numpy as np
import pytest
from support.modal_decays import PAPER_HZ, dirty, one_mode

from modal_id.data.prepare import prepare
from modal_id.fit.amplitude import bent_decay, fit_amplitude_dependence
from modal_id.fit.decay import frequency_hz
from modal_id.fit.linear import solve_linear
from modal_id.fit.order import find_modes
from modal_id.fit.subspace import stability_diagram
from modal_id.fit.varpro import mode_functions
from modal_id.posterior.mode import determine_mode
from modal_id.posterior.noise import noise_level
from modal_id.posterior.sampler import autocorrelation_steps


def model_of(series):
    return find_modes(prepare(series).data, 8)


@pytest.mark.parametrize("mode", range(5))
def test_subspace_confirms_the_modes_that_are_there_and_no_other(mode):
    model = model_of(one_mode(mode, 3, fps=500.0, duration_s=6.0)[0])
    diagram = stability_diagram(model.data, model.fit.linear.baseline, float(np.max(PAPER_HZ)))
    assert diagram.confirms(PAPER_HZ[mode])
    elsewhere = [f for f in np.geomspace(1.5, 200.0, 100) if abs(f / PAPER_HZ[mode] - 1) > 0.05]
    # 1 to 2 % over many records: poles of noise are steady by chance.
    assert np.mean([diagram.confirms(f) for f in elsewhere]) < 0.08


def test_subspace_confirms_through_gaps_drift_and_a_neighbour():
    model = model_of(dirty(1, 0))
    diagram = stability_diagram(model.data, model.fit.linear.baseline, PAPER_HZ[2])
    assert diagram.confirms(PAPER_HZ[1])
    assert diagram.confirms(PAPER_HZ[2])


def test_reduced_density_is_that_of_every_sample():
    """log p of the moments against the projection of all samples, within 5 sd."""
    model = model_of(dirty(1, 1))
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
    nu, factor = density.noise.freedom, density.noise.factor
    for position, value in zip(positions, got, strict=True):
        omega, zeta = (density.centre[i] + density.scale[i] * position[i] for i in range(2))
        drop = chi_square(omega, zeta) - best
        # The other mode's pole moves along in the density: its coupling here is below 2 %.
        expected = -0.5 * (nu + 2) * np.log1p(drop / (nu * factor**2))
        assert value == pytest.approx(expected, abs=1e-3 * (1 + abs(expected)))


def test_derivatives_of_the_bent_decay():
    t = np.sort(np.random.default_rng(0).uniform(0, 5, 4000))
    at = np.array([0.4, 60.0, 0.15, 0.3])
    slopes = bent_decay(t, at).slopes
    for i, step in enumerate((1e-6, 1e-6, 1e-6, 1e-6)):
        up, down = at.copy(), at.copy()
        up[i] += step
        down[i] -= step
        numeric = (bent_decay(t, up).wave - bent_decay(t, down).wave) / (2 * step)
        # Central differences: step^2 times the third derivative, t^3 = 125 at most, and rounding over the step.
        np.testing.assert_allclose(slopes[:, i], numeric, atol=1e-8)


def test_autocorrelation_time_of_a_known_process():
    """AR(1) with coefficient a has (1 + a) / (1 - a)."""
    rng = np.random.default_rng(0)
    x = np.zeros((4000, 64, 2))
    for i in range(1, 4000):
        x[i] = 0.5 * x[i - 1] + rng.standard_normal((64, 2))
    # Sokal's window of five times itself leaves exp(-5) of it and scatter of sqrt(20 / 256000).
    np.testing.assert_allclose(autocorrelation_steps(x), 3.0, rtol=0.03)


@pytest.mark.parametrize(("mode", "ar"), [(0, 0.0), (4, 0.0), (0, 0.9), (2, 0.9)])
def test_noise_level_is_unbiased(mode, ar):
    """Against the spectrum of AR(1) at the mode: 1 for white noise, that is."""
    ratio = []
    for seed in range(12):
        model = model_of(one_mode(mode, seed, ar=ar)[0])
        index = int(np.argmin(np.abs(frequency_hz(model.fit.poles) - PAPER_HZ[mode])))
        level = noise_level(model, fit_amplitude_dependence(model.problem, model.fit, index), index)
        truth = (1 - ar**2) / abs(1 - ar * np.exp(-2j * np.pi * PAPER_HZ[mode] / 1000)) ** 2
        ratio.append(level.factor**2 / truth)
        freedom = level.freedom
    error = np.sqrt(2 / freedom / len(ratio))
    assert np.mean(ratio) == pytest.approx(1.0, abs=3.5 * error), f"sd of the mean is {error:.3f}"

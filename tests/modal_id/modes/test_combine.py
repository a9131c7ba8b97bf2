import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from modal_id.modes import between_interval, combine, mpc


def test_consistent_values_give_the_weighted_mean():
    found = combine([1.0, 1.2], [0.1, 0.2])
    # Weights 100 and 25, computed by hand.
    assert found.value == pytest.approx((100.0 + 30.0) / 125.0)
    assert found.sd == pytest.approx(125.0**-0.5)
    assert found.between_sd == 0.0
    assert found.chi_square == pytest.approx(100 * 0.04**2 + 25 * 0.16**2)
    assert not found.disagree


def test_inconsistent_values_are_widened_and_flagged():
    found = combine([1.0, 2.0], [0.01, 0.01])
    # Equal weights: between-variance is the sample variance, 0.5, minus theirs; sd of the mean is half the difference.
    assert found.value == pytest.approx(1.5)
    assert found.between_sd == pytest.approx(np.sqrt(0.5 - 1e-4))
    assert found.sd == pytest.approx(0.5)
    assert found.disagree
    assert not np.isfinite(combine([1.0], [0.1]).p_value)


def test_coverage_with_random_effects():
    rng = np.random.default_rng(3)
    inside = []
    for _ in range(2000):
        sd = rng.uniform(0.5, 2.0, 8)
        x = rng.standard_normal(8) * np.hypot(sd, 2.0)
        found = combine(x, sd)
        inside.append(abs(found.value) < 1.645 * found.sd)
    # The Paule-Mandel variance of 8 values has 7 degrees of freedom: a normal 90 % interval covers 85 to 90 %.
    assert 0.84 < np.mean(inside) < 0.91


@pytest.mark.parametrize(
    ("values", "sds"), [([], []), ([1.0], [0.0]), ([np.nan], [1.0]), ([1.0, 2.0], [1.0])]
)
def test_invalid_values_are_refused(values, sds):
    with pytest.raises(ValueError, match="positive standard deviations"):
        combine(values, sds)


def test_modal_phase_collinearity():
    real = np.array([0.1, -0.5, 1.0])
    assert mpc(real * np.exp(0.7j)) == pytest.approx(1.0)
    assert mpc(np.exp(2j * np.pi * np.arange(3) / 3)) == pytest.approx(0.0, abs=1e-12)
    assert np.isnan(mpc(np.array([1.0 + 1j])))
    # Phases of 0 and 90 degrees at two positions of equal amplitude: a travelling wave.
    assert mpc(np.array([1.0, 1j])) == pytest.approx(0.0, abs=1e-12)


def restricted_likelihood_sd(x, sd):
    """Standard deviation between values by restricted maximum likelihood, from its definition."""

    def minus_log_likelihood(variance):
        total = sd**2 + variance
        mean = np.sum(x / total) / np.sum(1.0 / total)
        return 0.5 * (np.sum(np.log(total) + (x - mean) ** 2 / total) + np.log(np.sum(1.0 / total)))

    return minimize_scalar(minus_log_likelihood, bounds=(0.0, 100.0), method="bounded").x ** 0.5


def test_scatter_between_values_and_its_interval_on_simulated_runs():
    rng, true = np.random.default_rng(5), 2.0
    found, likely, covered = [], [], []
    for _ in range(400):
        sd = rng.uniform(0.5, 2.0, 10)
        x = 7.0 + rng.standard_normal(10) * np.hypot(sd, true)
        found.append(combine(x, sd).between_sd ** 2)
        likely.append(restricted_likelihood_sd(x, sd) ** 2)
        low, high = between_interval(x, sd)
        covered.append(low <= true <= high)
    se = np.std(found) / 20.0
    assert abs(np.mean(found) - true**2) < 3.0 * se, f"mean {np.mean(found)}, three standard errors {3 * se}"
    # Both are consistent estimates of one variance: they differ by less than a fifth of their own scatter.
    assert np.mean(np.abs(np.subtract(found, likely))) < 0.2 * np.std(likely)
    assert np.corrcoef(found, likely)[0, 1] > 0.97
    # Three standard errors of a share of 0.9 in 400.
    assert abs(np.mean(covered) - 0.9) < 0.045


def test_scatter_is_that_of_the_values_at_any_scale():
    x, sd = np.array([1.0, 1.6, 0.7]), np.array([0.2, 0.3, 0.1])
    whole = (combine(x, sd).between_sd, *between_interval(x, sd))
    for scale in (1e-7, 1e6):
        scaled = (combine(scale * x, scale * sd).between_sd, *between_interval(scale * x, scale * sd))
        # Rounding errors alone differ.
        np.testing.assert_allclose(np.array(scaled) / scale, whole, rtol=1e-6)


def test_one_value_says_nothing_of_the_scatter():
    assert between_interval([3.0], [0.1]) == (0.0, np.inf)

"""Scores compared with their definitions, and standard errors compared with the scatter over noise realisations."""

import numpy as np
import pytest
from kit.series import coloured
from scipy.integrate import quad
from scipy.stats import norm

from sim.comparison import Prediction, Samples, ScoreSum, crps, log_density, score_difference, score_sum

FREQUENCY_HZ, RATIO, FPS, NOISE = 10.0, 0.004, 200.0, 0.05
TIME_S = np.arange(1200) / FPS


def decay(ratio):
    omega = 2.0 * np.pi * FREQUENCY_HZ
    return (np.exp(-ratio * omega * TIME_S) * np.cos(omega * TIME_S))[:, np.newaxis]


def test_scores_match_their_definitions():
    for sample, mean, sd in [(0.3, 0.1, 0.5), (-2.0, 1.0, 0.4), (0.0, 0.0, 2.0)]:
        below = quad(lambda y: norm.cdf(y, mean, sd) ** 2, -40.0, sample, points=[mean])[0]  # noqa: B023
        above = quad(lambda y: norm.sf(y, mean, sd) ** 2, sample, 40.0, points=[mean])[0]  # noqa: B023
        values = (np.array(sample), np.array(mean), np.array(sd))
        assert float(crps(*values)) == pytest.approx(below + above, rel=1e-6)
        assert float(log_density(*values)) == pytest.approx(norm.logpdf(sample, mean, sd), rel=1e-12)


@pytest.mark.parametrize(("colour", "score"), [(0.0, log_density), (0.9, log_density), (0.9, crps)])
def test_standard_error_matches_the_scatter_over_noise_realisations(colour, score):
    """The scatter of the score difference over 250 recordings of one decay equals the reported standard error."""
    rng = np.random.default_rng(11)
    true, wrong = decay(RATIO), decay(1.3 * RATIO)
    sd = np.full(true.shape, NOISE)
    one, other = Prediction(true, sd), Prediction(wrong, 1.1 * sd)
    used = np.ones(true.shape, dtype=bool)
    used[100:140] = False
    found = []
    for _ in range(250):
        values = true + NOISE * coloured(rng, TIME_S.size, colour)[:, np.newaxis]
        samples = Samples(TIME_S, values, used, true, sd, 1.0 / FREQUENCY_HZ)
        found.append(score_difference(samples, score, one, other))
    scatter = np.std([difference.total for difference in found])
    stated = np.sqrt(np.mean([difference.se**2 for difference in found]))
    # scatter of 250 recordings: sd of 4.5 %; Bartlett weights underestimate correlated noise by a few percent
    assert stated == pytest.approx(scatter, rel=0.15)


def test_sums_over_recordings_are_additive():
    both = ScoreSum(3.0, 0.3, 10) + ScoreSum(1.0, 0.4, 30)
    assert both == ScoreSum(4.0, pytest.approx(0.5), 40)
    assert both.mean == pytest.approx(0.1)
    assert both.standard_errors == pytest.approx(8.0)


def test_missing_samples_are_ignored():
    true = decay(RATIO)
    values = true + NOISE * np.random.default_rng(2).standard_normal(true.shape)
    used = np.ones(true.shape, dtype=bool)
    sd = np.full(true.shape, NOISE)
    used[50:70] = False
    gappy = values.copy()
    gappy[50:70] = np.nan
    full = Samples(TIME_S, values, used, true, sd, 0.1)
    prediction = Prediction(true, sd)
    assert score_sum(full, crps, prediction) == score_sum(
        Samples(TIME_S, gappy, used, true, sd, 0.1), crps, prediction
    )
    nothing = Samples(TIME_S, gappy, np.zeros_like(used), true, sd, 0.1)
    assert np.isnan(score_sum(nothing, crps, prediction).total)

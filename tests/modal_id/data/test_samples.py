import numpy as np

from modal_id.data import FitData


def test_averages_around_missing_samples_stand_at_the_time_of_the_others():
    """Of a motion at angular frequency w, samples within a span h differ from its mean by at most (w h)^2 / 8."""
    omega, step, factor = 2 * np.pi, 0.01, 5
    time = np.arange(1003) * step
    seen = np.random.default_rng(3).random(time.size) < 0.4
    seen[40:50] = False
    data = FitData(time, np.where(seen, np.cos(omega * time), 0.0)[:, None], seen[:, None].astype(float))
    means = data.averaged(factor)
    known = means.weights[:, 0] > 0.0
    error = means.values[known, 0] - np.cos(omega * means.time_s[known])
    assert np.max(np.abs(error)) < (omega * factor * step) ** 2 / 8
    np.testing.assert_allclose(np.diff(means.time_s[8:10]), factor * step, rtol=1e-9)
    assert np.count_nonzero(~known) >= 2
    assert np.all(means.values[~known] == 0.0)


def test_averages_of_complete_data_are_plain_means():
    values = np.random.default_rng(1).standard_normal((12, 2))
    data = FitData(np.arange(12.0), values, np.ones((12, 2)))
    means = data.averaged(3)
    np.testing.assert_allclose(means.time_s, [1.0, 4.0, 7.0, 10.0])
    np.testing.assert_allclose(means.values, values.reshape(4, 3, 2).mean(axis=1))
    assert np.all(means.weights == 3.0)

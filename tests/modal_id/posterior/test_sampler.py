import numpy as np

from modal_id.posterior.sampler import autocorrelation_steps


def test_autocorrelation_time_of_a_known_process():
    """AR(1) with coefficient a has (1 + a) / (1 - a)."""
    rng = np.random.default_rng(0)
    x = np.zeros((4000, 64, 2))
    for i in range(1, 4000):
        x[i] = 0.5 * x[i - 1] + rng.standard_normal((64, 2))
    # Sokal's window of five times itself leaves exp(-5) of it and scatter of sqrt(20 / 256000).
    np.testing.assert_allclose(autocorrelation_steps(x), 3.0, rtol=0.03)

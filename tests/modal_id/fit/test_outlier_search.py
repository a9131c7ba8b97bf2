import numpy as np
import pytest

from modal_id.data import FitData
from modal_id.fit import find_modes
from modal_id.solve import damping_ratio, frequency_hz

FPS, NOISE = 4000.0, 0.07


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_knock_at_the_start_hides_no_mode_that_decays_early(seed):
    rng = np.random.default_rng(seed)
    t = np.arange(int(0.8 * FPS)) / FPS
    y = NOISE * rng.standard_normal(t.size)
    for f, zeta, a in ((16.3, 0.005, 8.6), (107.9, 0.01, 0.45)):
        omega = 2 * np.pi * f
        y += a * np.exp(-zeta * omega * t) * np.cos(omega * np.sqrt(1 - zeta**2) * t + 0.4)
    knocked = y.copy()
    knocked[:5] += (5.0, 6.5, 6.0, 4.0, 1.2)
    fits = [find_modes(FitData(t, v[:, None], np.ones((t.size, 1))), 4) for v in (y, knocked)]
    for fit in fits:
        assert frequency_hz(fit.fit.poles).size == 2, f"two modes, found at {frequency_hz(fit.fit.poles)} Hz"
    assert not np.any(fits[1].data.weights[:5])
    assert np.count_nonzero(fits[1].data.weights == 0.0) < 12, "the motion itself is no outlier"
    # five of the 285 samples in which the fast mode has its energy: a shift by a share of its standard deviation
    sd = fits[0].fit.pole_sd[1]
    clean, other = fits[0].fit.poles[1], fits[1].fit.poles[1]
    assert abs(other.real - clean.real) < sd[0]
    assert abs(other.imag - clean.imag) < sd[1]
    assert damping_ratio(other) == pytest.approx(0.01, abs=4 * sd[0] / (2 * np.pi * 107.9))

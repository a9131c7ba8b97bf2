import numpy as np
import pytest
from kit.series import PAPER_HZ, one_mode

from modal_id.data import prepare
from modal_id.fit import find_modes, fit_amplitude_dependence
from modal_id.posterior import noise_level
from modal_id.solve import frequency_hz


@pytest.mark.parametrize(
    ("mode", "ar"),
    [(0, 0.0), (2, 0.9), *(pytest.param(*one, marks=pytest.mark.slow) for one in [(4, 0.0), (0, 0.9)])],
)
def test_noise_level_is_unbiased(mode, ar):
    """Compare with the spectrum of AR(1) at the mode, which is 1 for white noise."""
    ratio = []
    for seed in range(6):
        model = find_modes(prepare(one_mode(mode, seed, ar=ar)[0]).data, 8)
        index = int(np.argmin(np.abs(frequency_hz(model.fit.poles) - PAPER_HZ[mode])))
        level = noise_level(model, fit_amplitude_dependence(model.problem, model.fit, index), index)
        truth = (1 - ar**2) / abs(1 - ar * np.exp(-2j * np.pi * PAPER_HZ[mode] / 1000)) ** 2
        ratio.append(level.factor**2 / truth)
        dof = level.dof
    error = np.sqrt(2 / dof / len(ratio))
    assert np.mean(ratio) == pytest.approx(1.0, abs=3.5 * error), f"sd of the mean is {error:.3f}"

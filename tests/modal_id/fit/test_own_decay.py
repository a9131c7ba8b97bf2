"""The samples of one mode, averaged, against all samples of the record."""

import numpy as np

from modal_id.data import FitData
from modal_id.fit import find_modes, own_decay
from modal_id.solve import frequency_hz, gauss_newton

NOISE_SD = 1e-4


def test_averages_of_uneven_samples_have_the_pole_and_the_noise_of_all_samples():
    rng = np.random.default_rng(1)
    time_s = np.arange(4000) / 1000
    waves = (np.exp(2 * np.pi * f * complex(-zeta, 1) * time_s) for f, zeta in ((8.0, 0.004), (90.0, 0.002)))
    weights = np.where(rng.random(time_s.size) < 0.3, 0.4, 1.0)
    weights[rng.random(time_s.size) < 0.05] = 0.0
    noise = NOISE_SD / np.sqrt(np.maximum(weights, 0.1)) * rng.standard_normal(time_s.size)
    values = sum(wave.real for wave in waves) + noise
    model = find_modes(FitData(time_s, values[:, None], weights[:, None]), 4)
    mode = int(np.argmin(frequency_hz(model.fit.poles)))
    own = own_decay(model, mode)
    assert own.problem.data.time_s.size < 1000
    pole = gauss_newton(own.problem, own.fit.poles).poles[0]
    moved = np.abs([pole.real - model.fit.poles[mode].real, pole.imag - model.fit.poles[mode].imag])
    # the averages lose 1.3 % of the information: they differ by the root of it, 0.11 sd
    assert np.all(moved < 4.0 * 0.11 * model.fit.pole_sd[mode]), moved / model.fit.pole_sd[mode]
    # of 500 averages, to 6 %
    assert abs(np.sqrt(own.fit.linear.noise_variance[0]) / NOISE_SD - 1.0) < 0.15

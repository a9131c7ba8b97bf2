"""Stable poles of the subspace method confirm the modes of the fit and no other frequency."""

import numpy as np
import pytest
from kit.series import PAPER_HZ, dirty, one_mode

from modal_id.data import FitData, prepare
from modal_id.fit import find_modes, stability_diagram
from modal_id.solve import damping_ratio, frequency_hz


def model_of(series):
    return find_modes(prepare(series).data, 8)


@pytest.mark.parametrize("mode", range(5))
def test_subspace_confirms_only_the_true_modes(mode):
    model = model_of(one_mode(mode, 3, fps=500.0, duration_s=6.0)[0])
    diagram = stability_diagram(model.data, model.fit.linear.baseline, float(np.max(PAPER_HZ)))
    assert diagram.confirms(PAPER_HZ[mode])
    elsewhere = [f for f in np.geomspace(1.5, 200.0, 100) if abs(f / PAPER_HZ[mode] - 1) > 0.05]
    # 1 to 2 % over many records: some noise poles are stable by chance.
    assert np.mean([diagram.confirms(f) for f in elsewhere]) < 0.08


def test_subspace_confirms_with_gaps_drift_and_a_neighbouring_mode():
    model = model_of(dirty(1, 0))
    diagram = stability_diagram(model.data, model.fit.linear.baseline, PAPER_HZ[2])
    assert diagram.confirms(PAPER_HZ[1])
    assert diagram.confirms(PAPER_HZ[2])


def test_poles_of_a_mode_are_stable_from_low_orders_on_and_have_its_damping():
    model = model_of(one_mode(2, 3, fps=500.0, duration_s=4.0)[0])
    diagram = stability_diagram(model.data, model.fit.linear.baseline, PAPER_HZ[2])
    assert not diagram.stable(0).any(), "nothing stands before the first order"
    shares, spread = [], []
    for index in range(1, len(diagram.orders)):
        poles, stable = diagram.poles[index], diagram.stable(index)
        own = np.abs(frequency_hz(poles) / PAPER_HZ[2] - 1.0) < 0.01
        shares.append(bool(np.any(stable & own)))
        spread += list(damping_ratio(poles[stable & own]))
    assert np.mean(shares) > 0.8
    # The criterion itself is 20 % from one order to the next.
    assert np.median(spread) == pytest.approx(model.fit.poles.real[0] / -abs(model.fit.poles[0]), rel=0.1)


def test_a_mode_of_many_channels_is_confirmed():
    series = one_mode(0, 3, fps=500.0, duration_s=6.0)[0]
    size = np.linspace(0.1, 1.0, 60)
    values = series.values[:, :1] * size + 1e-3 * np.random.default_rng(4).standard_normal((3000, 60))
    data = FitData(series.time_s, values, np.ones_like(values))
    highest_hz = PAPER_HZ[3]
    assert 240 // 60 / (5.0 * highest_hz) < 0.1 / PAPER_HZ[0], "lags of all channels at once would miss it"
    diagram = stability_diagram(data, np.zeros_like(values), highest_hz)
    assert diagram.confirms(PAPER_HZ[0])
    assert not diagram.confirms(0.8 * highest_hz)

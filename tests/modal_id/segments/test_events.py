"""Events that interrupt a free motion, and what only looks like one."""

import numpy as np
import pytest
from kit.series import decay

from modal_id.data import FitData, without_spikes
from modal_id.segments import find_events


@pytest.mark.parametrize("seed", range(3, 6))
def test_a_second_mode_that_decays_sooner_is_no_click(seed):
    """In the first 3 s windows of two cycles of the strongest mode do not join: too long to leave out and judge."""
    rng = np.random.default_rng(seed)
    t = 0.003 * np.arange(26000)
    y = decay(t, 26.8, 3.4e-4, 1.0, 0.3) + decay(t, 6.1, 0.004, 0.2, 0.0) + 0.05 * np.sin(0.3 * t)
    y += 0.0115 * rng.standard_normal(t.size)
    assert find_events(FitData(t, y[:, None], np.ones((t.size, 1))), (26.8,), 0.0) == ([], [])


def driven_until(t, stop_s):
    """A steady motion of 20 Hz that ends, and with it all motion."""
    return np.where(t < stop_s, np.cos(2 * np.pi * 20.0 * t), 0.0)


@pytest.mark.parametrize("outliers", [0, 40])
def test_a_stop_in_a_gap_is_an_event(outliers):
    """No window about the stop has samples, and outliers are larger than the motion."""
    rng = np.random.default_rng(outliers)
    t = np.arange(1200) / 200.0
    y = driven_until(t, 2.1) + 0.05 * rng.standard_normal(t.size)
    hit = rng.choice(t.size, outliers, replace=False)
    y[hit] += rng.choice([-1.0, 1.0], outliers) * rng.uniform(1.0, 3.0, outliers)
    weights = np.where((t > 2.0) & (t < 2.3), 0.0, 1.0)[:, None]
    data = FitData(t, y[:, None] * weights, weights)
    found, _ = find_events(without_spikes(data), (20.0,), 0.0)
    (event,) = [one for one in found if one.kind != "burst"]
    assert event.kind == "fall"
    # Windows of two cycles at every half cycle, of which the last and the first are without the gap.
    assert 2.0 - 0.025 <= event.start_s <= 2.1
    assert 2.1 <= event.end_s <= 2.3 + 0.025


def test_a_decay_goes_on_across_a_gap():
    """The amplitude has fallen by two thirds when it is seen again, as the decay before it predicts."""
    rng = np.random.default_rng(0)
    t = np.arange(1200) / 200.0
    y = decay(t, 20.0, 0.004, 1.0, 0.3) + 0.01 * rng.standard_normal(t.size)
    weights = np.where((t > 1.5) & (t < 3.7), 0.0, 1.0)[:, None]
    assert find_events(FitData(t, y[:, None] * weights, weights), (20.0,), 0.0) == ([], [])


def test_a_decay_whose_damping_grows_with_the_amplitude_is_not_cut_beside_weak_modes():
    """Two weak modes die within a third of it: what only one side of a place shows is no change of the motion."""
    rng = np.random.default_rng(7)
    t = np.arange(4800) / 400.0
    # a' = -s a (1 + q a), and a frequency that falls by 1.3 % with the amplitude
    s, q, falls = 16 * np.pi * 10 ** rng.uniform(-2.6, -1.9), rng.uniform(0.5, 3), rng.uniform(0, 0.015)
    left = 1 + q - q * np.exp(-s * t)
    y = np.exp(-s * t) / left * np.cos(16 * np.pi * (t - falls * np.log(left) / (s * q)))
    y += decay(t, 50.0, 0.008, 0.2, 1.0) + decay(t, 24.3, 0.01, 0.1, 1.0)
    y += 0.0005 * rng.standard_normal(t.size)
    events, _ = find_events(FitData(t, y[:, None], np.ones((t.size, 1))), (8.0, 50.0), 0.0)
    assert not [one for one in events if one.kind != "burst"], events

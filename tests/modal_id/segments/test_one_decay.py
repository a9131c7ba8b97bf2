"""One decay, or driving that is followed by one, seen in windows of two cycles."""

import numpy as np
import pytest
from kit.series import pole_of

from modal_id.data import FitData
from modal_id.segments import may_be_two_decays, short_time

HZ, ZETA, NOISE = 12.0, 0.003, 0.02
TIME_S = np.arange(6000) / 150.0


def judged(motion, seed, channels):
    rng = np.random.default_rng(seed)
    y = motion[:, None] * np.linspace(1.0, 0.5, channels) + NOISE * rng.standard_normal(
        (TIME_S.size, channels)
    )
    envelope = short_time(FitData(TIME_S, y, np.ones(y.shape)), HZ * 1.002)
    return may_be_two_decays(envelope, np.ones(envelope.time_s.size, dtype=bool))


@pytest.mark.parametrize("channels", [1, 4])
def test_noise_around_one_decay_rarely_calls_for_a_search(channels):
    motion = np.exp(pole_of(HZ, ZETA) * TIME_S + 0.4j).real
    called = sum(judged(motion, seed, channels) for seed in range(40))
    # The check saves time only where it rarely calls for a search: at most in one record of five.
    assert called <= 8


@pytest.mark.parametrize("channels", [1, 4])
@pytest.mark.parametrize("stop_s", [2.0, 8.0, 20.0])
@pytest.mark.parametrize("detuned", [0.0, 0.004])
def test_driving_that_ends_is_seen(stop_s, channels, detuned):
    """Driving of 2 s, while the free motion would lose a third of its amplitude, and driving off the resonance."""
    since = TIME_S - stop_s
    driven = np.cos(2.0 * np.pi * HZ * (1.0 + detuned) * since + 0.4)
    motion = np.where(since < 0.0, driven, np.exp(pole_of(HZ, ZETA) * since + 0.4j).real)
    assert all(judged(motion, seed, channels) for seed in range(5))

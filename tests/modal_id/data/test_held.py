"""Series that hold each sample: the lowest alias, flagged with the others; and series that do not."""

from dataclasses import replace

import numpy as np
import pytest
from kit.identified import quick
from kit.series import pole_of, series_of

from modal_id import ModeFlag
from modal_id.data import sampled_rows
from tracker import KnownInput


def held_decay(seed, *, empty=False):
    """A decay below half the rate of its samples, each of which stands `held` times; series, frequency and `held`."""
    rng = np.random.default_rng([seed, 33])
    rate_hz, held = float(np.exp(rng.uniform(*np.log([100.0, 2000.0])))), int(rng.integers(2, 17))
    hz = rate_hz / held * rng.uniform(0.03, 0.45)
    n = int(min(max(60.0 * rate_hz / hz, 320 * held), 30_000))
    sample = np.arange(n) // held
    shape = rng.uniform(0.3, 1.0, int(rng.integers(1, 4)))
    pole = pole_of(hz, 10.0 ** rng.uniform(-3.0, -2.0))
    motion = np.real(np.exp(pole * sample * held / rate_hz + 2j * np.pi * rng.random()))[:, None] * shape
    noise = 10.0 ** -rng.uniform(1.0, 2.5) * rng.standard_normal((n // held + 1, shape.size))
    values = motion + noise[sample]
    if empty:
        values[np.arange(n) % held > 0] = np.nan
    return series_of(np.arange(n) / rate_hz, values), hz, rate_hz / held


def check(seeds):
    for seed in seeds:
        series, hz, sampled_hz = held_decay(seed, empty=seed % 9 == 8)
        found = quick(series)
        best = max(found.modes, key=lambda mode: mode.amplitude)
        limit = max(5.0 * best.frequency_sd_hz, 1e-3 * hz)
        assert abs(best.frequency_hz - hz) < limit, f"seed {seed}: expected {hz:.5g} Hz, found {best}"
        assert ModeFlag.ALIASED_POSSIBLE.name in best.flags
        assert any(f"{sampled_hz - best.frequency_hz:.4g}, " in note for note in best.notes), best.notes
        assert found.fitted.shape == series.values.shape
        assert not np.any(found.used[np.isnan(found.fitted)])


def test_the_lowest_alias_is_found_and_flagged():
    check(range(4, 9))


@pytest.mark.slow  # the reduced version is above
def test_ninety_held_series_are_right_and_flagged():
    check(range(90))


def test_an_input_that_is_not_used_has_all_rows():
    """An input beside held samples, with the request to ignore it: once refused for its number of rows."""
    series, hz, _ = held_decay(4)
    beside = KnownInput("base", np.zeros(series.time_s.size), "mm")
    found = quick(replace(series, known_input=beside), output_only=True)
    assert abs(found.target.frequency_hz - hz) < max(5.0 * found.target.frequency_sd_hz, 1e-3 * hz)


def test_series_that_hold_nothing_are_used_whole():
    """Coarse converters, missing samples, a frozen stretch and every tenth sample doubled."""
    rng = np.random.default_rng(9)
    for i in range(120):
        rate_hz, n = float(np.exp(rng.uniform(*np.log([50.0, 4000.0])))), int(rng.integers(200, 3000))
        hz = rate_hz * 10.0 ** rng.uniform(-2.5, -0.35)
        time_s = np.arange(n) / rate_hz
        y = np.real(np.exp(pole_of(hz, 10.0 ** rng.uniform(-3.5, -2.0)) * time_s))[:, None] * np.ones(2)
        y += 10.0 ** rng.uniform(-4.0, -1.0) * rng.standard_normal(y.shape)
        step = (0.0, 0.0, 1e-3, 1e-2, 0.05)[i % 5]
        y = np.round(y / step) * step if step else y
        if i % 7 == 0:
            y[rng.random(n) < 0.3] = np.nan
        if i % 11 == 0:
            y[n // 2 : n // 2 + 20] = y[n // 2]
        if i % 13 == 0:
            y = y[np.arange(n) - (np.arange(n) % 10 == 9)]
        assert sampled_rows(series_of(time_s, y)) is None, f"case {i}: {hz:.4g} Hz at {rate_hz:.4g} Hz"

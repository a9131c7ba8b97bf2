"""Division of a record where its motion changes."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kit.series import decay
from scipy.optimize import least_squares

from modal_id.data import FitData
from modal_id.segments import best_division, find_changes, find_events, stretch_costs

HZ, RATE = 5.0, 60.0


def data_of(t, y, noise, seed):
    values = y[:, None] + noise * np.random.default_rng(seed).standard_normal((t.size, 1))
    return FitData(t, values, np.ones(values.shape))


def changed_motion(kind, t, at):
    """A motion that changes at a time: it is plucked, held, or was driven at another frequency until then."""
    since = np.maximum(t - at, 0.0)
    if kind == "pluck":
        return np.where(t < at, decay(t, HZ, 0.004, 1.0, 0.3), decay(since, HZ, 0.004, 1.0, 2.0))
    if kind == "hand":
        size = np.exp(-2 * np.pi * HZ * (0.003 * np.minimum(t, at) + 0.08 * since))
        return size * np.cos(2 * np.pi * HZ * t)
    free = decay(since, HZ, 0.01, 1.0, 0.0)
    return np.where(t < at, np.cos(2 * np.pi * 1.02 * HZ * (t - at)), free)


@pytest.mark.parametrize("noise", [0.003, 0.1])
@pytest.mark.parametrize("kind", ["pluck", "hand", "drive"])
def test_a_change_is_found_within_its_limits(kind, noise):
    rng = np.random.default_rng(7)
    t = np.arange(1500) / RATE
    for seed in range(6):
        at = float(rng.uniform(6.0, 16.0))
        found = find_changes(data_of(t, changed_motion(kind, t, at), noise, seed), (HZ,), 0.0)
        assert len(found) == 1, f"{kind} at {at:.2f} s: {found}"
        # The block of two cycles that holds the change may belong to either side, and noise moves it by one.
        assert found[0].low_s - 2.0 / HZ <= at <= found[0].high_s + 2.0 / HZ, f"{kind} at {at:.2f} s: {found}"


def test_a_loud_decay_of_a_quiet_record_is_no_part_of_its_release():
    """Rest, a release in the middle of a block, a decay far above the noise, and a hand after 30 s that stops it.

    Three fifths of the record are quiet: blocks of the decay leave far more than the median one.
    """
    t = np.arange(4200) / RATE
    since = np.maximum(t - 5.1, 0.0)
    held = np.maximum(t - 30.0, 0.0)
    # solution of a' = -z w a (1 + 3 a), held from then on
    free = 1.0 / (4.0 * np.exp(2 * np.pi * HZ * 0.001 * (since - held)) - 3.0)
    y = np.where(t < 5.1, 0.0, free * np.exp(-2 * np.pi * HZ * 0.08 * held) * np.cos(2 * np.pi * HZ * since))
    # as a whole, the decay may be a click
    found = [
        part for one in find_changes(data_of(t, y, 1e-4, 1), (HZ,), 0.0) for part in one.instead or (one,)
    ]
    # Blocks of two cycles: a release disturbs one, and is known to those beside it.
    assert any(one.low_s < 5.1 < one.high_s < 5.1 + 12.0 / HZ for one in found), found
    assert any(x.low_s - 2.0 / HZ < 30.0 < x.high_s + 2.0 / HZ and x.low_s > 25.0 for x in found), found


@pytest.mark.parametrize("count", [30, pytest.param(400, marks=pytest.mark.slow)])
def test_noise_about_one_decay_seldom_is_an_event(count):
    """Two modes, or damping that grows with the amplitude: the division proposes, one motion or two decide."""
    rng = np.random.default_rng(3)
    t = np.arange(1500) / RATE
    divided = 0
    for seed in range(count):
        zeta, noise = 10 ** rng.uniform(-4.0, -1.5), 10 ** rng.uniform(-3.0, -0.5)
        y = decay(t, HZ, zeta, 1.0, rng.uniform(0, 6)) + decay(t, 1.3 * HZ, zeta, 0.5, rng.uniform(0, 6))
        if seed % 2:
            # solution of a' = -z w a (1 + a)
            size = 1.0 / (2.0 * np.exp(2 * np.pi * HZ * zeta * t) - 1.0)
            y = size * np.cos(2 * np.pi * HZ * t)
        divided += bool(find_events(data_of(t, y, noise, seed), (HZ, 1.8 * HZ), 0.0)[0])
    # The criterion costs a false event ln n of 300 samples: one record in a hundred or so.
    assert divided <= 0.05 * count, f"{divided} of {count} records divided"


def test_a_change_between_long_blocks_is_narrowed():
    """2000 cycles in at most 128 blocks of sixteen: the limits are those of blocks of two."""
    t = np.arange(24000) / RATE
    (found,) = find_changes(data_of(t, changed_motion("pluck", t, 233.3), 0.01, 1), (HZ,), 0.0)
    assert found.high_s - found.low_s < 8.0 / HZ
    assert found.low_s - 2.0 / HZ <= 233.3 <= found.high_s + 2.0 / HZ


def test_cycles_of_a_fast_line_that_a_block_of_a_slow_one_holds_are_not_lost():
    """Rest, a release, and 3.5 s later a hand; two cycles of the slow line last 2 s."""
    t = np.arange(1700) / RATE
    since, held = np.maximum(t - 6.0, 0.0), np.maximum(t - 9.5, 0.0)
    y = sum(
        size
        * np.exp(-2 * np.pi * hz * (0.003 * (since - held) + 0.06 * held))
        * np.cos(2 * np.pi * hz * since + 1)
        for hz, size in ((HZ, 1.0), (0.2 * HZ, 0.3))
    )
    found = find_changes(data_of(t, np.where(t < 6.0, 0.0, y), 0.01, 1), (HZ, 0.2 * HZ), 0.0)
    for at in (6.0, 9.5):
        # a block of two cycles, and one that noise adds
        near = [one for one in found if one.low_s - 2.0 / HZ <= at <= one.high_s + 2.0 / HZ]
        assert near, f"{at} s: {found}"
        assert all(one.high_s - one.low_s <= 8.0 / HZ for one in near), found


@given(log_scale=st.floats(-6, 6), later=st.integers(0, 400))
@settings(max_examples=8, deadline=None)
def test_unit_and_what_precedes_do_not_matter(log_scale, later):
    t = np.arange(1500) / RATE
    data = data_of(t, changed_motion("pluck", t, 12.0), 0.01, 2)
    scaled = FitData(t, 10**log_scale * data.values, data.weights)
    assert find_changes(scaled, (HZ,), 0.0) == find_changes(data, (HZ,), 0.0)
    (found,) = find_changes(data, (HZ,), later / RATE)
    assert found.low_s - 2.0 / HZ <= 12.0 <= found.high_s + 2.0 / HZ


def test_the_division_is_the_best_of_all():
    """Against every division of eight blocks."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        cost = np.triu(rng.exponential(1.0, (9, 9)), 1)
        sums = [
            sum(cost[a, b] for a, b in zip((0, *cuts), (*cuts, 8), strict=True))
            for count in range(8)
            for cuts in combinations(range(1, 8), count)
        ]
        assert sum(cost[one] for one in best_division(cost)) == pytest.approx(min(sums), rel=1e-12)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("waves", [0, 1, 1.5, 2])
def test_costs_are_those_of_the_least_squares(waves, channels):
    """Against a general optimizer from the true parameters, which Gauss-Newton has to find by itself."""
    rng = np.random.default_rng(int(10 * waves) + channels)
    n, penalty = 24, 4.0
    x = np.arange(n) - 0.5 * (n - 1)
    first = -0.05 + 0.4j
    true = {0: [], 1: [first], 1.5: [first, 0.004 - 0.003j], 2: [first, -0.1 - 0.7j]}[waves]
    size = 20.0 * np.exp(1j * rng.uniform(0, 6, (2, channels)))

    def shapes(parameters):
        z = np.array(parameters[::2]) + 1j * np.array(parameters[1::2])
        if waves == 1.5:
            return np.exp(z[0] * x + z[1] * x**2)[:, None]
        return np.exp(np.outer(x, z))

    def left(parameters):
        columns = shapes(parameters)
        rest = a - columns @ np.linalg.lstsq(columns, a, rcond=None)[0] if waves else a
        return np.sqrt(2.0) * np.concatenate([rest.real.ravel(), rest.imag.ravel()])

    start = [part for z in true for part in (z.real, z.imag)]
    a = (rng.standard_normal((n, channels)) + 1j * rng.standard_normal((n, channels))) / np.sqrt(2.0)
    if waves:
        columns = shapes(start)
        a = a + columns @ size[: columns.shape[1]]
    cost, outer = (stretch_costs(a, 0.0, penalty, inner) for inner in (1, 0))
    assert np.array_equal(outer[0], cost[0])
    assert np.array_equal(outer[:, n], cost[:, n])
    if not waves:
        variance = max(float(np.mean(np.abs(a) ** 2)), 1.0)
        expected = 2.0 * a.size * np.log(variance) + 2.0 * float(np.sum(np.abs(a) ** 2)) / variance + penalty
        assert cost[0, n] == pytest.approx(expected, rel=1e-12)
        return
    parameters = {1: 2 + 2 * channels, 1.5: 4 + 2 * channels, 2: 4 + 4 * channels}[waves]
    best = 2.0 * least_squares(left, start).cost + parameters * penalty
    # Three steps of Gauss-Newton: within a tenth of what one parameter costs.
    assert best - 1e-6 * best <= cost[0, n] <= best + 0.1 * penalty

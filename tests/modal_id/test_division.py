"""Records of several modes whose motion changes: the change is found, and what follows or precedes it is answered."""

from dataclasses import replace

import numpy as np
import pytest
from kit.identified import in_sd, quick
from kit.series import decay, errors_of_positions, series_of

from modal_id import IdentifySettings, identify
from modal_id.data import prepare
from modal_id.fit import find_modes, misfit
from modal_id.segments import likeliest_change

T = np.arange(3000) / 200.0
# Two modes as close as two cycles of the slower cannot separate.
MODES = ((9.2, 0.004, 1.0), (6.1, 0.002, 0.6))
CHANGE_S = 6.3
NOISE = 0.005


def motion(since, phases=(0.0, 0.0)):
    return sum(decay(since, f, z, a, p) for (f, z, a), p in zip(MODES, phases, strict=True))


def records():
    """Records with a change at CHANGE_S, by what happens there."""
    after = T >= CHANGE_S
    since = T[after] - CHANGE_S
    plucked, stopped, released = motion(T), motion(T), np.zeros(T.size)
    plucked[after] = motion(since, (1.5, -0.7))
    stopped[after] *= np.exp(-12.0 * since)
    # A drive at 9.2 Hz that stops, and a decay within four cycles.
    released = 0.8 * np.cos(2 * np.pi * 9.2 * (T - CHANGE_S))
    released[after] = 0.8 * decay(since, 9.2, 0.06, 1.0, 0.0)
    damped = np.where(
        T < CHANGE_S, released, 0.8 * decay(np.clip(T - CHANGE_S, 0.0, None), 9.2, 0.3, 1.0, 0.0)
    )
    return {"pluck": plucked, "hand": stopped, "end of driving": released, "strongly damped": damped}


def noisy(values, seed=1):
    return values + NOISE * np.random.default_rng(seed).standard_normal(values.size)


def fit_of(values):
    return find_modes(prepare(series_of(T, values)).data, 8)


@pytest.mark.parametrize("noise", [0.0005, 0.005, 0.05])
def test_free_decays_leave_nothing_beyond_the_noise(noise):
    values = motion(T) + noise * np.random.default_rng(2).standard_normal(T.size)
    # A window of 22 samples exceeds three times the lower quartile with a probability below 1e-7.
    assert misfit(fit_of(values)).share == 0.0


@pytest.mark.parametrize("name", list(records()))
def test_a_change_leaves_unexplained_motion_and_is_found(name):
    model = fit_of(noisy(records()[name]))
    assert misfit(model).share > 0.01
    change = likeliest_change(model.data, (MODES[0][0],))
    assert change.low_s < CHANGE_S < change.high_s
    assert change.high_s - change.low_s < 8.0 / MODES[0][0], "an edge is known to two blocks of two cycles"


@pytest.mark.parametrize(
    ("name", "truth"),
    [
        # plucks and a stop by hand are in test_ordinary_truths.py
        ("end of driving", ((9.2, 0.06, 0.8),)),
        ("strongly damped", ((9.2, 0.3, 0.8),)),
    ],
)
def test_the_decays_about_a_change_are_answered(name, truth):
    found = quick(series_of(T, noisy(records()[name])))
    assert len(found.modes) == len(truth)
    for mode, (f, z, _) in zip(found.modes, sorted(truth), strict=True):
        assert np.max(np.abs(in_sd(mode, f, z))) < 4.0, mode
        assert mode.damping_ratio_sd < 0.1 * z, f"{mode}: the undisturbed part determines zeta to a few %"


@pytest.mark.parametrize("seed", [*(pytest.param(seed, marks=pytest.mark.slow) for seed in (3,)), 7])
def test_what_a_codec_leaves_out_is_no_change_of_the_motion(seed):
    """Some stretches of 0.2 s lack 1.5 sd of a position of the amplitude, as after a key frame; others nothing.

    Without its errors the record is divided.
    """
    rng, sd = np.random.default_rng(seed), 0.02
    f, z, _ = MODES[0]
    wave = np.exp(2.0 * np.pi * f * complex(-z, np.sqrt(1.0 - z**2)) * T)
    amplitude = 0.3 * np.abs(wave)
    lost = 1.5 * sd * rng.integers(0, 2, int(5.0 * T[-1]) + 1)[(5.0 * T).astype(int)]
    values = (amplitude - np.minimum(lost, amplitude)) * np.real(wave) / np.abs(wave)
    values = values + sd * rng.standard_normal(T.size)
    sds = {"shrinkage": 0.5 * sd, "shrinkage_sd": 0.45 * sd, "lag_sd": 0.25 * sd, "frame_s": 1.0 / 200.0}
    predicted = errors_of_positions(1, rows=0, period_px=8.0, along_px=1.0, predicted=True, **sds)
    series = replace(series_of(T, values), position_errors=predicted)
    found = quick(series)
    assert len(found.segments) == 1, found.segments
    alone = quick(series_of(T, values))
    assert len(alone.segments) > 1, "the motion is a free decay without the errors, too"
    mode = found.target
    assert np.max(np.abs(in_sd(mode, f, z))) < 4.0, mode


def test_a_motion_whose_phase_jumps_has_no_damping_ratio():
    """The phase jumps every 0.4 s, within the six cycles of the shortest piece: at most the frequency is known."""
    rng = np.random.default_rng(5)
    t = T[:800]
    phase = np.repeat(rng.uniform(-np.pi, np.pi, 10), 80)
    found = quick(series_of(t, noisy(np.cos(2 * np.pi * 9.2 * t + phase))))
    if found:
        assert found.modes == ()
        for line in found.driven[:1]:
            error = abs(line.frequency_hz - 9.2)
            assert error < 4.0 * line.frequency_sd_hz, f"{line} for 9.2 Hz"


@pytest.mark.parametrize(("onset_s", "kind"), [(None, "driven"), (0.0, "decay")])
def test_a_motion_that_hardly_decays_is_driven_unless_the_user_calls_it_free(onset_s, kind):
    """A line without damping until a pluck: 58 cycles in noise of 20 % cannot tell a zeta of 1e-4 from none."""
    since = np.clip(T - CHANGE_S, 0.0, None)
    values = np.where(T < CHANGE_S, decay(T, 9.2, 0.0, 1.0, 0.0), decay(since, 9.2, 0.01, 2.0, 2.2))
    series = series_of(T, values + 0.2 * np.random.default_rng(4).standard_normal(T.size))
    first = identify(series, IdentifySettings(onset_s=onset_s)).segments[0]
    assert (first.kind, first.start_s) == (kind, 0.0)


def test_dry_friction_is_answered_with_wide_intervals():
    """A pendulum whose amplitude falls by the same amount each cycle: no constant damping ratio, one frequency."""
    t = np.arange(900) / 60.0
    amplitude = np.maximum(40.0 - 2.6 * t, 0.0)
    y = amplitude * np.cos(2 * np.pi * 0.71 * t) + 0.05 * np.random.default_rng(8).standard_normal(t.size)
    found = quick(series_of(t, y))
    assert abs(found.target.frequency_hz - 0.71) < 4.0 * found.target.frequency_sd_hz
    # The equivalent damping ratio c / (omega A) over the amplitudes from the largest to a third of it.
    lowest, highest = (2.6 / (2 * np.pi * 0.71 * a) for a in (40.0, 40.0 / 3.0))
    low, high = found.target.damping_ratio + 2.0 * found.target.damping_ratio_sd * np.array([-1, 1])
    assert low < lowest
    assert high > highest

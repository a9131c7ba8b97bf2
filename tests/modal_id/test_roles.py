"""A decay that goes on while it is held, beside decays of one structure that differ by chance."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kit.identified import quick
from kit.series import series_of

from modal_id.segments import roles_of

FPS, FREQUENCY_HZ, ZETA = 100.0, 6.0, 0.002
# Change of the log amplitude of a decay of 10 s, its standard deviation, and the phase.
RADIANS = 2.0 * np.pi * FREQUENCY_HZ * 10.0
EARLIER = ZETA * RADIANS, 2e-5 * RADIANS, RADIANS


def series(parts, seed=0, noise=2e-3):
    """One motion through parts of (seconds, damping ratio, amplitude at its start or None where it goes on)."""
    omega, amplitude, values = 2.0 * np.pi * FREQUENCY_HZ, 1.0, []
    for seconds, zeta, start in parts:
        amplitude = amplitude if start is None else start
        size = amplitude * np.exp(-zeta * omega * np.arange(1, round(seconds * FPS) + 1) / FPS)
        values.append(size)
        amplitude = size[-1]
    size = np.concatenate(values)
    time_s = np.arange(size.size) / FPS
    noise_px = noise * np.random.default_rng(seed).standard_normal(size.size)
    return series_of(time_s, size * np.cos(omega * time_s + 0.4) + noise_px)


@pytest.mark.parametrize("held", [0.05, pytest.param(0.03, marks=pytest.mark.slow)])
def test_what_a_hand_holds_is_no_damping_of_the_structure(held):
    """The interval is that of the 6 s before, 5 % wide, and does not reach to the ratio of the hand's part."""
    found = quick(series([(6.0, ZETA, None), (4.0, held, None)]))
    target = found.target
    assert abs(target.damping_ratio - ZETA) < 4.0 * target.damping_ratio_sd, target
    assert target.damping_ratio_sd < 0.1 * ZETA, target
    assert any(s.kind == "disturbed" and "Held" in s.note for s in found.segments), found.segments


def test_decays_that_differ_as_those_of_a_clamp_do_are_combined():
    """Three plucks, the last with 1.3 times the damping: its scatter is part of the interval."""
    plucks = [(10.0, ZETA, 1.0), (10.0, ZETA, 0.9), (10.0, 1.3 * ZETA, 0.8)]
    target = quick(series(plucks)).target
    assert (len(target.decays), "DECAYS_DIFFER" in target.flags) == (3, False)
    assert abs(target.damping_ratio - 1.3 * ZETA) < 4.0 * target.damping_ratio_sd, target


@given(st.floats(1.0, 99.0), st.floats(1e-3, 0.3), st.floats(0.0, 1.0))
def test_odds_of_a_hand_grow_with_the_ratio_and_fall_with_its_uncertainty(ratio, relative_sd, driven):
    def held(times, sd):
        zeta = times * ZETA
        found = roles_of(*EARLIER, driven, (zeta, sd * zeta))
        assert sum(found) == pytest.approx(1.0)
        return found.held / max(found.free, 1e-300)

    assert held(1.01 * ratio, relative_sd) >= held(ratio, relative_sd)
    # far out, and above the damping of any hand, doubt about the ratio speaks for equal ratios
    assert driven == 1.0 or held(10.0, 1.0) < held(10.0, relative_sd)


@pytest.mark.parametrize(
    "parts", [[(4.0, 0.05, 1.0), (6.0, ZETA, 0.5)], [(6.0, ZETA, 1.0), (4.0, 0.05, 3.0)]]
)
def test_an_earlier_or_larger_motion_is_not_held(parts):
    """Damping that grows with the amplitude does the same: the mean may be that of neither."""
    found = quick(series(parts))
    assert not any("Held" in s.note for s in found.segments), found.segments
    assert "DECAYS_DIFFER" in found.target.wrong_flags


def test_before_a_much_stronger_damping_the_earlier_motion_is_a_drive_as_far_as_it_may_be():
    """A hand has a tenth of the prior, spread over ln(0.7 / 0.01), and a drive ln(0.5 / 1e-5): Bayes' theorem.

    Of free motions a fiftieth grow, and tell nothing of what follows.
    """
    short = 0.02, 0.02, 60.0
    alone, found = roles_of(*short).driven, roles_of(*short, after=(30.0 * ZETA, ZETA))
    drive, hand = alone / np.log(0.5 / 1e-5), (1.0 - alone) * 0.1 / np.log(0.7 / 0.01)
    assert found.driven / (found.driven + found.held) == pytest.approx(drive / (drive + hand), rel=0.02)
    growing = roles_of(-0.01, *short[1:], after=(30.0 * ZETA, ZETA))
    assert growing.driven > found.driven, "no decay is known before"


def test_a_decay_after_what_may_be_a_drive_is_as_uncertain_as_that():
    """Eight cycles keep their amplitude, then 16 lose it with a ratio of 0.05: a drive that stops, or a hand."""
    target = quick(series([(1.34, 1e-4, None), (2.7, 0.05, None)])).target
    assert "MAY_BE_HELD" in target.wrong_flags, target
    doubt = target.posterior.errors["held"][1]
    assert 0.2 < doubt / target.damping_ratio < 0.8, "the root of the probability of a hand, of 5 to 60 %"
    known = np.std(target.posterior.sampled.damping_ratio)
    assert abs(target.damping_ratio - 0.05) < 4.0 * known + 0.02 * doubt, (
        "the median of 4000 draws is that exact"
    )


def test_a_hand_that_damps_strongly_raises_the_natural_frequency_and_not_that_of_the_oscillation():
    """A damping ratio of .35 at the same oscillation is a natural frequency 6.8 % higher: no mode of its own."""
    free, hand, omega = 5e-4, 0.35, 2.0 * np.pi * FREQUENCY_HZ
    t = np.arange(960) / FPS
    held_s = np.maximum(t - 6.0, 0.0)
    size = np.exp(-free * omega * np.minimum(t, 6.0) - hand / np.sqrt(1.0 - hand**2) * omega * held_s)
    noise = 5e-4 * np.random.default_rng(4).standard_normal(t.size)
    found = quick(series_of(t, size * np.cos(omega * t + 0.4) + noise))
    assert [mode.target for mode in found.modes] == [True], found.modes
    assert abs(found.target.damping_ratio - free) < 4.0 * found.target.damping_ratio_sd, found.target

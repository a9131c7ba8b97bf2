"""Ordinary records: their parts; right within three standard deviations, at most five times the Cramer-Rao bound."""

import inspect

import numpy as np
import pytest
from kit.identified import quick
from kit.series import (
    clamp,
    repeated_end,
    ruler,
    ruler_with_click,
    series_of,
    several_plucks,
    slipping_clamp,
    steady_drive,
    stopped_by_hand,
    strongly_damped,
)

from modal_id.posterior import modal_bound

MOST_SD, MOST_BOUNDS = 3.0, 5.0


def identified(time_s, values):
    return quick(series_of(time_s, values))


def bound_of_decay(time_s, frequency_hz, zeta, amplitudes, noise_sd):
    found = modal_bound(
        time_s - time_s[0], frequency_hz, zeta, np.array(amplitudes), 0.7, np.full(len(amplitudes), noise_sd)
    )
    return found.frequency_sd_hz, found.damping_sd


def bound_of_law(motion, noise_sd):
    """Of frequency and zeta at zero amplitude, from the derivatives of the motion by all parameters of its law."""
    values = {name: one.default for name, one in inspect.signature(motion).parameters.items()}
    columns = []
    for name, value in values.items():
        step = 1e-5 * (abs(value) or 1.0)
        high, low = (motion(**{**values, name: value + sign * step}) for sign in (1.0, -1.0))
        columns.append((high - low) / (2.0 * step))
    slopes = np.column_stack([*columns, np.ones(columns[0].size)]) / noise_sd
    scale = np.linalg.norm(slopes, axis=0)
    covariance = np.linalg.inv((slopes / scale).T @ (slopes / scale))
    sd = np.sqrt(np.diag(covariance)) / scale
    return sd[list(values).index("frequency_hz")], sd[list(values).index("zeta")]


def undamped_hz(damped_hz, zeta):
    """Of a motion whose amplitude falls by zeta of its phase."""
    return damped_hz * np.hypot(1.0, zeta)


def assert_right(value, sd, truth, bound, what):
    assert abs(value - truth) < MOST_SD * sd, f"{what} {value} for {truth}: {(value - truth) / sd:.1f} sd"
    assert sd < MOST_BOUNDS * bound, f"sd of {what} {sd:.2g}: {sd / bound:.1f} times the Cramer-Rao bound"


def assert_target(mode, truth, bounds):
    assert_right(mode.frequency_hz, mode.frequency_sd_hz, truth[0], bounds[0], "frequency")
    assert_right(mode.damping_ratio, mode.damping_ratio_sd, truth[1], bounds[1], "damping ratio")


def assert_small_amplitude(mode, truth, bounds):
    assert "AMPLITUDE_DEPENDENT" in mode.flags
    assert_right(*mode.small_amplitude_frequency, truth[0], bounds[0], "frequency at small amplitude")
    assert_right(*mode.small_amplitude_damping, truth[1], bounds[1], "damping ratio at small amplitude")


def parts(found):
    return [segment.kind for segment in found.segments]


@pytest.mark.parametrize(
    ("fps", "frequency_hz", "zeta", "duration_s"),
    [(22.67, 7.3, 0.09, 2.3), (30.0, 2.2, 0.2, 4.0), (200.0, 12.0, 0.45, 1.5), (22.67, 7.3, 0.05, 2.3)],
)
def test_strong_damping_and_few_samples_a_cycle(fps, frequency_hz, zeta, duration_s):
    t, y = strongly_damped(fps, frequency_hz, zeta, duration_s)
    bounds = bound_of_decay(t, frequency_hz, zeta, (65.0, 48.75, 26.0), 0.1)
    assert_target(identified(t, y).target, (frequency_hz, zeta), bounds)


@pytest.mark.parametrize("repeats", [3, 6, 12])
def test_repeated_last_frames(repeats):
    t, y = repeated_end(repeats)
    found = identified(t, y)
    assert_target(found.target, (32.0, 3.5e-4), bound_of_decay(t[:882], 32.0, 3.5e-4, (1.9,), 0.04))
    assert parts(found) == ["decay", "repeated"]
    assert not found.used[882:].any()
    assert any(f"the last {repeats} of the record" in note for note in found.notes)


def test_a_stop_by_hand():
    t, y = stopped_by_hand()
    found = identified(t, y)
    assert_target(
        found.target,
        (undamped_hz(4.265, 0.0045), 0.0045),
        bound_of_decay(t[t < 8.0], 4.265, 0.0045, (1.0,), 0.002),
    )
    assert parts(found)[:2] == ["decay", "disturbed"]
    # The search resolves two cycles.
    assert 8.0 - 2.0 / 4.265 < found.segments[0].end_s <= 8.0
    assert found.onset.source == "record start"
    assert not found.used[t > 8.0].any()


@pytest.mark.slow  # in the fast suite: the same record by the command, modalcam/cli/test_cli.py
def test_a_click_after_the_decay_of_a_ruler():
    found = identified(*ruler_with_click())
    assert_small_amplitude(found.target, (undamped_hz(38.4, 0.008), 0.008), bound_of_law(ruler, 300.0))
    assert parts(found) == ["at rest", "decay", "disturbed"]
    assert found.onset.time_s == pytest.approx(0.55, abs=1.0 / 38.4)
    click = found.segments[-1]
    # 26000 falls below the noise of 300 after 36 ms.
    assert 1.999 < click.start_s < 2.002
    assert 2.01 < click.end_s < 2.036
    assert not found.used[(found.series.time_s > 2.0005) & (found.series.time_s < 2.01)].any()
    low, high = found.target.damping_interval(0.99)
    assert low < 0.033, "the largest of the record"
    assert high > 0.008, "the limit at small amplitude"


def test_four_plucks():
    t, y = several_plucks()
    found = identified(t, y)
    assert parts(found) == ["at rest", "decay", "decay", "decay", "decay"]
    assert len(found.target.decays) == 4
    each = [
        bound_of_decay(t[(t >= start) & (t < start + 6.0)], 14.9, 0.008, (a, 0.5 * a), 0.004)
        for start, a in ((1.0, 1.0), (7.0, 0.6), (13.0, 1.3), (19.0, 0.8))
    ]
    assert_target(found.target, (14.9, 0.008), np.sum(np.square(each) ** -1.0, axis=0) ** -0.5)
    smallest = min(one.damping_ratio_sd for one in found.target.decays)
    assert found.target.damping_ratio_sd < smallest, "four decays determine it better than one"


def test_a_clamp_that_slips():
    mode = identified(*slipping_clamp()).target
    truth = (undamped_hz(9.372, 29e-4), 29e-4)
    assert_small_amplitude(mode, truth, bound_of_law(clamp, 0.002))
    curve = mode.amplitude_dependence.curve
    a = curve.amplitude
    zeta = 29e-4 + 23e-4 * a * a / (a * a + 0.04)
    assert np.all(np.abs(curve.damping_ratio - zeta) < 4.0 * curve.damping_ratio_sd)
    assert mode.flags == ("AMPLITUDE_DEPENDENT",), "one mode with this curve leaves nothing but noise"


def test_a_steady_drive():
    t, y = steady_drive()
    found = identified(t, y)
    assert (parts(found), found.modes) == (["driven"], ())
    assert found.segments[0].driven_probability > 0.5, "it is called driven because that is more probable"
    line = max(found.driven, key=lambda one: one.amplitude)
    assert line.flags == ("DRIVEN",)
    table = found.to_dataframe()
    assert table["flags"].tolist() == ["DRIVEN"] * len(found.driven)
    assert table["damping_ratio"].isna().all()
    assert any(failed.target and "driven" in failed.reason for failed in found.failed)
    # Kay (1993), 3.14, with the power of the coloured noise at the line.
    power = 0.006**2 / abs(1.0 - 0.9 * np.exp(-2j * np.pi * 26.765 / 1000.0)) ** 2
    bound = 1000.0 * np.sqrt(12.0 * 2.0 * power / 0.05**2 / (2.0 * np.pi) ** 2 / t.size**3)
    assert_right(line.frequency_hz, line.frequency_sd_hz, 26.765, bound, "frequency")

"""Records that are driven after a rest, that are held and released, or that show no free decay at all."""

import numpy as np
import pytest
from kit.identified import in_sd
from kit.series import decay, series_of

from modal_id import IdentifySettings, identify


@pytest.mark.parametrize("drive_hz", [7.0, pytest.param(20.0, marks=pytest.mark.slow)])
def test_the_strongest_line_of_a_drive_with_harmonics_is_named_first(drive_hz):
    """A shaker that starts after 1 s at rest and is not linear: all multiples are lines of what drives the motion.

    A damping ratio of 1e-5 would cost 0.8 % of the amplitude in 19 s, which is ten standard deviations.
    """
    t = np.arange(5000) / 250.0
    grown = np.clip((t - 1.0) / 0.25, 0.0, 1.0)
    lines = {1: 3.2, 2: 1.5, 5: 0.9}
    y = grown * sum(a * np.cos(2.0 * np.pi * n * drive_hz * t + n) for n, a in lines.items())
    found = identify(series_of(t, y + 0.05 * np.random.default_rng(1).standard_normal(t.size)))
    assert found.modes == ()
    strongest = found.driven[0]
    assert abs(strongest.frequency_hz - drive_hz) < 4.0 * strongest.frequency_sd_hz
    # Nineteen twentieths of the record are driven: the amplitude is between that share of it and all of it, 4 sd more.
    assert 0.94 * 3.2 < strongest.amplitude < 3.2 + 4.0 * 0.05 * np.sqrt(2.0 / 5000.0)
    amplitudes = [line.amplitude for line in found.driven]
    assert amplitudes == sorted(amplitudes, reverse=True)
    named = np.array([line.frequency_hz for line in found.driven])
    for n in lines:
        assert np.min(np.abs(named - n * drive_hz)) < 0.01, f"line at {n} times the drive"
    assert {segment.kind for segment in found.segments} <= {"driven", "at rest"}


def test_a_pendulum_held_and_released_is_fitted_from_the_release():
    """Held at its largest deflection, released at 1.1 s, at rest after eight cycles: too few for an envelope."""
    t = np.arange(237) / 20.0
    since = np.clip(t - 1.1, 0.0, None)
    free = decay(since, 0.712, 0.06, -2.2, 0.0)
    y = np.where(t < 1.1, -2.2 * np.sin(np.clip(t / 1.1, 0.0, 1.0) * 0.5 * np.pi), free) + 0.2
    found = identify(series_of(t, y + 0.01 * np.random.default_rng(3).standard_normal(t.size)))
    assert found.onset.source == "peak"
    assert found.onset.time_s == pytest.approx(1.1, abs=0.3)
    mode = found.target
    assert np.max(np.abs(in_sd(mode, 0.712, 0.06))) < 4.0, mode
    assert [segment.kind for segment in found.segments][:2] == ["disturbed", "decay"]


@pytest.mark.parametrize("left_s", [0.5, 1.0])
def test_a_drive_that_ends_a_few_cycles_before_a_pluck_is_no_decay(left_s):
    """5 Hz driven for 8 s, free until a pluck at 9 s and a second at 18 s.

    Taken for one decay, drive and tail had a damping ratio of 3e-4, which was averaged with those of both plucks.
    """
    time_s = np.arange(0.0, 26.0, 1.0 / 120.0)
    stop_s = 9.0 - left_s
    tail = decay(np.clip(time_s - stop_s, 0.0, None), 5.0, 0.01, phase=2.0 * np.pi * 5.0 * stop_s)
    values = np.where(time_s < stop_s, np.cos(2.0 * np.pi * 5.0 * time_s), tail)
    for pluck_s in (9.0, 18.0):
        values = np.where(
            time_s < pluck_s, values, decay(np.clip(time_s - pluck_s, 0.0, None), 5.0, 0.01, 2.0)
        )
    values += 0.004 * np.random.default_rng(0).standard_normal(time_s.size)
    found = identify(series_of(time_s, values))
    driven = [part for part in found.segments if part.kind == "driven"]
    assert [(round(one.start_s, 1), round(one.end_s, 1)) for one in driven] == [(0.0, round(stop_s, 1))]
    assert np.max(np.abs(in_sd(found.target, 5.0, 0.01))) < 4.0, found.target
    # two decays of 9 s know the damping ratio to 3e-6, one of the tail to 2e-4
    assert found.target.damping_ratio_sd < 2e-5, found.target.decays


def test_a_refusal_names_the_channel_that_moves_its_amplitude_and_the_noise():
    """Large jumps at random are no decay; that nothing exceeds the noise would be untrue."""
    rng = np.random.default_rng(0)
    t = np.arange(600) / 25.0
    places = rng.uniform(-60.0, 60.0, 31)[np.searchsorted(np.sort(rng.uniform(0.0, 24.0, 30)), t)]
    values = np.column_stack([np.zeros(t.size), places]) + 0.1 * rng.standard_normal((t.size, 2))
    found = identify(series_of(t, values, unit="px"))
    assert not found
    assert "no vibration exceeds noise" not in found.reason
    half = 0.5 * float(np.subtract(*np.quantile(values[:, 1], [0.99, 0.01])))
    assert f"from 0 s to 23.96 s, channel m1 moves most, by +-{half:.3g} px" in found.reason
    assert "decay from" not in found.reason


@pytest.mark.parametrize(("left", "noise"), [(0.5, 0.1), (0.6, 0.02)])
def test_a_drive_that_becomes_weaker_has_not_stopped(left, noise):
    """43.2 Hz at 120 fps; the amplitude falls with a time constant of 0.2 s to a new level."""
    t = np.arange(926) / 120.0
    amplitude = left + (1.0 - left) * np.exp(-np.clip(t - 3.3, 0.0, None) / 0.2)
    y = np.where(t < 3.3, 1.0, amplitude) * np.cos(2.0 * np.pi * 43.2 * t)
    found = identify(series_of(t, y + noise * np.random.default_rng(6).standard_normal(t.size)))
    assert found.modes == ()
    line = found.driven[0]
    assert abs(line.frequency_hz - 43.2) < 4.0 * line.frequency_sd_hz
    assert {segment.kind for segment in found.segments} == {"driven"}


def test_extrapolation_to_zero_amplitude_allows_for_another_law():
    """f grows with a, not with a^2 as the form assumes, in a record of a few cycles at large amplitude only."""
    t = np.arange(250) / 12.0
    f0, slope, zeta = 1.10, -0.05, 0.0016
    a = np.exp(-zeta * 2.0 * np.pi * 1.06 * t)
    phase = 2.0 * np.pi * np.cumsum(f0 + slope * a) / 12.0
    y = 380.0 * a * np.cos(phase) + 2.0 * np.random.default_rng(7).standard_normal(t.size)
    f, sd = identify(series_of(t, y)).target.small_amplitude_frequency
    assert abs(f - f0) < 3.0 * sd, f"{f:.4f} +- {sd:.4f} Hz for {f0} Hz"


@pytest.mark.parametrize("jump_rad", [0.0, pytest.param(0.15, marks=pytest.mark.slow), -0.3])
def test_a_splice_in_a_steady_motion_widens_its_frequency(jump_rad):
    """A clip spliced at 12 of 19 s: the phase jumps by what a frequency off by jump / (2 pi 10 s) would give."""
    t = np.arange(581) / 30.0
    y = 88.0 * np.cos(2.0 * np.pi * 0.6268 * t + np.where(t < 11.9, 0.0, jump_rad))
    found = identify(series_of(t, y + 0.3 * np.random.default_rng(8).standard_normal(t.size)))
    line = found.driven[0] if found.driven else found.target
    if line is None:
        assert "it is a forced vibration" in found.failed[0].reason, (
            "two halves that do not decay: no frequency is stated"
        )
        return
    assert abs(line.frequency_hz - 0.6268) < 3.0 * line.frequency_sd_hz
    assert line.frequency_sd_hz < 0.3 / (2.0 * np.pi * 10.0), "the largest error that the jump could cause"


def test_an_uneven_drive_is_not_said_to_be_noise():
    """A voice about 43 Hz at 120 fps, whose line is as broad as 3 % and lower than the differences of samples."""
    rng = np.random.default_rng(9)
    t = np.arange(926) / 120.0
    phase = 2.0 * np.pi * (43.2 * t + np.cumsum(rng.standard_normal(t.size)) * 0.09)
    found = identify(series_of(t, 0.9 * np.cos(phase) + 0.1 * rng.standard_normal(t.size)))
    assert not found
    assert "no vibration exceeds noise" not in found.reason
    centre = float(found.reason.split("within 5 % of ")[1].split(" Hz")[0])
    assert abs(centre - 43.2) < 0.05 * 43.2


def test_a_transient_of_the_sensor_before_a_drive_is_not_the_answer():
    """An accelerometer rings for a few samples after power-on, which alone determines a damping ratio well."""
    rng = np.random.default_rng(5)
    t = np.arange(16000) / 4000.0
    grown = np.clip((t - 0.6) / 0.01, 0.0, 1.0)
    lines = {1: 0.37, 2: 0.24, 4: 0.1}
    y = grown * sum(a * np.cos(2.0 * np.pi * n * 7.0 * t + n) for n, a in lines.items())
    y[:8] += 0.66 * np.exp(-0.55 * np.arange(8)) * np.cos(1.4 * np.arange(8) + 0.8)
    found = identify(series_of(t, y + 0.004 * rng.standard_normal(t.size)))
    named = [*found.modes, *found.driven]
    strongest = max(named, key=lambda one: one.amplitude)
    assert abs(strongest.frequency_hz - 7.0) < 4.0 * strongest.frequency_sd_hz
    assert all("DAMPING_TOUCHES_ZERO" in mode.flags for mode in found.modes)
    assert found.segments[0].kind in ("disturbed", "at rest")


def test_a_line_beside_a_drive_that_may_be_driven_is_not_the_answer():
    """After a rest, 5 Hz is steady, and 8.3 Hz, a tenth as strong, loses 3 %, as a drive may."""
    t, called_driven = np.arange(2400) / 200.0, 0
    y = (t > 1.0) * (np.cos(2.0 * np.pi * 5.0 * t) + decay(t, 8.3, 5.8e-5, 0.1, 1.0))
    for seed in range(4):
        found = identify(series_of(t, y + 0.02 * np.random.default_rng(seed).standard_normal(t.size)))
        strongest = found.target or found.driven[0]
        assert abs(strongest.frequency_hz - 5.0) < 4.0 * strongest.frequency_sd_hz
        called_driven += bool(found.driven)
    assert called_driven


@pytest.mark.parametrize("cycles", [1.3, 2.5, 4.3])
def test_a_few_cycles_of_constant_amplitude_may_be_driven(cycles):
    """A file that is cut off during the drive: the interval of a decay would exclude any damping of a structure."""
    t = np.arange(round(100 * cycles / 1.85)) / 100.0
    y = 8.0 * np.cos(2.0 * np.pi * 1.85 * t + 0.3) + 0.005 * np.random.default_rng(6).standard_normal(t.size)
    found = identify(series_of(t, y))
    assert found.driven or "MAY_BE_DRIVEN" in found.target.wrong_flags
    known = identify(series_of(t, y), IdentifySettings(onset_s=0.0))
    assert "MAY_BE_DRIVEN" not in known.target.flags, "the user says that the motion is free from 0 s on"


@pytest.mark.parametrize(
    ("n", "hz", "zeta", "noise", "doubt"), [(160, 1.85, 0.02, 6e-4, False), (400, 5.0, 0.001, 0.02, True)]
)
def test_a_loss_that_no_drive_is_expected_to_have_is_of_a_free_motion(n, hz, zeta, noise, doubt):
    """A third or an eighth of the amplitude is lost, known to a 200th or a 20th of it."""
    t = np.arange(n) / 100.0
    y = decay(t, hz, zeta, 1.0, 0.3) + noise * np.random.default_rng(7).standard_normal(n)
    target = identify(series_of(t, y)).target
    assert ("FEW_CYCLES_LOST" in target.flags, "MAY_BE_DRIVEN" in target.flags) == (True, doubt)
    assert np.all(np.abs(in_sd(target, hz, zeta)) < 4.0)


@pytest.mark.parametrize("amplitude", [0.05, 2.0])
def test_a_hum_beside_a_decay_is_not_taken_for_a_free_mode(amplitude):
    # By chance, about half of these lines decay within their standard deviation; the others are no mode.
    t, listed = np.arange(4000) / 500.0, 0
    values = decay(t, 4.8, 0.004) + amplitude * np.sin(2.0 * np.pi * 50.0 * t)
    for seed in range(4):
        noise = 0.01 * np.random.default_rng(seed).standard_normal(t.size)
        found = identify(series_of(t, values + noise), IdentifySettings(mode=3))
        assert np.max(np.abs(in_sd(found.target, 4.8, 0.004))) < 4.0
        assert (
            [mode.number for mode in found.modes if mode.number is not None] == [found.target.number] == [3]
        )
        hum = [mode for mode in found.modes if abs(mode.frequency_hz - 50.0) < 0.1]
        assert all("MAY_BE_DRIVEN" in mode.flags for mode in hum)
        assert not any("MAY_BE_DRIVEN" in mode.flags for mode in found.modes if mode not in hum)
        listed += len(hum)
    assert listed


def test_a_steady_motion_with_noise_is_rather_driven_than_a_decay_of_any_damping_ratio():
    # A loss of 1.9 sd is as likely a decay. Noise exceeds it in 2.6 % of records, and in two or more of twelve in 4 %.
    t, taken_for_free = np.arange(500) / 100.0, []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        driven = np.where(t < 4.0, np.cos(2.0 * np.pi * 5.0 * t + rng.uniform(0.0, 6.0)), 0.0)
        found = identify(series_of(t, driven + 0.1 * rng.standard_normal(t.size)))
        taken_for_free += [] if found.driven else [found.target]
    assert len(taken_for_free) <= 1, taken_for_free


@pytest.mark.parametrize("sd", [0.001, pytest.param(0.005, marks=pytest.mark.slow)])
def test_a_motion_that_is_over_two_cycles_after_a_long_drive_is_a_decay(sd):
    """Driven at 9.5 Hz for 5 s, then 10 Hz with a damping ratio of .3: a thousandth is left after 0.37 s."""
    t = np.arange(550) / 55.0
    phase = 2.0 * np.pi * 9.5 * 5.0
    y = np.where(
        t < 5.0, np.cos(2.0 * np.pi * 9.5 * t), decay(np.clip(t - 5.0, 0.0, None), 10.0, 0.3, phase=phase)
    )
    found = identify(series_of(t, y + sd * np.random.default_rng(8).standard_normal(t.size)))
    assert [s.kind for s in found.segments] == ["driven", "decay"]
    assert found.onset.time_s == pytest.approx(5.0, abs=0.05)
    mode = found.target
    assert found.segments[0].driven_probability > 0.95, "24 cycles keep their amplitude to 1e-3"
    assert "MAY_BE_HELD" not in mode.flags
    assert np.max(np.abs(in_sd(mode, 10.0, 0.3))) < 4.0, mode
    assert mode.damping_ratio_sd < 0.01, "25 samples of the motion with that noise give one of .0003 to .002"

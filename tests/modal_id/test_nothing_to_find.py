import numpy as np
import pytest
from kit.identified import quick
from kit.series import QUICK, coloured, decay, one_mode, pole_of, series_of
from scipy.signal import lfilter

from modal_id import IdentifySettings, SamplerSettings, identify
from modal_id.data import MIN_SAMPLES
from modal_id.modes import choose_target
from tracker import TUNING, TrackerSettings, track_source
from tracker.video import SourceInfo

T = np.arange(2000) / 500.0


def seeds(fast, count):
    """Seeds below `count`, of which the first run in the fast suite."""
    return [pytest.param(seed, marks=() if seed < fast else pytest.mark.slow) for seed in range(count)]


@pytest.mark.parametrize("seed", seeds(2, 5))
@pytest.mark.parametrize("channels", [1, 6])
def test_pure_noise_has_no_mode(seed, channels):
    values = np.random.default_rng(seed).standard_normal((T.size, channels))
    found = quick(series_of(T, values))
    assert not found
    assert "no vibration" in found.reason


@pytest.mark.parametrize("seed", seeds(2, 6))
@pytest.mark.parametrize("kind", ["random walk", "linear drift", "creep", "AR(1) 0.9"])
def test_slow_motion_is_not_a_heavily_damped_mode(kind, seed):
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal(T.size)
    if kind == "random walk":
        values = np.cumsum(noise)
    elif kind == "linear drift":
        values = 0.7 * T + 0.01 * noise
    elif kind == "creep":
        values = np.exp(-rng.uniform(0.1, 5.0) * T) + 0.01 * noise
    else:
        values = coloured(rng, T.size, 0.9)
    assert not quick(series_of(T, values))


@pytest.mark.parametrize(("value", "words"), [(3.25, "never changes"), (np.nan, "0 of 2000")])
def test_a_motionless_object_and_missing_samples_are_refused(value, words):
    found = quick(series_of(T, np.full(T.size, value)))
    assert not found
    assert words in found.reason


def test_a_film_without_frames_is_refused_with_the_number_that_an_identification_needs():
    class Empty:
        info = SourceInfo("ffv1", "gray", 640, 480, 8, 255)

        def frames(self):
            return iter(())

    failed = track_source(Empty(), "a", TrackerSettings())
    assert not failed
    assert TUNING.least_frames == MIN_SAMPLES
    assert f"no frames, but at least {MIN_SAMPLES} are needed" in failed.reason


def test_too_few_samples_are_refused():
    found = quick(series_of(T[:5], np.sin(T[:5])))
    assert not found
    assert "5 samples" in found.reason


def test_growing_motion_is_a_failed_mode_with_a_reason():
    values = np.exp((0.5 + 2j * np.pi * 20.0) * T).real + np.random.default_rng(2).normal(0.0, 0.01, T.size)
    found = quick(series_of(T, values))
    assert not found or found.target is None
    if found:
        assert any(mode.target and "does not decay" in mode.reason for mode in found.failed)


def test_reason_names_the_missing_target_mode():
    series, _ = one_mode(2, 0, fps=500.0, duration_s=4.0)
    found = quick(series, mode=2, expected_frequencies_hz=(1.9, 10.5, 29.0))
    assert found.target is None
    (failed,) = [mode for mode in found.failed if mode.target]
    assert not failed
    assert failed.number == 2
    assert "10.5 Hz" in failed.reason


def test_a_constant_channel_is_named_and_excluded():
    series, _ = one_mode(2, 0, fps=500.0, duration_s=4.0)
    values = np.column_stack([series.values[:, 0], np.zeros(series.time_s.size)])
    found = quick(series_of(series.time_s, values))
    assert list(found.channels_used) == [True, False]
    assert any("m1" in note for note in found.notes)
    assert np.isnan(found.target.shape[1])


def test_frequency_near_nyquist_is_flagged():
    values = np.exp(pole_of(122.0, 0.0005) * T[:1000] * 2.0).real
    time = T[:1000] * 2.0
    values += 0.01 * np.random.default_rng(4).standard_normal(values.size)
    found = quick(series_of(time, values))
    assert found.target.frequency_hz == pytest.approx(122.0, abs=0.01)
    assert "ALIASED_POSSIBLE" in found.target.flags
    assert any("128" in note for note in found.target.notes)


def test_invalid_settings_are_refused():
    with pytest.raises(ValueError, match="mode"):
        IdentifySettings(mode=0)
    with pytest.raises(ValueError, match="ensembles"):
        SamplerSettings(ensembles=2)
    series, _ = one_mode(2, 0, fps=500.0, duration_s=1.0)
    bad = IdentifySettings(expected_frequencies_hz=(2.0,), expected_shapes=np.ones((3, 1)))
    with pytest.raises(ValueError, match="one row for each"):
        identify(series, bad)


@pytest.mark.parametrize("damping_ratio", [0.75, 0.9, 1.5])
def test_a_return_to_rest_without_oscillation_is_named(damping_ratio):
    poles = np.roots([1.0, 2.0 * damping_ratio * 30.0, 30.0**2]).astype(complex)
    y = np.real((poles[0] * np.exp(poles[1] * T) - poles[1] * np.exp(poles[0] * T)) / (poles[0] - poles[1]))
    noise = 0.003 * np.random.default_rng(1).standard_normal(T.size)
    found = quick(series_of(T, y + noise))
    assert not found
    assert "damping ratios above 0.7 are not identified" in found.reason


def test_a_beam_in_metres_does_not_hide_the_motion():
    wave = 2.0 * decay(T, 10.0, 0.01) + 0.01 * np.random.default_rng(3).standard_normal(T.size)
    settings = IdentifySettings(mode=1, expected_frequencies_hz=(1e4, 6.3e4), sampler=QUICK)
    found = identify(series_of(T, wave), settings)
    assert found.modes[0].frequency_hz == pytest.approx(10.0, abs=4.0 * found.modes[0].frequency_sd_hz)
    assert "or the beam in mm, not in m" in next(failed.reason for failed in found.failed if failed.target)


@pytest.mark.parametrize(
    ("settings", "frequency_hz", "words"),
    [
        (IdentifySettings(target_frequency_hz=88.6), 0.0886, "give the frame rate in Hz, not in kHz"),
        (
            IdentifySettings(target_frequency_hz=0.0886),
            88.6,
            "give the requested frequency in Hz, not in kHz",
        ),
        (
            IdentifySettings(mode=1, expected_frequencies_hz=(88.6, 500.0)),
            0.09,
            "frame rate in Hz, not in kHz",
        ),
        (
            IdentifySettings(mode=1, expected_frequencies_hz=(0.09, 0.5)),
            88.6,
            "of the beam is in another unit",
        ),
    ],
)
def test_a_target_off_by_a_thousand_is_named(settings, frequency_hz, words):
    lines_hz = np.array([frequency_hz, 3.0 * frequency_hz])
    choice = choose_target(lines_hz, np.ones((2, 1)), np.ones(2), (None, None), settings, 1000.0)
    assert choice.index is None
    assert words in choice.why.reason


def test_the_sway_of_a_hand_is_no_mode():
    time_s = np.arange(360) / 30.0
    step = 2.0 * np.pi * 0.2 / 30.0
    for seed in (3, 10):
        rng = np.random.default_rng(seed)
        # Noise through a resonance at 0.2 Hz with 30 % of critical damping: two or three cycles, none like the next.
        radius = np.exp(-0.3 * step)
        sway = lfilter([1.0], [1.0, -2.0 * radius * np.cos(step), radius**2], rng.standard_normal(760))[400:]
        values = 20.0 * sway / np.std(sway) + 0.5 * rng.standard_normal(360)
        found = quick(series_of(time_s, values))
        assert not found or not found.modes, f"seed {seed}: {found.modes}; no part of the motion is a decay"
        assert found or "steady" in found.reason
        assert not found or "may be a drift" in found.failed[0].reason, f"seed {seed}"

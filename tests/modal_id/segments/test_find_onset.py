import numpy as np
import pytest
from kit.identified import assert_inside
from kit.series import (
    PAPER_HZ,
    PAPER_ZETA,
    base_stopped_dead,
    clamped_free_shapes,
    one_mode,
    series_of,
    shaken_then_free,
)

from modal_id import IdentifySettings, identify
from modal_id.data import prepare, rough_variance, with_base
from modal_id.segments import divide

slow = pytest.mark.slow
# mode, amplitude, noise, fps, duration, shaking
CASES = [
    (0, 20.0, 0.010, 100.0, 8.0, 2.0),
    pytest.param(0, 1.0, 0.020, 100.0, 10.0, 2.0, marks=slow),
    # further modes sound in every block after the stop
    (0, 20.0, 0.006, 100.0, 10.0, 6.0),
    pytest.param(1, 5.0, 0.010, 200.0, 4.0, 1.0, marks=slow),
    pytest.param(2, 2.0, 0.010, 200.0, 4.0, 0.7, marks=slow),
    (3, 1.0, 0.010, 500.0, 2.0, 0.4),
    (4, 0.3, 0.020, 500.0, 1.4, 0.3),
    pytest.param(4, 3.0, 0.006, 1000.0, 1.4, 0.1, marks=slow),
]


@pytest.mark.parametrize(("mode", "amplitude", "noise", "fps", "duration_s", "shaking_s"), CASES)
def test_shaking_then_sudden_stop(mode, amplitude, noise, fps, duration_s, shaking_s):
    series = shaken_then_free(
        mode, amplitude=amplitude, noise=noise, fps=fps, duration_s=duration_s, shaking_s=shaking_s, seed=3
    )
    theory = tuple(PAPER_HZ * np.array([1.01, 1.03, 1.08, 1.07, 1.06]))
    settings = IdentifySettings(
        mode=mode + 1, expected_frequencies_hz=theory, expected_shapes=clamped_free_shapes()
    )
    found = identify(series, settings)
    assert found, found.reason
    onset = found.onset
    assert onset.source == "model"
    assert onset.confidence > 0.99
    # The fit excludes the driven motion and most of the decay is used.
    assert onset.time_s == pytest.approx(shaking_s, abs=5.0 * onset.sd_s + 1.0 / fps)
    assert onset.fit_from_s > shaking_s
    assert onset.fit_from_s < shaking_s + 0.1 * duration_s + 1.5 / PAPER_HZ[mode]
    target = found.target
    assert target is not None, found.failed
    assert target.number == mode + 1
    assert target.mac > 0.999
    assert_inside(target, PAPER_HZ[mode], PAPER_ZETA[mode])
    assert np.all(np.isnan(found.fitted[series.time_s < onset.fit_from_s]))


def test_onset_from_the_user_takes_precedence():
    series, _ = one_mode(2, 2, fps=500.0, duration_s=5.0)
    found = identify(series, IdentifySettings(onset_s=1.234))
    assert found.onset.source == "user"
    assert found.onset.time_s == 1.234
    assert found.onset.fit_from_s == 1.234
    assert not found.used[series.time_s < 1.234].any()


def theory(mode):
    return IdentifySettings(
        mode=mode + 1,
        expected_frequencies_hz=tuple(PAPER_HZ * 1.02),
        expected_shapes=clamped_free_shapes(),
        max_modes=5,
    )


def found_onset(series, mode):
    """Onset as found by `identify`, without identifying modes."""
    prepared = prepare(series)
    data, base = with_base(prepared.data, series, prepared.first_row)
    lowest, wanted = 0.4 * 1.02 * PAPER_HZ[0], 1.02 * PAPER_HZ[mode]
    return divide(data, rough_variance(data), lowest, wanted, base).decays[0].onset


# At 40 dB and 1000 fps. Amplitudes and phases are free parameters of the model, although an abrupt stop of the base
# constrains them: the model does not require base motion and is not biased by a base that stops gradually.
# Mode, stop and duration; the longest records last.
STOPS = [(4, 0.5, 1.5), (3, 0.6, 2.0), (2, 0.8, 2.6)]


@pytest.mark.parametrize("records", [1, pytest.param(3, marks=slow)])
@pytest.mark.parametrize("relative", [False, True])
def test_stop_is_located_within_half_a_sample(relative, records):
    rng = np.random.default_rng(11)
    errors, sds = [], []
    for seed, (mode, stop_s, duration_s) in enumerate(STOPS[:records]):
        when = stop_s + 1e-3 * rng.random()
        given = {"stop_s": when, "phase": rng.uniform(-0.4, 0.4), "duration_s": duration_s}
        series = base_stopped_dead(mode, snr_db=40.0, fps=1000.0, seed=seed, relative=relative, **given)
        onset = found_onset(series, mode)
        assert onset.source == "model"
        assert onset.fit_from_s > when
        errors.append(abs(onset.time_s - when))
        sds.append(onset.sd_s)
    assert np.median(errors) < 5e-4, f"half the sample interval of 1 ms; errors {errors} s"
    scaled = np.array(errors) / np.array(sds)
    assert np.max(scaled) < 4.0, f"errors relative to reported sd {scaled}"


def test_onset_error_does_not_bias_damping():
    """The decay is exponential from any instant after the stop, so the fit only has to start after the stop."""
    series = base_stopped_dead(2, stop_s=0.8003, phase=0.2, snr_db=40.0, fps=1000.0, duration_s=2.6, seed=5)
    found = identify(series, theory(2))
    onset_s = 0.8003 + found.onset.fit_from_s - found.onset.time_s
    exact = identify(series, theory(2).model_copy(update={"onset_s": onset_s}))
    bias = abs(found.target.damping_ratio - exact.target.damping_ratio)
    # The median of 256 x 4 draws has a Monte Carlo error of 0.04 sd; both runs use the same seed.
    assert bias < 0.1 * exact.target.damping_ratio_sd


def test_end_of_a_driving_force():
    t = np.arange(4000) / 1000.0
    pole = 2.0 * np.pi * 26.84 * complex(-0.0028, 1.0)
    when = 1.50037
    steady = np.exp(1j * (pole.imag * (t - when) + 0.3))
    c = np.exp(0.3j)
    velocity = (1j * pole.imag * c).real
    c = c.real - 1j * (velocity - pole.real * c.real) / pole.imag
    free = (c * np.exp(pole * np.maximum(t - when, 0.0))).real
    rng = np.random.default_rng(2)
    values = np.where(t < when, steady.real, free) + 1e-4 * rng.standard_normal(t.size)
    found = identify(series_of(t, values), IdentifySettings(max_modes=2))
    # From the amplitude alone: sd of its logarithm over the rate, 1e-4 sqrt(2 / 1500) / 0.47 s, about 0.01 ms.
    assert found.onset.time_s == pytest.approx(when, abs=max(5.0 * found.onset.sd_s, 1e-4))
    assert found.onset.sd_s < 1.1 / pole.imag, "both curves touch at the stop: determined within one radian"


def test_note_on_a_record_that_is_driven_throughout():
    t = np.arange(4000) / 1000.0
    rng = np.random.default_rng(4)
    values = np.sin(2.0 * np.pi * 26.84 * t) + 0.007 * rng.standard_normal(t.size)
    prepared = prepare(series_of(t, values))
    parts = divide(prepared.data, np.array([0.007**2]), 0.0, None)
    assert parts.decays == ()
    assert [segment.kind for segment in parts.segments] == ["driven"]
    onset = parts.none
    assert onset.source == "none"
    assert "it is driven, and the record contains no free decay" in onset.note


def test_note_on_a_record_that_is_a_free_decay_throughout():
    series, sd = one_mode(2, 1, fps=500.0, duration_s=5.0)
    onset = divide(prepare(series).data, np.array([sd**2]), 0.0, None).decays[0].onset
    assert (onset.source, onset.fit_from_s) == ("record start", 0.0)
    assert "decays freely from the first sample" in onset.note

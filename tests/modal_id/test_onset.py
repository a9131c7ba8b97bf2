import numpy as np
import pytest
from modal_decays import (
    PAPER_HZ,
    PAPER_ZETA,
    clamped_free_shapes,
    one_mode,
    series_of,
    shaken_then_free,
)

from modal_id.identify import identify
from modal_id.settings import IdentifySettings

# mode, amplitude, noise, fps, duration, shaking
CASES = [
    (0, 20.0, 0.010, 100.0, 8.0, 2.0),
    (0, 1.0, 0.020, 100.0, 10.0, 2.0),
    (0, 20.0, 0.006, 100.0, 10.0, 6.0),
    (1, 5.0, 0.010, 200.0, 4.0, 1.0),
    (2, 2.0, 0.010, 200.0, 4.0, 0.7),
    (3, 1.0, 0.010, 500.0, 2.0, 0.4),
    (4, 0.3, 0.020, 500.0, 1.4, 0.3),
    (4, 3.0, 0.006, 1000.0, 1.4, 0.1),
]


@pytest.mark.parametrize(("mode", "amplitude", "noise", "fps", "duration_s", "shaking_s"), CASES)
def test_shaking_then_sudden_stop(mode, amplitude, noise, fps, duration_s, shaking_s):
    series = shaken_then_free(
        mode, amplitude=amplitude, noise=noise, fps=fps, duration_s=duration_s, shaking_s=shaking_s, seed=3
    )
    theory = tuple(PAPER_HZ * np.array([1.01, 1.03, 1.08, 1.07, 1.06]))
    settings = IdentifySettings(
        target_number=mode + 1, expected_frequencies_hz=theory, expected_shapes=clamped_free_shapes()
    )
    found = identify(series, settings)
    assert found, found.reason
    onset = found.onset
    assert onset.source == "model"
    assert onset.confidence > 0.99
    # What counts is that no shaking is fitted and little of the decay is lost.
    assert onset.time_s == pytest.approx(shaking_s, abs=5.0 * onset.sd_s + 1.0 / fps)
    assert onset.fit_from_s > shaking_s
    assert onset.fit_from_s < shaking_s + 0.1 * duration_s + 1.5 / PAPER_HZ[mode]
    target = found.target
    assert target is not None, found.failed
    assert target.number == mode + 1
    assert target.mac > 0.999
    low, high = target.frequency_interval_hz(0.999)
    assert low < PAPER_HZ[mode] < high
    low, high = target.damping_interval(0.999)
    assert low < PAPER_ZETA[mode] < high
    assert np.all(np.isnan(found.fitted[series.time_s < onset.fit_from_s]))


def test_a_decay_from_the_first_sample_has_its_onset_there():
    series, _ = one_mode(2, 1, fps=500.0, duration_s=5.0)
    found = identify(series, IdentifySettings())
    assert found.onset.source == "record start"
    assert found.onset.fit_from_s == 0.0


def test_release_after_quiet():
    decay, sd = one_mode(1, 5, fps=500.0, duration_s=6.0)
    rng = np.random.default_rng(0)
    quiet = sd * rng.standard_normal(400)
    values = np.concatenate([quiet, decay.values[:, 0]])
    series = series_of(np.arange(values.size) / 500.0, values)
    found = identify(series, IdentifySettings())
    assert found.onset.source == "peak"
    # The largest sample of the first cycles is within one cycle of the release.
    assert found.onset.time_s == pytest.approx(0.8, abs=1.0 / PAPER_HZ[1])
    low, high = found.target.damping_interval(0.999)
    assert low < PAPER_ZETA[1] < high


def test_the_users_onset_wins():
    series, _ = one_mode(2, 2, fps=500.0, duration_s=5.0)
    found = identify(series, IdentifySettings(onset_s=1.234))
    assert found.onset.source == "user"
    assert found.onset.time_s == 1.234
    assert found.onset.fit_from_s == 1.234
    assert not found.used[series.time_s < 1.234].any()

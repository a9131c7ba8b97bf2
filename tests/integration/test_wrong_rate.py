"""Sample films with a wrong recorded rate: the true one is named; the rate only scales the time axis of the tracks."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.paths import SAMPLES

from modal_id import IdentifySettings, SamplerSettings, identify
from modalcam.config import expected_of_theory
from modalcam.pipeline import load_run

pytestmark = pytest.mark.timeout(900)
TRUTH = {r["mode"]: r for r in json.loads((SAMPLES / "truth.json").read_text())["recordings"]}
# Rates do not depend on the posterior, which these few steps leave undetermined.
QUICK = SamplerSettings(walkers=16, burn_in_steps=2, check_steps=2, max_steps=2)


@pytest.fixture(scope="module")
def run(samples_run):
    return load_run(samples_run)


def identified_at(run, mode, rate_hz):
    """Identification of the film of `mode` as if it had been recorded at `rate_hz`."""
    film = Path(TRUTH[mode]["file"]).stem
    series = next(r.series for r in run.recordings if r.name == film)
    scaled = replace(series, time_s=series.time_s * TRUTH[mode]["fps"] / rate_hz)
    theory = expected_of_theory(run.beam.standard_modes, series.positions_mm)
    return identify(scaled, IdentifySettings(mode=mode, sampler=QUICK, **theory))


# Fast: the rate furthest below the true one in a low mode, and one above it in a high mode.
FAST = ((25.0, 2), (1000.0, 4))
WRONG = [
    pytest.param(rate_hz, mode, marks=() if (rate_hz, mode) in FAST else pytest.mark.slow)
    for rate_hz in (25.0, 30.0, 150.0, 1000.0)
    for mode in (2, 4)
]


@pytest.mark.parametrize(("rate_hz", "mode"), WRONG)
def test_a_wrong_rate_is_answered_with_the_true_one(run, mode, rate_hz):
    found = identified_at(run, mode, rate_hz)
    true_hz = TRUTH[mode]["fps"]
    assert found.fitting_rate is not None
    assert found.fitting_rate.number == mode
    assert np.abs(np.array(found.fitting_rate.limits_hz) / true_hz - 1.0).max() < 0.05
    assert found.fitting_rate.ratio == pytest.approx(true_hz / rate_hz, rel=0.05)
    assert any(str(found.fitting_rate) in one.reason for one in found.failed if one.target)


@pytest.mark.parametrize("mode", [2, pytest.param(4, marks=pytest.mark.slow)])
def test_the_true_rate_is_not_blamed(run, mode):
    found = identified_at(run, mode, TRUTH[mode]["fps"])
    assert found.fitting_rate is None
    assert not any("sampling rate" in one.reason for one in found.failed)

"""Modes that the user rejects: what is listed, which mode is the target, and that the others keep their values."""

import numpy as np
import pytest
from kit.series import QUICK, pole_of, series_of

from modal_id import IdentifySettings, identify

FAST = {"seed": 3, "sampler": QUICK}
# Frequency, damping ratio, amplitude; the strongest is that of the lamp.
BEAM, LAMP = (12.0, 0.004, 1.0), (21.0, 0.001, 2.0)


@pytest.fixture(scope="module")
def series():
    rng = np.random.default_rng(5)
    time_s = np.arange(750) / 125.0
    motion = sum(a * np.exp(pole_of(f, zeta) * time_s).real for f, zeta, a in (BEAM, LAMP))
    return series_of(time_s, motion + 0.01 * rng.normal(size=time_s.size))


def test_a_rejected_line_is_fitted_but_not_listed(series):
    plain = identify(series, IdentifySettings(**FAST))
    assert [round(mode.frequency_hz) for mode in plain.modes] == [12, 21]
    assert round(plain.target.frequency_hz) == 21, "the strongest, unless another is requested"
    found = identify(series, IdentifySettings(reject_hz=(21.1,), **FAST))
    (mode,) = found.modes
    assert found.target is mode
    assert mode.frequency_hz == pytest.approx(BEAM[0], abs=4.0 * mode.frequency_sd_hz)
    assert mode.damping_ratio == pytest.approx(BEAM[1], abs=4.0 * mode.damping_ratio_sd)
    (rejected,) = (one for one in found.failed if "reject_hz" in one.reason)
    assert rejected.frequency_hz == pytest.approx(LAMP[0], rel=1e-3)
    assert not rejected.target
    # Fitted beside the mode: the residual is the noise, not the lamp.
    assert found.residual_sd[0] == pytest.approx(0.01, rel=0.1)


def test_a_frequency_further_away_than_a_percent_is_kept(series):
    found = identify(series, IdentifySettings(reject_hz=(21.4,), **FAST))
    assert len(found.modes) == 2


def test_nothing_is_left_to_be_the_target(series):
    found = identify(series, IdentifySettings(reject_hz=(12.0, 21.0), **FAST))
    assert found.modes == ()
    assert any(one.target and "reject_hz names every mode" in one.reason for one in found.failed)

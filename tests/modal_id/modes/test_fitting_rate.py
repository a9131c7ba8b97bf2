"""A wrong recorded rate: the failure of the wanted mode names the rate at which the strongest line would be it."""

import numpy as np
import pytest

from modal_id.modes.numbering import choose_target
from modal_id.settings import IdentifySettings

THEORY_HZ = (1.876, 10.58, 29.26, 57.15, 94.34)
TRUE_HZ = {2: 10.19, 4: 53.2}


@pytest.mark.parametrize(("mode", "true_rate_hz"), [(2, 200.0), (2, 500.0), (4, 500.0), (4, 250.0)])
@pytest.mark.parametrize("rate_hz", [25.0, 30.0, 150.0])
def test_the_rate_that_fits_is_named(mode, true_rate_hz, rate_hz):
    apparent_hz = np.array([TRUE_HZ[mode] * rate_hz / true_rate_hz])
    settings = IdentifySettings(mode=mode, expected_frequencies_hz=THEORY_HZ)
    choice = choose_target(apparent_hz, np.ones(1), (None,), settings, rate_hz)
    assert choice.index is None
    assert f"at a sampling rate of {true_rate_hz:g} Hz (recorded: {rate_hz:g} Hz)" in choice.reason
    assert f"a ratio of {true_rate_hz / rate_hz:.3g}" in choice.reason


def test_a_rate_that_no_camera_offers_is_a_range():
    settings = IdentifySettings(mode=2, expected_frequencies_hz=THEORY_HZ)
    choice = choose_target(np.array([1.0]), np.ones(1), (None,), settings, 33.0)
    assert "at a sampling rate of 314 to 384 Hz (recorded: 33 Hz), a ratio of 10.6" in choice.reason


def test_at_the_true_rate_the_mode_is_found():
    settings = IdentifySettings(mode=4, expected_frequencies_hz=THEORY_HZ)
    choice = choose_target(np.array([10.2, 53.2]), np.ones(2), (2, 4), settings, 500.0)
    assert (choice.index, choice.reason) == (1, "")

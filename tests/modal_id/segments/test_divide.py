"""Long disturbances after which the motion goes on as before, or begins to decay."""

import numpy as np
import pytest
from kit.series import decay

from benchmarks.random_records import random_record
from modal_id.data import FitData, prepare, rough_variance
from modal_id.segments import divide


def test_a_motion_that_decays_after_a_long_disturbance_was_driven_before():
    """The drive ends; a weaker mode is excited for 25 cycles, and 12 % of the amplitude is lost in the next 38 s.

    Outliers and gaps after it hide the end of the drive from the search for one.
    """
    record = random_record(259)
    data = prepare(record.series).data
    found = divide(data, rough_variance(data), 0.0, None)
    driven = [s for s in found.segments if s.kind == "driven"]
    assert len(driven) == 1
    # The disturbance is found to a window of two cycles.
    assert driven[0].end_s == pytest.approx(record.decay_s[0], abs=2.0 / record.frequency_hz[0])
    assert found.decays[0].onset.fit_from_s >= record.decay_s[0] - 2.0 / record.frequency_hz[0]


def test_a_decay_that_goes_on_after_a_long_disturbance_is_one_decay():
    """A weakly damped mode; at 26 s a slower one is excited for some cycles."""
    rng = np.random.default_rng(0)
    t = np.arange(3000) / 47.0
    y = decay(t, 3.37, 1.6e-4, 1.0, 0.0) + 0.002 * rng.standard_normal(t.size)
    y += np.where(t > 26.0, decay(np.maximum(t - 26.0, 0.0), 1.92, 0.019, 0.4, -np.pi / 2), 0.0)
    data = FitData(t, y[:, None], np.ones((t.size, 1)))
    found = divide(data, rough_variance(data), 0.0, None)
    assert not [s for s in found.segments if s.kind == "driven"]
    assert min(one.onset.time_s for one in found.decays) < 1.0

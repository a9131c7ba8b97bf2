"""Events that interrupt a free motion, and what only looks like one."""

import numpy as np
import pytest
from support.ordinary_records import decay

from modal_id.data.samples import FitData
from modal_id.segments.events import find_events


@pytest.mark.parametrize("seed", range(3, 6))
def test_a_second_mode_that_decays_sooner_is_no_click(seed):
    """In the first 3 s windows of two cycles of the strongest mode do not join: too long to leave out and judge."""
    rng = np.random.default_rng(seed)
    t = 0.003 * np.arange(26000)
    y = decay(t, 26.8, 3.4e-4, 1.0, 0.3) + decay(t, 6.1, 0.004, 0.2, 0.0) + 0.05 * np.sin(0.3 * t)
    y += 0.0115 * rng.standard_normal(t.size)
    assert find_events(FitData(t, y[:, None], np.ones((t.size, 1))), 26.8, 0.0) == []

"""A free-free beam hit by a hammer, tracked by others at 15 000 fps: 15 points, 0.25 s."""

from pathlib import Path

import numpy as np
import pytest
from modal_decays import series_of

from modal_id.identify import identify
from modal_id.settings import IdentifySettings

FILE = Path(__file__).parents[2] / "../shared/realdata/photron_beam_impact/displacements_lk.npy"


@pytest.mark.skipif(
    not FILE.is_file(), reason="the photron_beam_impact recording is not beside this checkout"
)
def test_two_bending_modes_with_positive_damping():
    values = np.load(FILE)[:, :, 0].T
    found = identify(series_of(np.arange(values.shape[0]) / 15000.0, values, unit="m"), IdentifySettings())
    assert found.onset.source == "peak"
    first, second = (min(found.modes, key=lambda m: abs(m.frequency_hz - f)) for f in (695.4, 1897.7))
    # Their makers' poles from an accelerometer and from the camera differ by up to 0.4 Hz; the bin is 4 Hz.
    assert first.frequency_hz == pytest.approx(695.4, abs=2.0)
    assert second.frequency_hz == pytest.approx(1897.7, abs=2.0)
    # Accelerometer: 0.0046 and 0.0031; the camera alone gave its makers a negative damping ratio.
    low, high = first.damping_interval(0.99)
    assert low < 0.0046 < high
    low, high = second.damping_interval(0.99)
    assert low > 0.002
    assert high < 0.0045
    assert found.target is not None

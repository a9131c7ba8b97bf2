"""Draws that include errors beside the noise."""

from dataclasses import replace

import numpy as np
import pytest
from kit.identified import quick
from kit.series import decay, series_of

N = 20_000


@pytest.mark.parametrize("share", [0.1, 0.5, 1.0, 3.0])
def test_widening_keeps_the_medians_and_positive_damping(share):
    rng = np.random.default_rng(4)
    f, zeta = 10.0 + 1e-4 * rng.standard_normal((4, N // 4)), 0.02 + 1e-4 * rng.standard_normal((4, N // 4))
    t = np.arange(400) / 200.0
    own = quick(series_of(t, decay(t, 10.0, 0.02) + 0.01 * rng.standard_normal(t.size))).target.posterior
    sampled = replace(own.sampled, frequency_hz=f, damping_ratio=zeta)
    wider = replace(own, sampled=sampled).including(errors={"positions": (1e-2, share * 0.02)})
    assert np.array_equal(wider.including(errors={}).damping_ratio, zeta)
    wide_f, wide = wider.frequency_hz, wider.damping_ratio
    assert wide.shape == wide_f.shape == zeta.shape
    assert np.min(wide) > 0.0
    # standard error of a median: sqrt(pi / 2 n) sd
    error = np.sqrt(np.pi / 2 / N)
    assert abs(np.median(wide) - 0.02) < 4 * error * 0.02 * np.hypot(share, 0.005)
    assert abs(np.median(wide_f) - 10.0) < 4 * error * 1e-2
    assert np.std(wide_f) == pytest.approx(1e-2, rel=4 / np.sqrt(2 * N))
    upper = np.percentile(wide, 84.134) - 0.02
    # the upper half is normal; density 0.242 / sd at one sd
    assert upper == pytest.approx(
        share * 0.02, rel=4 * np.sqrt(0.159 * 0.841 / N) / 0.242 + 0.005**2 / share**2
    )
    if share < 0.15:
        assert np.std(wide) == pytest.approx(share * 0.02, rel=4 / np.sqrt(2 * N) + 0.005**2 / share**2)

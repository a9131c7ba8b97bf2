"""Profiles of the beam's image across it."""

import numpy as np
import pytest

from tracker.line import ProfileSums


@pytest.mark.parametrize("reach_px", [1.0, 3.0, 20.0])
def test_without_pixels_the_profile_is_zero(reach_px):
    """The smoothing alone leaves every parabola free: its matrix has no factor but for rounding."""
    assert not np.any(ProfileSums(reach_px, 2).solve().coefs)

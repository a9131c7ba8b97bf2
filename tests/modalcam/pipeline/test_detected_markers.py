"""A failure names the markers that the program chose itself."""

import numpy as np
from kit.series import series_of

from modal_id import IdentifySettings
from modalcam.pipeline import identify_series


def test_a_failure_names_markers_that_nobody_chose():
    time_s = np.arange(500) / 250.0
    still = series_of(time_s, np.random.default_rng(1).standard_normal((500, 3)))
    settings = IdentifySettings(seed=1)
    chosen = identify_series(still, settings, None)
    assert not chosen
    assert "pick" not in chosen.reason, "the markers were named in the configuration"
    detected = identify_series(still, settings, None, "3 dots")
    assert detected.reason.startswith(chosen.reason)
    assert "3 dots were detected without a kind of marker being given" in detected.reason
    assert "modalcam pick" in detected.reason

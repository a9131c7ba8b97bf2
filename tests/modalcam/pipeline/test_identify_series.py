"""What the stage of the identification adds: the choice of markers, and a rolling shutter that nobody stated."""

import numpy as np
from kit.series import QUICK, series_of

from modal_id import IdentifySettings
from modalcam.pipeline import ImageRows, identify_series


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


def test_the_note_is_that_of_rows_whose_readout_is_not_given():
    rows, time_s = np.linspace(10.0, 210.0, 8), np.arange(160) / 200.0
    turns = 2.0 * np.pi * 9.0 * (time_s[:, None] + 2e-5 * rows)
    noise = 0.01 * np.random.default_rng(3).normal(size=turns.shape)
    series = series_of(time_s, np.linspace(0.3, 1.0, 8) * np.exp(-0.01 * turns) * np.cos(turns) + noise)
    settings = IdentifySettings(onset_s=0.0, sampler=QUICK, seed=1)
    told, silent = (
        [note for note in identify_series(series, settings, None, rows=given).notes if "readout_s" in note]
        for given in (ImageRows(rows, 241), None)
    )
    assert silent == []
    # 20 us for each of 240 steps between rows.
    assert abs(float(told[0].split("readout_s = ")[1].split()[0]) / 4.8e-3 - 1.0) < 0.1

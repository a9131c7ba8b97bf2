"""A phone's slow motion: frames at 30, 960 and again 30 fps in one file, with the times of all frames in it."""

from fractions import Fraction

import numpy as np
import pytest
from kit import films as media
from kit.identified import in_sd, quick
from kit.series import decay

from tracker import TrackerSettings, displacement_series, flags, track

FREQUENCY_HZ, ZETA = 23.0, 0.012
PARTS = ((45, 30), (500, 960), (45, 30))
TICKS_PER_S = 90000


def film(path, playback=1):
    """A dot in free decay throughout; stamps are the true times, slowed down `playback` times."""
    steps = np.concatenate([np.full(count, 1.0 / rate) for count, rate in PARTS])
    time_s = np.concatenate([[0.0], np.cumsum(steps)[:-1]])
    swing = decay(time_s, FREQUENCY_HZ, ZETA, 60.0, 0.0)
    centres = np.stack([100.0 + swing, np.full(swing.size, 30.0)], axis=1)[:, None]
    images = media.dots(centres, shape=(60, 200), radius_px=6.5, contrast=160.0, noise=2.0, seed=7)
    stamps = np.rint(playback * TICKS_PER_S * time_s).astype(int).tolist()
    media.write(
        path, images, codec="libx264", pts=stamps, time_base=Fraction(1, TICKS_PER_S), options={"qp": "0"}
    )
    return path, time_s


@pytest.mark.parametrize(
    ("playback", "fps"),
    # Fast: the film whose stamps have to be scaled; test_time_axis.py has such stamps with and without a rate.
    [
        pytest.param(1, None, marks=pytest.mark.slow),
        pytest.param(1, Fraction(960), marks=pytest.mark.slow),
        (8, Fraction(960)),
    ],
    ids=["stamps", "named", "slowed down"],
)
def test_the_part_in_slow_motion_is_identified(playback, fps, tmp_path):
    path, time_s = film(tmp_path / "a.mp4", playback)
    tracks = track(path, TrackerSettings(kind="blob", fps=fps), recording="a")
    left_out = (tracks.flags[:, 0] & flags.OTHER_RATE.value) > 0
    assert np.array_equal(np.flatnonzero(~left_out), np.arange(45, 546))
    # A line through 500 stamps that are rounded to ticks of 11 us, slowed down or not.
    assert np.allclose(tracks.time_s[~left_out], time_s[~left_out], rtol=2e-5, atol=2e-5)
    series = displacement_series(tracks)
    assert np.isnan(series.values[left_out]).all()
    found = quick(series, seed=1)
    assert found
    (mode,) = found.modes
    assert np.max(np.abs(in_sd(mode, FREQUENCY_HZ, ZETA))) < 3.0, mode
    # Half a second from 4 px on with 0.007 px of noise determines 23 Hz to 1e-5, stamps of a phone to 1e-3.
    assert mode.frequency_sd_hz < 1.1e-3 * FREQUENCY_HZ, (
        f"{mode.frequency_sd_hz / FREQUENCY_HZ:.1e} of the frequency"
    )

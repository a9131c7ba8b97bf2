"""Attenuation by the exposure: the formula against a numerical mean and against tracked rendered footage."""

from fractions import Fraction

import numpy as np
import pytest
from kit.scenes import Recording

from tracker import TrackerSettings, track
from tracker.geometry import exposure_attenuation


@pytest.mark.parametrize(
    ("frequency_hz", "exposure_s"), [(10.0, 1e-3), (88.6, 2e-3), (400.0, 2e-3), (5.0, 0.0)]
)
def test_attenuation_is_the_mean_over_the_exposure(frequency_hz, exposure_s):
    t = (np.arange(2000) + 0.5) / 2000 * exposure_s - 0.5 * exposure_s
    mean = np.mean(np.cos(2 * np.pi * frequency_hz * t))
    # The midpoint rule of 2000 points errs by at most (pi f T / 2000)^2 / 6.
    assert exposure_attenuation(frequency_hz, exposure_s) == pytest.approx(mean, abs=2e-6)


@pytest.mark.parametrize("wrong", [(-1.0, 1e-3), (1.0, -1e-3), (float("nan"), 1e-3), (1.0, float("inf"))])
def test_invalid_values_are_rejected(wrong):
    with pytest.raises(ValueError, match="finite and not negative"):
        exposure_attenuation(*wrong)


def test_tracked_amplitude_is_attenuated_as_predicted(tmp_path):
    # 60 Hz at 1000 fps, exposed 90 % of the time: f T = 0.054 reduces 3 px by 0.48 %.
    exposure_s, frequency_hz = 9e-4, 60.0
    recording = Recording(
        "blob", frames=100, markers=4, width_px=320, height_px=64, frequency_hz=frequency_hz,
        exposure_s=exposure_s, rotation_rad=0.0, amplitude_px=3.0,
    )  # fmt: skip
    path = recording.write(tmp_path / "a.mkv")
    settings = TrackerSettings(fps=Fraction(1000), exposure_s=exposure_s, kind="blob")
    tracks = track(path, settings, recording="a")
    phase = 2 * np.pi * frequency_hz * tracks.time_s
    design = np.stack([np.sin(phase), np.cos(phase), np.ones_like(phase)], axis=1)
    coefs = np.linalg.lstsq(design, tracks.x_px, rcond=None)[0]
    amplitude = np.mean(np.hypot(coefs[0], coefs[1]))
    # With a bound of 0.006 px per dot, 100 frames and 4 markers, the mean amplitude has an sd of 0.00042 px: 4 sd.
    assert amplitude / 3.0 == pytest.approx(
        exposure_attenuation(frequency_hz, exposure_s), abs=4 * 0.00042 / 3
    )

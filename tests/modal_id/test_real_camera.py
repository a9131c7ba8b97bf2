"""Free-free beam excited by an impact hammer, recorded at 15 000 fps and tracked by its authors: 15 points, 0.25 s."""

import numpy as np
import pytest
from kit.identified import quick
from kit.series import series_of
from support.paths import REALDATA, REALDATA_ABSENT

FOLDER = REALDATA / "photron_beam_impact"

pytestmark = pytest.mark.skipif(not FOLDER.is_dir(), reason=REALDATA_ABSENT)


def near(found, frequency_hz):
    return min(found.modes, key=lambda mode: abs(mode.frequency_hz - frequency_hz))


@pytest.fixture(scope="module")
def camera():
    values = np.load(FOLDER / "displacements_lk.npy")[:, :, 0].T
    return quick(series_of(np.arange(values.shape[0]) / 15000.0, values, unit="m"), max_modes=4)


@pytest.fixture(scope="module")
def accelerometer():
    lines = (FOLDER / "acceleration.lvm").read_text().replace(",", ".").splitlines()
    head = next(i for i, line in enumerate(lines) if line.startswith("X_Value"))
    acceleration = np.array([float(line.split("\t")[1]) for line in lines[head + 1 :] if line.strip()])
    time_s = np.arange(acceleration.size) * 2e-5
    part = time_s < 0.25
    return quick(series_of(time_s[part], acceleration[part], unit="g"))


@pytest.mark.slow  # in the fast suite: one of them, together with the accelerometer
def test_two_bending_modes_from_the_camera_alone(camera):
    """Camera poles published by the authors: 695.4 and 1897.7 Hz with a negative damping ratio."""
    assert camera.onset.source == "peak"
    first, second = near(camera, 695.7), near(camera, 1898.0)
    assert first.frequency_hz == pytest.approx(695.7, abs=0.5)
    assert second.frequency_hz == pytest.approx(1898.0, abs=1.0)
    assert 0.0042 < first.damping_ratio < 0.0050
    assert 0.0023 < second.damping_ratio < 0.0035
    # The oscillation on the supports, 20 times the modes, is part of the baseline.
    assert np.all(camera.residual_sd < 0.3e-6)


@pytest.mark.parametrize("frequency_hz", [695.7, 1898.0])
def test_camera_and_accelerometer_agree(camera, accelerometer, frequency_hz):
    """Two sensors, one impact: 90 % intervals of the damping ratio overlap, frequencies within 0.1 Hz plus 3 sd."""
    optical, contact = near(camera, frequency_hz), near(accelerometer, frequency_hz)
    (low_a, high_a), (low_b, high_b) = optical.damping_interval(), contact.damping_interval()
    assert max(low_a, low_b) < min(high_a, high_b), (
        f"{optical.damping_interval(0.9)} and {contact.damping_interval(0.9)}"
    )
    sd = np.hypot(optical.frequency_sd_hz, contact.frequency_sd_hz)
    assert abs(optical.frequency_hz - contact.frequency_hz) < 0.1 + 3 * sd

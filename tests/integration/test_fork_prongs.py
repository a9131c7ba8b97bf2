"""Both prongs of a filmed tuning fork: their frequencies agree, and compression limits the fit of Eq. 1."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from kit.films import first_frames
from kit.identified import quick
from kit.series import least_squares_fit
from support.paths import REALDATA, REALDATA_ABSENT

from modal_id import IdentifySettings, identify
from tracker import TrackerSettings, displacement_series, flags, track

FORKS = REALDATA / "tuning_forks"
CLIP = next(iter(sorted(FORKS.glob("tuning_hz32_fps1000*.mp4"))), None)

pytestmark = pytest.mark.skipif(CLIP is None, reason=REALDATA_ABSENT)

PRONGS = ((298.0, 102.0), (364.0, 103.0))
# the last frames of the clip are copies of one frame
MOVING = slice(100, 3300)


def tracked(points, size_px=None, clip=CLIP):
    settings = TrackerSettings(fps=Fraction(1000), kind="patch", points_px=points, size_px=size_px)
    return track(clip, settings, recording="fork")


@pytest.fixture(scope="module")
def prongs():
    return tracked(PRONGS)


def eq1_fit(x_px):
    """Frequency and residual of a position after a fit of Eq. 1 and a cubic drift."""
    moving = x_px[MOVING]
    return least_squares_fit((MOVING.start + np.arange(moving.size)) / 1000, moving)


def test_tuning_fork_by_patches(prongs):
    assert prongs.decode.frames_decoded == 3336
    assert np.all(prongs.flags & flags.LOSSY.value)
    # About the last ten frames of the clip are the same image.
    repeated = (prongs.flags[:, 0] & flags.DUPLICATE_FRAME.value) > 0
    assert repeated[-8:].all()
    assert repeated.sum() < 20
    series = displacement_series(prongs)
    assert abs(series.direction[0]) > 0.99
    for k in range(2):
        frequency_hz, residual = eq1_fit(series.values[:, k])
        # 31.971 Hz by another method; 3.2 s with a noise of 0.05 px at 1.3 px determine it to about 1 mHz.
        assert frequency_hz == pytest.approx(31.971, abs=0.005)
        assert np.std(residual) < 0.06
    assert np.corrcoef(np.nan_to_num(series.values).T)[0, 1] < -0.98, "the prongs move in opposite directions"


@pytest.fixture(scope="module")
def modes(prongs):
    """The target mode of each prong, identified alone."""
    series = displacement_series(prongs)
    modes = []
    for k in range(2):
        part = np.s_[:, k : k + 1]
        one = replace(
            series,
            channels=series.channels[k : k + 1],
            values=series.values[part],
            sd=series.sd[part],
            positions_mm=series.positions_mm[k : k + 1],
        )
        found = quick(one, target_frequency_hz=32.0, seed=1, seed_key=(1, k))
        modes.append(found.target)
        # measured: 0.033 and 0.028 px
        assert found.residual_sd[0] < 0.036
    return modes


@pytest.mark.slow  # in the fast suite: frequencies by Eq. 1 of both prongs, above
def test_both_prongs_have_the_same_frequency(modes):
    left, right = modes
    gap = abs(left.frequency_hz - right.frequency_hz)
    sd = np.hypot(left.frequency_sd_hz, right.frequency_sd_hz)
    assert gap < 3 * sd, f"{gap:.2g} Hz apart, sd {sd:.2g} Hz"
    assert left.frequency_hz == pytest.approx(31.971, abs=0.003)


@pytest.mark.slow
def test_damping_of_a_prong_agrees_with_other_analyses_and_is_as_uncertain_as_the_clip(modes):
    """The amplitude falls by only a fifth.

    Least squares of the positions that Lucas-Kanade follows gives 3.95e-4 without the repeated last frames, and 3.45e-4
    to 4.3e-4 for single seconds; another analysis of the clip states 3.0e-4.
    """
    left = modes[0]
    low, high = left.damping_interval(0.9)
    assert low <= 3.95e-4 <= high
    # At small amplitude, which the clip does not show, the interval is that of the damping of other structures.
    small, sd = left.small_amplitude_damping
    assert small - 1.645 * sd <= 3.0e-4 <= small + 1.645 * sd
    # Each GOP of the H.264 file has its own amplitude error of about 0.7 %: the slope over 14 of them then has an sd
    # of 0.7 % / (3.3 s sqrt(14 / 12)), which is 1e-5 of zeta at 32 Hz.
    assert high - low > 2 * 1.645 * 1e-5, f"{low} to {high} is narrower than this clip allows"


@pytest.mark.parametrize(
    ("prong", "frames"), [*(pytest.param(prong, 3300, marks=pytest.mark.slow) for prong in PRONGS)]
)
def test_windows_without_a_common_pixel_share_an_error_of_0_02_px(prong, frames, tmp_path):
    """Windows above and below a prong's centre share no pixel, but their residuals share a part of 0.02 px.

    Sensor noise would be independent. The common part comes from the coded image, for example from the motion vectors
    of H.264, so that no choice of window or weights removes it.
    """
    x, y = prong
    # Windows of 31 px reach 15 px from their centres: from row y - 31 to y - 1, and from y + 1 to y + 31.
    clip = first_frames(CLIP, tmp_path / CLIP.name, frames)
    halves = tracked(((x, y - 16), (x, y + 16)), size_px=31.0, clip=clip)
    residuals = np.array([eq1_fit(halves.x_px[:, k])[1] for k in range(2)])
    covariance = np.cov(residuals)
    common_px = np.sqrt(covariance[0, 1])
    # measured: 0.019 and 0.021 px; each half alone 0.031 to 0.035, their mean 0.027 and 0.028.
    assert 0.014 < common_px < 0.026
    assert np.sqrt(np.diag(covariance)).max() < 0.040
    # A covariance of independent errors of 0.033 px in n frames would be below 3 * 0.033^2 / sqrt(n).
    assert covariance[0, 1] > 3 * 0.033**2 / np.sqrt(residuals.shape[1])


@pytest.mark.slow
def test_a_prong_followed_as_a_line_has_the_frequency_of_the_patches():
    """The bare prong below its weight, 20 stations: no patch on it, and the same frequency."""
    line_px = ((346.0, 412.0), (358.0, 140.0))
    settings = TrackerSettings(fps=Fraction(1000), kind="line", line_px=line_px, stations=20)
    series = displacement_series(track(CLIP, settings, recording="fork"))
    found = identify(series, IdentifySettings(target_frequency_hz=32.0, seed=1))
    # Patches: 31.971 +- 0.003 Hz, as above; measured with the line: 31.9717 +- 0.0002.
    assert found.target.frequency_hz == pytest.approx(31.971, abs=0.003)
    # Its first bending shape grows towards the weight.
    amplitude = np.nanstd(series.values, axis=0)
    assert np.all(np.diff(amplitude) > 0.0), amplitude

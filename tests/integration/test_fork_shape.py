"""The shape of a filmed tuning fork's prongs, followed as bare lines, against beam theory."""

from fractions import Fraction

import numpy as np
import pytest
from scipy.optimize import brentq, minimize_scalar
from support.paths import REALDATA, REALDATA_ABSENT

from modal_id import IdentifySettings, identify
from tracker import TrackerSettings, displacement_series, track

CLIP = REALDATA / "ordinary" / "fork32_beside_machine_fps250_repeated_last_frames.mp4"
LEFT, RIGHT = ((161.5, 415.0), (167.5, 65.0)), ((189.0, 415.0), (219.0, 74.0))
# From the end of the line to the middle of the weight at the tip, and its mass relative to the prong, both from the
# picture: a disc of about the volume of the prong.
WEIGHT_PX, WEIGHT_RATIO = 21.0, 1.0
FPS, STATIONS = 250, 24

pytestmark = [pytest.mark.skipif(not CLIP.is_file(), reason=REALDATA_ABSENT), pytest.mark.slow]


def first_mode(x, ratio):
    """Euler-Bernoulli shape over x from the clamp, 0, to the weight, 1, of the lowest frequency."""

    def characteristic(k):
        tip = np.cos(k) * np.sinh(k) - np.sin(k) * np.cosh(k)
        return 1.0 + np.cos(k) * np.cosh(k) + ratio * k * tip

    k = brentq(characteristic, 0.5, 1.8752)
    share = (np.cosh(k) + np.cos(k)) / (np.sinh(k) + np.sin(k))
    z = k * np.maximum(x, 0.0)
    return np.cosh(z) - np.cos(z) - share * (np.sinh(z) - np.sin(z))


def mac(one, other):
    return np.abs(np.vdot(one, other)) ** 2 / (np.vdot(one, one).real * np.vdot(other, other).real)


@pytest.fixture(scope="module")
def prongs():
    """Mode and tracks of the left and the right prong."""
    found = []
    for line_px in (LEFT, RIGHT):
        settings = TrackerSettings(fps=Fraction(FPS), kind="line", line_px=line_px, stations=STATIONS)
        tracks = track(CLIP, settings, recording="fork")
        series = displacement_series(tracks)
        mode = identify(series, IdentifySettings(target_frequency_hz=32.0, seed=1)).target
        # Channels of stations that the codec hides are left out.
        used = [tracks.markers.index(name) for name in series.channels]
        found.append((mode, tracks, np.array(used)))
    return found


def delay_per_row(mode, tracks, used):
    """Slope of the phase over the rows of the image as a time, in s."""
    row = np.nanmedian(tracks.y_px, axis=0)[used]
    seen = np.isfinite(mode.shape)
    size = np.abs(mode.shape[seen])
    slope = np.polyfit(row[seen], np.unwrap(np.angle(mode.shape[seen])), 1, w=size)[0]
    return slope / (2.0 * np.pi * mode.frequency_hz), row


def test_a_prong_bends_as_a_clamped_beam_with_a_weight(prongs):
    mode, tracks, used = prongs[1]
    delay_s, row = delay_per_row(mode, tracks, used)
    shape = mode.shape * np.exp(-2j * np.pi * mode.frequency_hz * delay_s * row)
    length_px = np.linalg.norm(np.subtract(*RIGHT))
    arc_px = (length_px * (np.arange(STATIONS) + 0.5) / STATIONS)[used]

    def lacks(clamp_px):
        theory = first_mode((arc_px - clamp_px) / (length_px + WEIGHT_PX - clamp_px), WEIGHT_RATIO)
        return 1.0 - mac(shape, theory.astype(complex))

    # The clamp is below the picture: its distance from the lower end of the line is fitted.
    best = minimize_scalar(lacks, bounds=(-80.0, 40.0), method="bounded")
    hinged = minimize_scalar(lambda c: 1.0 - mac(shape, arc_px - c + 0j), bounds=(-80, 80), method="bounded")
    # Stations in H.264 scatter about a smooth line by 0.01 of the tip's motion, whose rms over the line is 0.5 of it:
    # (0.01 / 0.5)^2 = 4e-4.
    assert best.fun < 1e-3, best
    assert hinged.fun > 5.0 * best.fun, "a prong that turns as a rigid bar would do"
    assert -80.0 < best.x < 40.0


def test_both_prongs_show_one_rolling_shutter(prongs):
    """Lower rows are exposed later: along both prongs, the phase grows by the same time for each row."""
    left_s, right_s = (delay_per_row(*each)[0] for each in prongs)
    # Measured with 68 stations: 8.2 and 7.7 us; the lowest stations move by less than 0.1 px.
    assert left_s == pytest.approx(right_s, rel=0.1)
    # Rows of one frame are read before those of the next.
    assert 0.0 < 420 * right_s < 1.0 / FPS


def test_the_prongs_move_in_opposite_phase(prongs):
    """The mode of a fork in which its stem rests; the rows of both tips differ by 10, of 8 us each: 0.9 degrees."""
    tips = []
    for mode, tracks, used in prongs:
        x = tracks.x_px[:, used[-1]]
        time_s, good = np.arange(x.size) / FPS, np.isfinite(x)
        turns = 2.0 * np.pi * mode.frequency_hz * time_s
        design = np.stack([np.cos(turns), -np.sin(turns), np.ones_like(turns)], axis=1)[good]
        cosine, sine, _ = np.linalg.lstsq(design, x[good], rcond=None)[0]
        tips.append(complex(cosine, sine))
    ratio = tips[0] / tips[1]
    # 32 Hz over 3.6 s with frequencies that agree within 1e-3 Hz: 1.3 degrees.
    assert abs(np.degrees(np.angle(-ratio))) < 3.0
    assert 0.8 < abs(ratio) < 1.25

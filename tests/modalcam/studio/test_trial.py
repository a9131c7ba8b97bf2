"""What a test track shows: the window that follows a marker, what a run would give, and what to change."""

from dataclasses import replace
from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import pytest
from support.modalcam_data import sample_tracks

from modalcam.studio.decoding import Problem
from modalcam.studio.expected import expected_intervals
from modalcam.studio.trial import Trial
from modalcam.studio.trial_summary import TrialRow, _advice, summarised
from modalcam.studio.trial_windows import evenly, followed_windows
from tracker.geometry.time_axis import TimeAxis

SD_PX, FPS, FRAMES = 0.01, 500.0, 300


def oscillating(amplitude_px, frequency_hz=40.0, noise_px=SD_PX, markers=("m1",)):
    """Tracks of markers that oscillate in x with known standard deviation."""
    rng = np.random.default_rng(3)
    time_s = np.arange(FRAMES) / FPS
    swing = np.multiply.outer(
        np.cos(2 * np.pi * frequency_hz * time_s + 0.4), np.broadcast_to(amplitude_px, len(markers))
    )
    shape = swing.shape
    return replace(
        sample_tracks(),
        markers=tuple(markers),
        frame=np.arange(FRAMES),
        time_s=time_s,
        x_px=100.0 + swing + rng.normal(0.0, noise_px, shape),
        y_px=50.0 + rng.normal(0.0, noise_px, shape),
        sd_x_px=np.full(shape, SD_PX),
        sd_y_px=np.full(shape, SD_PX),
        flags=np.zeros(shape, np.uint32),
        positions_mm=np.full(len(markers), np.nan),
        scale=None,
        time_axis=TimeAxis("user", Fraction(500)),
        reference=(),
        correlation_xy=None,
    )


def test_the_expected_interval_is_that_of_a_sinusoid_in_white_noise():
    """Rife and Boorstyn (1974): var(f) = 6 sd^2 / (pi^2 A^2 T^2 N); that of zeta is var(f) / f^2 without damping.

    30 px and 160 cycles: the errors of the template and the drift, which the formula leaves out, add under 5 %.
    """
    found = expected_intervals(oscillating(30.0), 2000, (1e-7,))
    (row,) = found.rows
    length_s = 2000 / FPS
    classical_hz = np.sqrt(6.0 / 2000) * SD_PX / (np.pi * 30.0 * length_s)
    assert found.frequency_hz == pytest.approx(40.0, abs=0.02)
    assert found.amplitude_px == pytest.approx(30.0, rel=0.01)
    assert found.seconds == pytest.approx(length_s)
    assert row.frequency_hz == pytest.approx(1.645 * classical_hz, rel=0.05)
    assert row.damping == pytest.approx(1.645 * classical_hz / 40.0, rel=0.05)


def test_markers_add_their_information():
    """Four equal markers halve a standard deviation; damping widens it."""
    one, four = (
        expected_intervals(oscillating(30.0, markers=names), 2000, (1e-4, 3e-3)).rows
        for names in (("m1",), ("m1", "m2", "m3", "m4"))
    )
    assert one[0].frequency_hz / four[0].frequency_hz == pytest.approx(2.0, rel=0.02)
    assert one[1].frequency_hz > 2.0 * one[0].frequency_hz


@pytest.mark.parametrize(
    ("amplitude_px", "frequency_hz", "reason"),
    [(0.0, 40.0, "rises above the noise"), (5.0, 3.0, "shorter than three cycles")],
)
def test_without_a_motion_there_is_no_prediction(amplitude_px, frequency_hz, reason):
    found = expected_intervals(oscillating(amplitude_px, frequency_hz), 2000)
    assert isinstance(found, Problem)
    assert reason in found.reason


def test_the_rate_of_playback_gives_no_prediction():
    tracks = replace(oscillating(5.0), time_axis=TimeAxis("container", Fraction(50)))
    assert "the recorded rate is not known" in expected_intervals(tracks, 2000).reason


def textured(seed, size=96):
    """Smooth texture whose spectrum ends well below the limit of the grid: it can be shifted without an error."""
    rng = np.random.default_rng(seed)
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(size), np.fft.fftfreq(size)))
    spectrum = np.fft.fft2(rng.normal(size=(size, size))) * (frequency < 0.15)
    texture = np.fft.ifft2(spectrum).real
    return 120.0 + 40.0 * texture / texture.std()


def shifted(image, dx):
    phase = np.exp(-2j * np.pi * np.fft.fftfreq(image.shape[1]) * dx)
    return np.fft.ifft(np.fft.fft(image, axis=1) * phase, axis=1).real


@pytest.mark.parametrize(("fixed_rows", "least", "most"), [(0, 0.0, 0.03), (48, 0.35, 1.5)])
def test_what_does_not_move_with_the_marker_is_not_explained(fixed_rows, least, most):
    """A window of one texture, and one of which half is a second texture at rest, moved by 3 px either way.

    Rounding to gray levels leaves 0.3 of a contrast of 40. The half at rest, correlated over about 3 px, changes by
    about its own contrast over half of the area.
    """
    moving, still = textured(1), textured(2)
    swing = 3.0 * np.sin(0.7 * np.arange(40))
    images = []
    for dx in swing:
        image = shifted(moving, dx)
        image[:fixed_rows] = still[:fixed_rows]
        images.append(np.clip(np.rint(image), 0, 255).astype(np.uint8))
    tracks = SimpleNamespace(
        markers=("m1",), time_s=np.arange(40), x_px=48.0 + swing[:, None], y_px=np.full((40, 1), 48.0)
    )
    (window,) = followed_windows(tracks, [*images[:5], None, *images[6:]], (0,))
    assert least <= window.unexplained <= most
    assert window.mean_png.startswith(b"\x89PNG")
    assert window.residual_png.startswith(b"\x89PNG")


def test_blur_follows_from_the_exposure():
    """A step between frames and the exposed share of their distance in time."""
    tracks = oscillating(30.0)
    step = 2 * 30.0 * np.sin(np.pi * 40.0 / FPS)  # the largest chord of the motion
    (row,) = summarised(Trial(tracks, (), 0.25)).rows
    assert row.step_px == pytest.approx(step, rel=0.01)
    assert row.blur_px == pytest.approx(0.25 * row.step_px)
    (unknown,) = summarised(Trial(tracks, (), None)).rows
    assert unknown.as_text()[5] == "–"


GOOD = TrialRow("m1", 0.004, 0.004, 3.0, 1.0, 0.1, 0.0, 0.05)


@pytest.mark.parametrize(
    ("change", "advice"),
    [
        ({}, None),
        ({"sd_px": 0.08}, "more contrast"),
        ({"lost": 0.1}, "lost in some frames"),
        ({"blur_px": 8.0}, "shorten the exposure"),
        ({"step_px": 5.0, "blur_px": float("nan")}, "give the exposure time"),
        ({"unexplained": 0.6}, "smaller or a round window"),
        ({"motion_px": 0.001}, "farther from the clamp"),
    ],
)
def test_each_problem_of_a_marker_has_its_advice(change, advice):
    found = _advice([GOOD, replace(GOOD, name="m2", **change)])
    assert (
        found == ()
        if advice is None
        else (len(found) == 1 and found[0].startswith("m2: ") and advice in found[0])
    )


def test_markers_are_chosen_evenly_with_both_ends():
    assert evenly(3, 6) == (0, 1, 2)
    assert evenly(101, 6) == (0, 20, 40, 60, 80, 100)

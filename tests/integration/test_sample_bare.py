"""The sample recording without markers, tracked and identified with its configuration, against the renderer's truth."""

import numpy as np
import pytest
from support.paths import ROOT

from modal_id import IdentifySettings, identify
from modalcam.config import beam_properties, load_config, tracker_settings
from sim.beam import AncfBeam, beam_modes
from tracker import displacement_series, track

FOLDER = ROOT / "sample_bare"
FILM = "mode3.avi"
DAMPING_RATIO = 0.003


@pytest.fixture(scope="module")
def config():
    return load_config(FOLDER / "experiment.toml")


@pytest.fixture(scope="module")
def tracks(config):
    return track(FOLDER / FILM, tracker_settings(config.for_recording(FILM)))


@pytest.fixture(scope="module")
def identified(tracks):
    return identify(displacement_series(tracks), IdentifySettings(mode=3, seed=1))


def test_the_stations_are_where_the_renderer_put_the_line(tracks):
    # The last window includes the end of the strip, and one other is too much like its background.
    followed = np.all(np.isfinite(tracks.x_px), axis=0)
    assert followed.sum() >= 98
    x_px, y_px, sd_px = (values[:, followed] for values in (tracks.x_px, tracks.y_px, tracks.sd_x_px))
    with np.load(FOLDER / "truth.npz") as truth:
        # Distances from the clamp by the first frame, in which the beam is almost straight.
        arc = np.interp(y_px[0], truth["y_px"][0], truth["position_mm"])
        error = x_px - np.array([np.interp(arc, truth["position_mm"], x) for x in truth["x_px"]])
    rms = np.sqrt(np.mean((error - error.mean(axis=0)) ** 2))
    ratio = rms / np.sqrt(np.mean(sd_px**2))
    # The sd includes that of the compression, estimated from the series: known to a few percent.
    assert abs(ratio - 1.0) < 0.1, f"errors of {rms:.4f} px are {ratio:.3f} times the stated sd"
    # Where the strip hardly moves, its background is not seen alone: it shifts the place at rest, not the motion.
    assert np.abs(error.mean(axis=0)).max() < 0.2


def test_frequency_and_damping_are_those_of_the_simulated_beam(identified, config):
    mode = identified.target
    frequency_hz = beam_modes(AncfBeam(beam_properties(config.beam)), 3).frequency_hz[2]
    for found, sd, true in (
        (mode.frequency_hz, mode.frequency_sd_hz, frequency_hz),
        (mode.damping_ratio, mode.damping_ratio_sd, DAMPING_RATIO),
    ):
        assert abs(found - true) < 3.0 * sd, f"found {found:.6g} +- {sd:.2g}, true {true:.6g}"
    # The intervals are narrow enough to tell something: 0.1 % and 5 %.
    assert mode.frequency_sd_hz < 1e-3 * frequency_hz
    assert mode.damping_ratio_sd < 0.05 * DAMPING_RATIO


def test_the_shape_differs_from_the_simulated_one_by_as_much_as_is_stated(tracks, identified):
    """Stations against the renderer's motion, fitted with the identified pole.

    The errors of compressed frames return with the motion and are alike in the five to ten stations of a block and its
    neighbours: of 98 stations about a dozen are independent, which determine the rms of z to 20 %.
    """
    mode = identified.target
    seen = np.all(np.isfinite(tracks.x_px), axis=0) & np.isfinite(mode.shape)
    with np.load(FOLDER / "truth.npz") as truth:
        arc = np.interp(tracks.y_px[0, seen], truth["y_px"][0], truth["position_mm"])
        x_px = np.array([np.interp(arc, truth["position_mm"], x) for x in truth["x_px"]])
    decay = -mode.damping_ratio * mode.omega_n_rad_s
    pole = complex(decay, mode.omega_n_rad_s * np.sqrt(1.0 - mode.damping_ratio**2))
    wave = np.exp(pole * (tracks.time_s - identified.onset.fit_from_s))
    rows = identified.used.any(axis=1)
    columns = np.column_stack([wave.real, -wave.imag, np.ones_like(tracks.time_s)])
    parts = np.linalg.lstsq(columns[rows], x_px[rows], rcond=None)[0]
    true, shape = parts[0] + 1j * parts[1], mode.shape[seen]
    scale = np.vdot(true, shape) / np.vdot(true, true)
    z = np.real((shape - scale * true) * np.exp(-1j * np.angle(scale * true))) / mode.shape_sd[seen]
    rms = np.sqrt(np.mean(z**2))
    assert 0.4 < rms < 1.6, (
        f"in-phase errors of the shape are {rms:.2f} times the stated sd; 1 within three times 20 %"
    )

"""Positions against the true positions of rendered footage, in multiples of the Cramer-Rao bound."""

import numpy as np
import pytest
from kit.scenes import FPS, Recording, cramer_rao_px, errors_px

from tracker import TrackerSettings, flags, track

# An exposure of a hundredth of the time between frames, for films without blur: no path is as long as 0.1 px.
SHORT_S = 1e-5


def tracked(recording, path, codec="ffv1", exposure_s=SHORT_S, **options):
    recording.write(path, codec, **options)
    # Codes of any dictionary are searched for in tracker/markers/test_detection.py.
    settings = TrackerSettings(
        fps=FPS, kind=recording.kind, dictionary="DICT_4X4_50", exposure_s=recording.exposure_s or exposure_s
    )
    tracks = track(path, settings, recording=path.name)
    assert tracks, tracks.reason
    return tracks


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


@pytest.fixture(scope="module", params=["blob", "aruco"])
def scene(request, tmp_path_factory):
    recording = Recording(request.param, frames=100, markers=6, width_px=480, height_px=160)
    path = tmp_path_factory.mktemp("scene") / "scene.mkv"
    # The exposure is estimated, too.
    tracks = tracked(recording, path, exposure_s=None)
    return recording, tracks, errors_px(tracks, recording.truth_px())


def test_every_marker_is_found_in_every_frame(scene):
    _, tracks, errors = scene
    assert len(tracks.markers) == 6
    assert np.all(np.isfinite(errors)), "every marker is in every frame"


def test_error_is_near_the_cramer_rao_bound(scene):
    recording, _, errors = scene
    bound = np.array(
        [cramer_rao_px(recording, k, with_angle=recording.kind == "aruco") for k in range(0, 6, 3)]
    )
    ratio = rms(errors) / rms(bound)
    # 1200 errors: the ratio of a perfect estimator scatters by 1 / sqrt(2400) = 2 %.
    assert ratio < (1.1 if recording.kind == "aruco" else 1.05), (
        f"rms error is {ratio:.3f} of the Cramer-Rao bound of {rms(bound):.4f} px"
    )
    assert ratio > 0.9, f"{ratio:.3f} of the bound: an unbiased estimator cannot be better than 1"


def test_stated_sd_is_calibrated(scene):
    _, tracks, (ex, ey) = scene
    for error, sd in ((ex, tracks.sd_x_px), (ey, tracks.sd_y_px)):
        assert 0.9 < rms(error / sd) < 1.15, f"error over stated sd is {rms(error / sd):.3f}"


def test_no_pixel_locking_and_no_amplitude_bias(scene):
    _, tracks, (ex, _) = scene
    x = tracks.x_px.ravel()
    phase = 2 * np.pi * (x % 1.0)
    error = ex.ravel()
    sd = float(np.median(tracks.sd_x_px))
    amplitude = 2 * np.hypot(np.mean(error * np.cos(phase)), np.mean(error * np.sin(phase)))
    # White errors alone give a mean amplitude of sd sqrt(pi / n); the probability of 3.5 times that is 7e-5.
    limit = 3.5 * sd * np.sqrt(np.pi / error.size)
    assert amplitude < limit, (
        f"errors vary with the pixel phase by {amplitude:.5f} px (limit by noise {limit:.5f})"
    )
    motion = tracks.x_px - tracks.x_px.mean(axis=0)
    slope = float(np.sum(motion * ex) / np.sum(motion**2))
    slope_sd = sd / np.sqrt(np.sum(motion**2))
    assert abs(slope) < 4 * slope_sd, f"amplitude is off by {slope:.1e} (limit by noise {4 * slope_sd:.1e})"


# Illumination from 0.4 to 1.2 of that in the centre; it changes by 1.4 % over the path of a dot.
UNEVEN = {"light_gradient": (0.8, 0.3), "vignetting": 0.25}
# Two markers as far apart as five in the default width: 280 errors, of whose rms the ratio scatters by 4 %.
TWO = {"markers": 2, "width_px": 256, "height_px": 120}


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("small aruco", {"kind": "aruco", "size_px": 14.0, **TWO}),
        ("small dot", {"kind": "blob", "size_px": 5.5, **TWO}),
        pytest.param(
            "large dot",
            {"kind": "blob", "size_px": 40.0, "markers": 5, "height_px": 120},
            marks=pytest.mark.slow,
        ),
        pytest.param(
            "large motion",
            {"kind": "blob", "amplitude_px": 40.0, "markers": 5, "height_px": 120},
            marks=pytest.mark.slow,
        ),
        pytest.param(
            "rotation",
            {"kind": "aruco", "amplitude_px": 30.0, "rotation_rad": 0.53, **TWO},
            marks=pytest.mark.slow,
        ),
        pytest.param("noise", {"kind": "aruco", "read_noise": 8.0, **TWO}, marks=pytest.mark.slow),
        pytest.param(
            "flicker",
            {"kind": "aruco", "flicker_sd": 0.03, "markers": 5, "height_px": 120},
            marks=pytest.mark.slow,
        ),
        ("flicker on dots", {"kind": "blob", "flicker_sd": 0.03, **TWO}),
        pytest.param(
            "uneven light",
            {"kind": "aruco", **UNEVEN, "markers": 5, "height_px": 240},
            marks=pytest.mark.slow,
        ),
        pytest.param(
            "uneven light on dots",
            {"kind": "blob", **UNEVEN, "markers": 2, "height_px": 240},
            marks=pytest.mark.slow,
        ),
        pytest.param(
            "12 bit",
            {"kind": "blob", "bit_depth": 12, "markers": 5, "height_px": 120},
            marks=pytest.mark.slow,
        ),
        ("small image", {"kind": "blob", "markers": 1, "width_px": 48, "height_px": 160}),
    ],
)
def test_stated_sd_is_calibrated_in_difficult_scenes(name, options, tmp_path):
    recording = Recording(frames=70, **options)
    tracks = tracked(recording, tmp_path / "scene.mkv")
    ex, ey = errors_px(tracks, recording.truth_px())
    assert np.all(np.isfinite(ex)), f"{name}: {np.count_nonzero(np.isnan(ex))} positions were lost"
    ratio = rms(np.concatenate([(ex / tracks.sd_x_px).ravel(), (ey / tracks.sd_y_px).ravel()]))
    assert 0.7 < ratio < 1.35, f"{name}: error over stated sd is {ratio:.2f}"


def test_motion_blur_is_modelled_and_flagged(tmp_path):
    recording = Recording("blob", amplitude_px=40.0, frames=100, exposure_s=0.0009, **TWO)
    tracks = tracked(recording, tmp_path / "scene.mkv")
    ex, ey = errors_px(tracks, recording.truth_px())
    times = np.linspace(0.0, 1.0 / recording.frequency_hz, 6)[:-1]
    bound = rms([cramer_rao_px(recording, 1, with_angle=False, time_s=t) for t in times])
    assert np.any(tracks.flags & flags.BLURRED.value)
    both = np.stack([ex, ey])
    # 400 errors: the ratio of a perfect estimator scatters by 3.5 %.
    assert rms(both) < 1.1 * bound, f"rms {rms(both):.4f} px, the bound with this blur is {bound:.4f} px"
    ratio = rms(both / np.stack([tracks.sd_x_px, tracks.sd_y_px]))
    assert 0.85 < ratio < 1.15, f"error over stated sd is {ratio:.2f} under blur"
    poor = float(np.mean(tracks.flags & flags.POOR_FIT.value > 0))
    assert poor < 0.02, f"{100 * poor:.1f} % of good fits are flagged as poor"


@pytest.mark.parametrize(
    ("codec", "suffix", "largest", "markers"),
    [
        pytest.param("mjpeg", "avi", 1.6, 3, marks=pytest.mark.slow),
        ("libx264", "mp4", 10.0, 2),
        pytest.param("libx264", "mp4", 10.0, 5, marks=pytest.mark.slow),
    ],
)
def test_lossy_footage_is_flagged_and_its_sd_is_calibrated(codec, suffix, largest, markers, tmp_path):
    recording = Recording("aruco", frames=100, markers=markers, width_px=128 * markers, height_px=120)
    tracks = tracked(recording, tmp_path / f"scene.{suffix}", codec)
    ex, ey = errors_px(tracks, recording.truth_px())
    bound = rms(cramer_rao_px(recording, markers // 2, with_angle=True))
    assert np.all(tracks.flags & flags.LOSSY.value)
    assert any("lossily compressed" in note for note in tracks.notes)
    both = np.stack([ex, ey])
    assert rms(both) < largest * bound, f"{codec}: {rms(both) / bound:.1f} times the lossless bound"
    ratio = rms(both / np.stack([tracks.sd_x_px, tracks.sd_y_px]))
    assert 0.8 < ratio < 1.3, f"{codec}: error over stated sd is {ratio:.2f}"


def test_tracking_is_reproducible_to_the_byte(tmp_path):
    recording = Recording("blob", frames=40, **TWO)
    path = tmp_path / "scene.mkv"
    one, two = tracked(recording, path), tracked(recording, path)
    assert one.x_px.tobytes() == two.x_px.tobytes()
    assert one.sd_x_px.tobytes() == two.sd_x_px.tobytes()

"""Lens calibration: views of a board through a lens of known distortion, and the use of the result in a run."""

from functools import cache

import cv2
import numpy as np
import pytest
from kit.camera_files import announced_png

from modalcam.apps.targets import calibrate_folder
from modalcam.common import ConfigError, InputError
from modalcam.config import dump_config, load_config, parse_config, tracker_settings
from tracker.geometry import Board, Lens, calibrate_lens, undistort

BOARD = Board(7, 5, 30.0, 22.0, "DICT_4X4_50")
TRUTH = Lens(640, 480, (820.0, 818.0), (325.0, 236.0), (-0.22, 0.09, 6e-4, -4e-4, 0.0))
PX_PER_MM = 10
SUPERSAMPLING = 3
POSES = [
    ((0.0, 0.0, 0.0), (-105, -75, 330)),
    ((0.5, 0.0, 0.1), (-95, -85, 350)),
    ((-0.5, 0.1, 0.0), (-110, -60, 370)),
    ((0.1, 0.55, -0.1), (-90, -75, 360)),
    ((0.0, -0.55, 0.2), (-110, -90, 330)),
    ((0.4, 0.4, 0.3), (-60, -110, 380)),
    ((-0.4, 0.35, -0.3), (-130, -40, 360)),
    ((0.3, -0.45, 1.6), (75, -105, 360)),
]


def board_image():
    """The board at 10 px per mm, with its corner at the outer edge of the first pixel."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    drawn = cv2.aruco.CharucoBoard((7, 5), 30.0, 22.0, dictionary)
    return drawn.generateImage((7 * 30 * PX_PER_MM, 5 * 30 * PX_PER_MM), marginSize=0)


@cache
def fine_rays():
    """Ray of each supersampled pixel through the lens."""
    n = SUPERSAMPLING
    fine_x, fine_y = np.meshgrid((np.arange(640 * n) + 0.5) / n - 0.5, (np.arange(480 * n) + 0.5) / n - 0.5)
    x, y = undistort(TRUTH, fine_x, fine_y)
    return np.stack([(x - 325) / 820, (y - 236) / 818, np.ones_like(x)])


def view(board, angle, shift, rng):
    """An image through the lens, by intersecting the ray of each supersampled pixel with the board."""
    n = SUPERSAMPLING
    rotation = cv2.Rodrigues(np.array(angle))[0]
    direction = np.tensordot(rotation.T, fine_rays(), axes=1)
    origin = -rotation.T @ np.array(shift, dtype=float)
    reach = -origin[2] / direction[2]
    board_mm = origin[:2, None, None] + reach * direction[:2]
    at = (board_mm * PX_PER_MM - 0.5).astype(np.float32)
    fine = cv2.remap(board, at[0], at[1], cv2.INTER_LINEAR, borderValue=220)
    coarse = fine.reshape(480, n, 640, n).mean(axis=(1, 3))
    return np.clip(coarse * 0.8 + 20 + 1.5 * rng.standard_normal(coarse.shape), 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def images():
    board, rng = board_image(), np.random.default_rng(3)
    return [(f"view{k}.png", view(board, *pose, rng)) for k, pose in enumerate(POSES)]


def test_a_known_lens_is_calibrated_within_its_sd(images):
    found = calibrate_lens(images, BOARD)
    assert len(found.used) == len(POSES)
    assert found.lens.rms_px < 0.2
    values = (*found.lens.focal_px, *found.lens.centre_px, *found.lens.distortion[:4])
    truth = (*TRUTH.focal_px, *TRUTH.centre_px, *TRUTH.distortion[:4])
    z = (np.array(values) - np.array(truth)) / np.array(found.sd[:8])
    # Errors of the corners are correlated by pixel locking: four sd instead of three.
    assert np.max(np.abs(z)) < 4.0, z
    grid = np.stack(np.meshgrid(np.linspace(20, 620, 13), np.linspace(20, 460, 10)), axis=-1).reshape(-1, 2)
    error = distances(undistort(found.lens, *grid.T), undistort(TRUTH, *grid.T))
    assert np.max(distances(undistort(TRUTH, *grid.T), grid.T)) > 7.0
    # Up to the camera pose, which is correlated with focal length and centre. Corner errors of 0.085 px rms in eight
    # views give errors of about the same size, largest in the corners of the image that no board covers.
    assert np.sqrt(np.mean(error**2)) < 0.15


def distances(found, expected):
    """Distances between two sets of points after the best similarity transform."""
    a, b = (p - p.mean() for p in (found[0] + 1j * found[1], expected[0] + 1j * expected[1]))
    return np.abs(a * (np.vdot(a, b) / np.vdot(a, a)) - b)


def test_too_few_views_and_other_boards_are_rejected(images):
    assert "5 are needed" in calibrate_lens(images[:3], BOARD).reason
    other = Board(7, 5, 30.0, 22.0, "DICT_7X7_50")
    assert "DICT_7X7_50" in calibrate_lens(images, other).reason
    small = [*images[:5], ("small.png", np.zeros((100, 100), np.uint8))]
    assert "of one size" in calibrate_lens(small, BOARD).reason


@pytest.mark.usefixtures("in_process")
def test_the_command_writes_a_lens_for_the_configuration(images, tmp_path, modalcam):
    folder = tmp_path / "board"
    folder.mkdir()
    for name, image in images:
        cv2.imwrite(str(folder / name), image)
    blank = np.full((480, 640), 128, np.uint8)
    cv2.imwrite(str(folder / "blank.png"), blank)
    path = tmp_path / "camera.toml"
    code, out, err = modalcam("calibrate", folder, "-o", path)
    assert code == 0, err
    assert "8 images used, rms reprojection error" in out
    assert "left out (board not detected well enough): blank.png" in out
    config = tmp_path / "experiment.toml"
    config.write_text('[camera]\nlens = "camera.toml"\nreadout_s = 1e-3\n[markers]\nplane_mm = [[0, 1]]\n')
    loaded = load_config(config)
    settings = tracker_settings(loaded.for_recording("a.avi"))
    assert settings.lens.focal_px == pytest.approx(TRUTH.focal_px, rel=5e-3)
    assert (settings.readout_s, settings.plane_mm) == (1e-3, ((0.0, 1.0),))
    text = dump_config(loaded)
    assert "camera.toml" not in text
    assert tracker_settings(load_config(config).for_recording("a.avi")) == settings
    path.unlink()
    with pytest.raises(ConfigError, match="modalcam calibrate"):
        load_config(config)
    path.write_text("width_px = 5\n")
    with pytest.raises(ConfigError, match="expected a lens"):
        load_config(config)


def test_a_resolved_configuration_contains_the_lens(tmp_path):
    import tomllib

    (tmp_path / "lens.toml").write_text(
        "width_px = 640\nheight_px = 480\nfocal_px = [800.0, 801.0]\ncentre_px = [320.0, 240.0]\n"
        "distortion = [0.1, 0.0, 0.0, 0.0, 0.0]\n"
    )
    (tmp_path / "e.toml").write_text('[[recordings]]\nfile = "a.avi"\nlens = "lens.toml"\n')
    config = load_config(tmp_path / "e.toml")
    again = parse_config(tomllib.loads(dump_config(config)), where="dump")
    assert tracker_settings(again.for_recording("a.avi")).lens.focal_px == (800.0, 801.0)
    assert tracker_settings(again.for_recording("b.avi")).lens is None


def test_an_image_over_the_limit_is_refused_before_it_is_decoded(tmp_path):
    (tmp_path / "large.png").write_bytes(announced_png(30_000, 30_000))
    with pytest.raises(InputError, match="over the limit of 67 Mpx"):
        calibrate_folder(tmp_path, Board(7, 5, 30.0, 22.0, "DICT_4X4_50"))

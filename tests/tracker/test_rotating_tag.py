"""An AprilTag that travels on an ellipse and turns with it, rendered by sampling, independent of the program."""

from fractions import Fraction

import cv2
import numpy as np
import pytest

from sim.render import write_video
from tracker import TrackerSettings, track

HEIGHT_PX, WIDTH_PX, SIDE_PX, SUBPIXELS, BLUR_PX, NOISE = 130, 170, 40.0, 6, 0.7, 1.5
CENTRE_PX, RADII_PX, FRAMES_A_TURN = (85.3, 64.6), (40.0, 25.0), 40.0
FPS = Fraction(100)


def rendered(bits, x, y, angle):
    """Tag with a white rim of one module on gray: the mean over sub-pixels of the ideal print, blurred by the lens."""
    n = len(bits)
    # The rim reaches 34 px from the centre, the blur of the lens 4 px further.
    left, top = max(int(x) - 39, 0), max(int(y) - 39, 0)
    width, height = min(int(x) + 41, WIDTH_PX) - left, min(int(y) + 41, HEIGHT_PX) - top
    across = left + (np.arange(width * SUBPIXELS) + 0.5) / SUBPIXELS - 0.5 - x
    down = top + (np.arange(height * SUBPIXELS) + 0.5) / SUBPIXELS - 0.5 - y
    right, below = np.meshgrid(across, down)
    module = SIDE_PX / n
    u = (np.cos(angle) * right + np.sin(angle) * below) / module + n / 2
    v = (-np.sin(angle) * right + np.cos(angle) * below) / module + n / 2
    image = np.full(u.shape, 90.0)
    image[(u > -1) & (u < n + 1) & (v > -1) & (v < n + 1)] = 200.0
    inside = (u >= 0) & (u < n) & (v >= 0) & (v < n)
    image[inside] = 30.0 + 170.0 * bits[v[inside].astype(int), u[inside].astype(int)]
    image = cv2.GaussianBlur(image, (0, 0), BLUR_PX * SUBPIXELS)
    whole = np.full((HEIGHT_PX, WIDTH_PX), 90.0)
    part = image.reshape(height, SUBPIXELS, width, SUBPIXELS).mean((1, 3))
    whole[top : top + height, left : left + width] = part
    return whole


# Codes of the larger dictionary take ten times as long to read.
@pytest.mark.parametrize(
    ("name", "frames"), [("25h9", 44), pytest.param("36h11", 72, marks=pytest.mark.slow)]
)
def test_a_turning_tag_keeps_to_its_ellipse(name, frames, tmp_path):
    name = f"DICT_APRILTAG_{name}"
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
    bits = (cv2.aruco.generateImageMarker(dictionary, 3, dictionary.markerSize + 2) > 0).astype(float)
    rng = np.random.default_rng(0)
    phase = 2 * np.pi * np.arange(frames) / FRAMES_A_TURN + 0.2
    truth = np.array(CENTRE_PX) + np.stack([np.cos(phase), np.sin(phase)], axis=1) * RADII_PX
    images = []
    for (x, y), angle in zip(truth, phase, strict=True):
        image = rendered(bits, x, y, angle) + rng.normal(0.0, NOISE, (HEIGHT_PX, WIDTH_PX))
        images.append(np.clip(np.rint(image), 0, 255).astype(np.uint8))
    write_video(tmp_path / "a.mkv", images, fps_container=FPS, codec="ffv1")
    settings = TrackerSettings(fps=FPS, kind="aruco", dictionary=name, exposure_s=0.0001)
    tracks = track(tmp_path / "a.mkv", settings, recording="a")
    assert tracks, tracks.reason
    error = np.stack([tracks.x_px[:, 0], tracks.y_px[:, 0]], axis=1) - truth
    z = error / np.stack([tracks.sd_x_px[:, 0], tracks.sd_y_px[:, 0]], axis=1)
    rms_px, rms_z = float(np.sqrt(np.mean(error**2))), float(np.sqrt(np.mean(z**2)))
    assert rms_px < 0.005, f"rms {rms_px:.4f} px; the noise of the pixels allows 0.0012 px"
    # 88 coordinates: the rms of z scatters by 8 %, the noise is known to a few per cent.
    assert 0.7 < rms_z < 1.3, f"error over stated sd {rms_z:.2f}"

"""Rendered scenes with known centres for the tests of the tracker."""

from fractions import Fraction

import numpy as np

from sim.render import (
    ArucoMarker,
    Camera,
    DotMarker,
    Poses,
    Scene,
    render_frames,
    render_ideal,
    true_centres_px,
    write_video,
)

FPS = Fraction(1000)


class Recording:
    """Ten (or fewer) markers on two rows, each oscillating with its own phase."""

    def __init__(
        self,
        kind="blob",
        *,
        frames=120,
        size_px=None,
        amplitude_px=3.0,
        rotation_rad=0.02,
        frequency_hz=11.3,
        exposure_s=0.0,
        read_noise=1.5,
        markers=10,
        bit_depth=8,
        dictionary="DICT_4X4_50",
        width_px=640,
        height_px=480,
        flicker_sd=0.0,
        light_gradient=(0.0, 0.0),
        vignetting=0.0,
        seed=1,
    ):
        scale = 2.0 ** (bit_depth - 8)
        self.kind, self.exposure_s, self.seed = kind, exposure_s, seed
        self.camera = Camera(
            width_px=width_px,
            height_px=height_px,
            mm_per_px=1.0,
            origin_px=(0.0, 0.0),
            read_noise_sd=read_noise * scale,
            noise_gain=0.05 * scale,
            exposure_s=exposure_s,
            bit_depth=bit_depth,
            background=200.0 * scale,
            flicker_sd=flicker_sd,
            light_gradient=light_gradient,
            vignetting=vignetting,
        )
        columns = min(markers, 5)
        rows = -(-markers // columns)
        index = np.arange(markers)
        # mean positions cover all fractions of a pixel, so that errors that depend on them are visible
        self.x0 = width_px * (index % columns + 0.5) / columns + 0.37 * index % 1
        self.y0 = height_px * (index // columns + 0.5) / rows + 0.61 * index % 1
        self.amplitude_px, self.rotation_rad, self.frequency_hz = amplitude_px, rotation_rad, frequency_hz
        self.phase = 0.3 * index
        size = size_px or (12.0 if kind == "blob" else 24.0)
        if kind == "blob":
            drawn = tuple(DotMarker(diameter_mm=size, foreground=30.0 * scale) for _ in index)
        else:
            drawn = tuple(
                ArucoMarker(
                    dictionary=dictionary,
                    marker_id=int(k),
                    size_mm=size,
                    quiet_zone_mm=size / 6,
                    foreground=30.0 * scale,
                    background=200.0 * scale,
                )
                for k in index
            )
        self.scene = Scene(markers=drawn, motion=self.motion)
        self.time_s = np.arange(frames) / float(FPS)

    def motion(self, time_s):
        t = np.asarray(time_s)[:, None]
        swing = np.sin(2 * np.pi * self.frequency_hz * t + self.phase)
        return Poses(
            self.x0 + self.amplitude_px * swing,
            -self.y0 + 0.3 * self.amplitude_px * np.cos(2 * np.pi * 0.68 * self.frequency_hz * t),
            self.rotation_rad * swing,
        )

    def blur_px(self):
        """Longest path during an exposure."""
        return 2 * np.pi * self.frequency_hz * self.amplitude_px * self.exposure_s

    def truth_at_px(self, time_s):
        return true_centres_px(self.scene, self.camera, np.array([time_s]))[0]

    def images(self):
        return list(render_frames(self.scene, self.camera, self.time_s, np.random.default_rng(self.seed)))

    def truth_px(self):
        """Mean position during each exposure."""
        nodes, weights = np.polynomial.legendre.leggauss(5 if self.exposure_s else 1)
        return sum(
            0.5 * w * true_centres_px(self.scene, self.camera, self.time_s + 0.5 * self.exposure_s * t)
            for t, w in zip(nodes, weights, strict=True)
        )

    def write(self, path, codec="ffv1", **options):
        write_video(path, iter(self.images()), fps_container=Fraction(50), codec=codec, **options)
        return path


def errors_px(tracks, truth_px):
    """Errors (n, m) in x and y about each marker's mean error, matched to the nearest true marker."""
    ex, ey = [], []
    for k in range(len(tracks.markers)):
        first = np.flatnonzero(np.isfinite(tracks.x_px[:, k]))[0]
        gap = np.hypot(
            truth_px[first, :, 0] - tracks.x_px[first, k], truth_px[first, :, 1] - tracks.y_px[first, k]
        )
        j = int(np.argmin(gap))
        ex.append(tracks.x_px[:, k] - truth_px[:, j, 0])
        ey.append(tracks.y_px[:, k] - truth_px[:, j, 1])
    ex, ey = np.array(ex).T, np.array(ey).T
    return ex - np.nanmean(ex, axis=0), ey - np.nanmean(ey, axis=0)


def cramer_rao_px(recording, marker, *, with_angle, time_s=0.0):
    """Smallest possible sd of x and y of a marker at one time, from derivatives of the rendered image.

    Gain, offset and, for ArUco codes, the angle are unknown too. The noise is that of the camera and of rounding.
    The motion during the exposure is known.
    """
    size = 20.0 + (12.0 if recording.kind == "aruco" else 0.0) + 0.5 * recording.blur_px()
    x, y = recording.truth_at_px(time_s)[marker]
    window = np.s_[max(int(y - size), 0) : int(y + size) + 1, max(int(x - size), 0) : int(x + size) + 1]

    # No other marker reaches into the window.
    own = slice(marker, marker + 1)

    def image(dx=0.0, dy=0.0, angle=0.0):
        def moved(times_s):
            poses = recording.motion(times_s)
            return Poses(poses.x_mm[:, own] + dx, poses.y_mm[:, own] - dy, poses.angle_rad[:, own] + angle)

        scene = Scene(markers=recording.scene.markers[own], motion=moved)
        return next(iter(render_ideal(scene, recording.camera, np.array([time_s]))))[window]

    h = 0.01
    middle = image()
    slopes = [(image(dx=h) - image(dx=-h)) / (2 * h), (image(dy=h) - image(dy=-h)) / (2 * h)]
    slopes += [middle, np.ones_like(middle)]
    if with_angle:
        slopes.append((image(angle=1e-3) - image(angle=-1e-3)) / 2e-3)
    camera = recording.camera
    variance = camera.read_noise_sd**2 + camera.noise_gain * middle + 1.0 / 12.0
    jacobian = np.array([s.ravel() for s in slopes])
    covariance = np.linalg.inv((jacobian / variance.ravel()) @ jacobian.T)
    return np.sqrt(covariance[0, 0]), np.sqrt(covariance[1, 1])

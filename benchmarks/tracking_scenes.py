"""Scenes of the tracking benchmark, their Cramer-Rao bounds, and error measures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

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
)
from tracker import FloatArray, GrayImage

FPS = Fraction(1000)
WIDTH_PX, HEIGHT_PX, COLUMNS, MARKERS = 640, 480, 5, 10

KINDS = {"aruco": "aruco", "dots": "blob"}
# Motion of 3 px at 11 Hz; the blurred scene moves 10 px during an exposure of 0.9 of the frame interval.
SCENES: dict[str, dict[str, Any]] = {
    "still exposure": {},
    "noise 8": {"read_noise": 8.0},
    "10 px blur": {"amplitude_px": 40.0, "frequency_hz": 44.2, "exposure_s": 0.0009, "rotation_rad": 0.02},
}
FILES: dict[str, tuple[str, str, dict[str, int]]] = {
    "lossless": ("ffv1", "mkv", {}),
    "MJPG scale 2": ("mjpeg", "avi", {"quality": 2}),
    "MJPG scale 5": ("mjpeg", "avi", {"quality": 5}),
    "H.264 crf 18": ("libx264", "mp4", {"crf": 18}),
}


@dataclass(frozen=True)
class Recording:
    """Ten markers in two rows, each oscillating with a different phase: dots of 12 px or ArUco codes of 24 px.

    Attributes
    ----------
    kind : str
        "blob" or "aruco".
    frames : int
    read_noise : float
        Standard deviation in counts.
    amplitude_px, frequency_hz, rotation_rad : float
        Of the horizontal motion and of the rotation.
    exposure_s : float
    """

    kind: str
    frames: int
    read_noise: float = 1.5
    amplitude_px: float = 3.0
    frequency_hz: float = 11.3
    rotation_rad: float = 0.02
    exposure_s: float = 0.0

    @property
    def camera(self) -> Camera:
        """A camera with 1 px per mm and shot noise."""
        return Camera(
            width_px=WIDTH_PX,
            height_px=HEIGHT_PX,
            mm_per_px=1.0,
            origin_px=(0.0, 0.0),
            read_noise_sd=self.read_noise,
            noise_gain=0.05,
            exposure_s=self.exposure_s,
        )

    @property
    def markers(self) -> Sequence[DotMarker | ArucoMarker]:
        """Markers in the order of their positions."""
        if self.kind == "blob":
            return [DotMarker(diameter_mm=12.0)] * MARKERS
        return [
            ArucoMarker(dictionary="DICT_4X4_50", marker_id=k, size_mm=24.0, quiet_zone_mm=4.0)
            for k in range(MARKERS)
        ]

    @property
    def scene(self) -> Scene:
        """Scene of the moving markers."""
        return Scene(markers=tuple(self.markers), motion=self.motion)

    @property
    def time_s(self) -> FloatArray:
        """Times of the frames."""
        return np.arange(self.frames) / float(FPS)

    def motion(self, time_s: FloatArray) -> Poses:
        """Position and rotation of each marker; the mean positions cover the subpixel range."""
        index, rows = np.arange(MARKERS), MARKERS // COLUMNS
        x = WIDTH_PX * (index % COLUMNS + 0.5) / COLUMNS + 0.37 * index % 1
        y = HEIGHT_PX * (index // COLUMNS + 0.5) / rows + 0.61 * index % 1
        t = np.asarray(time_s)[:, None]
        dx = np.sin(2 * np.pi * self.frequency_hz * t + 0.3 * index)
        dy = np.cos(2 * np.pi * 0.68 * self.frequency_hz * t)
        return Poses(x + self.amplitude_px * dx, -y + 0.3 * self.amplitude_px * dy, self.rotation_rad * dx)

    def images(self) -> list[GrayImage]:
        """Frames with noise, identical on every call."""
        return list(render_frames(self.scene, self.camera, self.time_s, np.random.default_rng(1)))

    def truth_px(self) -> FloatArray:
        """Mean position of each marker during each exposure, shape (frames, markers, 2)."""
        nodes, weights = np.polynomial.legendre.leggauss(5 if self.exposure_s else 1)
        half = 0.5 * self.exposure_s
        parts = [
            0.5 * w * true_centres_px(self.scene, self.camera, self.time_s + half * t)
            for t, w in zip(nodes, weights, strict=True)
        ]
        return np.asarray(np.sum(parts, axis=0))

    def bound_px(self) -> float:
        """Root mean square of the Cramer-Rao bounds of x and y over markers and, with motion blur, over times."""
        times = np.linspace(0.0, 1.0 / self.frequency_hz, 6)[:-1] if self.exposure_s else [0.0]
        bounds = [self._marker_bound_px(k, float(t)) for k in range(0, MARKERS, 3) for t in times]
        return float(np.sqrt(np.mean(np.square(bounds))))

    def _marker_bound_px(self, marker: int, time_s: float) -> FloatArray:
        """Bounds of x and y of one marker from the derivatives of the rendered image.

        Gain, offset and, for ArUco codes, the angle are also unknown; the motion during the exposure is known.
        """
        centre = true_centres_px(self.scene, self.camera, np.array([time_s]))[0][marker]
        half = 20 if self.kind == "blob" else 32
        half += int(np.pi * self.frequency_hz * self.amplitude_px * self.exposure_s)
        left, top = (max(int(c) - half, 0) for c in centre)
        window = np.s_[top : int(centre[1]) + half + 1, left : int(centre[0]) + half + 1]

        def image(dx: float = 0.0, dy: float = 0.0, angle: float = 0.0) -> FloatArray:
            def moved(times_s: FloatArray) -> Poses:
                poses = self.motion(times_s)
                return Poses(poses.x_mm + dx, poses.y_mm - dy, poses.angle_rad + angle)

            scene = Scene(markers=self.scene.markers, motion=moved)
            return next(iter(render_ideal(scene, self.camera, np.array([time_s]))))[window]

        middle, h = image(), 0.01
        slopes = [(image(dx=h) - image(dx=-h)) / (2 * h), (image(dy=h) - image(dy=-h)) / (2 * h)]
        slopes += [middle, np.ones_like(middle)]
        if self.kind == "aruco":
            slopes.append((image(angle=1e-3) - image(angle=-1e-3)) / 2e-3)
        variance = self.camera.read_noise_sd**2 + self.camera.noise_gain * middle + 1.0 / 12.0
        jacobian = np.array([s.ravel() for s in slopes])
        covariance = np.linalg.inv((jacobian / variance.ravel()) @ jacobian.T)
        return np.asarray(np.sqrt(np.diag(covariance)[:2]))


def recording_of(kind: str, scene: str, frames: int) -> Recording:
    """Recording of a scene with one kind of marker."""
    return Recording(KINDS[kind], frames, **SCENES[scene])


@dataclass(frozen=True)
class Accuracy:
    """Errors of a tool's positions relative to the true positions.

    Attributes
    ----------
    rms_px, rms_over_bound : float
        Error minus each marker's mean error; `rms_over_bound` is relative to the bound of the lossless recording.
    error_over_sd : float
        Root mean square of the error over the reported standard deviation; NaN for tools that report none.
    amplitude_bias : float
        Slope of the error versus the motion.
    locking_px : float
        Amplitude of the first harmonic of the error in the subpixel position, minus that of noise alone.
    missing : float
        Fraction of missing positions.
    """

    rms_px: float
    rms_over_bound: float
    error_over_sd: float
    amplitude_bias: float
    locking_px: float
    missing: float


def accuracy(
    xy_px: FloatArray, truth_px: FloatArray, bound: float, sd_px: FloatArray | None = None
) -> Accuracy:
    """Error measures of positions (n, m, 2), matched to the nearest true marker; NaN where missing."""
    errors, truths = [], []
    for k in range(xy_px.shape[1]):
        detected = np.flatnonzero(np.all(np.isfinite(xy_px[:, k]), axis=1))
        if detected.size == 0:
            continue
        gap = np.linalg.norm(truth_px[detected[0]] - xy_px[detected[0], k], axis=1)
        truth = truth_px[:, int(np.argmin(gap))]
        error = xy_px[:, k] - truth
        errors.append(error - np.nanmean(error, axis=0))
        truths.append(truth)
    if not errors:
        return Accuracy(*[float("nan")] * 5, 1.0)
    error, truth = np.stack(errors, axis=1), np.stack(truths, axis=1)
    ok = np.isfinite(error)
    motion = truth - truth.mean(axis=0)
    phase = 2 * np.pi * truth[ok]
    first = 2 * np.abs(np.mean(error[ok] * np.exp(1j * phase)))
    rms = float(np.sqrt(np.mean(error[ok] ** 2)))
    of_noise = rms * np.sqrt(np.pi / np.count_nonzero(ok))
    return Accuracy(
        rms_px=rms,
        rms_over_bound=rms / bound,
        error_over_sd=float("nan") if sd_px is None else float(np.sqrt(np.nanmean((error / sd_px) ** 2))),
        amplitude_bias=float(np.sum(motion[ok] * error[ok]) / np.sum(motion[ok] ** 2)),
        locking_px=float(max(first - of_noise, 0.0)),
        missing=1.0 - np.count_nonzero(np.all(ok, axis=2)) / (truth_px.shape[0] * truth_px.shape[1]),
    )

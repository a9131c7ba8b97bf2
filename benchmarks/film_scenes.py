"""Films of one decaying marker, rendered from a drawing in high resolution; nothing is shared with the tracker.

The drawing (a disc, an ArUco code of OpenCV, or a texture) is sampled at 8 points per px, blurred by the lens and by
the area of a pixel, and interpolated at the pixels of each frame. The marker's position within the pixel, its rotation,
the direction of the motion, frequency, damping ratio and phase are random in each film.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy import ndimage

from sim.render import write_video
from tracker import FloatArray, GrayImage, TrackerSettings

FPS = 500.0
FREQUENCY_HZ, DAMPING_RATIO = 23.7, 0.004
SIZES_PX = {"aruco": 24.0, "dots": 9.0, "patch": 31.0}
CODECS: dict[str, tuple[str, str, dict[str, int]]] = {
    "lossless": ("ffv1", "mkv", {}),
    "MJPG": ("mjpeg", "avi", {"quality": 3}),
    "H.264": ("libx264", "mp4", {"crf": 18}),
}
_POINTS_PER_PX = 8
_LENS_BLUR_PX = 0.6
_READ_NOISE, _NOISE_GAIN = 1.5, 0.05
_WIDTH_PX, _HEIGHT_PX = 72, 64
_DARK, _LIGHT = 40.0, 200.0
# Texture of a patch: correlation length, and how far it extends beyond the tracked window.
_GRAIN_PX, _RIM_PX = 1.1, 8.0
_CELLS = 6


@dataclass(frozen=True)
class Film:
    """One film: kind of marker, codec, largest displacement in px, number of frames, and seed of its random values."""

    kind: str
    codec: str
    amplitude_px: float
    frames: int
    seed: int

    def truth(self) -> Truth:
        """True values, random with the seed."""
        rng = self._generator(0)
        time_s = np.arange(self.frames) / FPS
        frequency = FREQUENCY_HZ * rng.uniform(0.97, 1.03)
        zeta = DAMPING_RATIO * rng.uniform(0.8, 1.2)
        pole = 2.0 * np.pi * frequency * complex(-zeta, np.sqrt(1.0 - zeta**2))
        way = self.amplitude_px * np.exp(pole * time_s + 2j * np.pi * rng.uniform()).real
        angle = rng.uniform(-0.1, 0.1)
        rest = np.array([self.width_px / 2, _HEIGHT_PX / 2]) + rng.uniform(-0.5, 0.5, 2)
        xy_px = rest[:, None] + way * np.array([[np.cos(angle)], [np.sin(angle)]])
        return Truth(frequency, zeta, xy_px, rest, rng.uniform(-0.06, 0.06))

    @property
    def width_px(self) -> int:
        """Even, with room for the motion."""
        return _WIDTH_PX + 2 * int(np.ceil(self.amplitude_px))

    def images(self) -> Iterator[GrayImage]:
        """All frames, with read and shot noise."""
        truth, noise = self.truth(), self._generator(1)
        coefs = ndimage.spline_filter(self._drawing(truth), order=3)
        middle = 0.5 * (np.array(coefs.shape) - 1.0)
        rows, columns = np.mgrid[:_HEIGHT_PX, : self.width_px].astype(float)
        for x, y in truth.xy_px.T:
            at = [middle[0] + _POINTS_PER_PX * (rows - y), middle[1] + _POINTS_PER_PX * (columns - x)]
            image = ndimage.map_coordinates(coefs, at, order=3, mode="nearest", prefilter=False)
            spread = np.sqrt(_READ_NOISE**2 + _NOISE_GAIN * np.maximum(image, 0.0))
            noisy = image + spread * noise.standard_normal(image.shape)
            yield np.clip(np.rint(noisy), 0, 255).astype(np.uint8)

    def write(self, folder: Path) -> Path:
        """Encode the film into a file of this folder."""
        codec, suffix, options = CODECS[self.codec]
        path = folder / f"film.{suffix}"
        chosen: dict[str, Any] = dict(options)
        write_video(path, self.images(), fps_container=Fraction(25), codec=codec, **chosen)  # type: ignore[arg-type]  # CODECS holds names of Codec
        return path

    def settings(self) -> TrackerSettings:
        """Settings with which a user would track the film."""
        if self.kind != "patch":
            return TrackerSettings(fps=FPS, kind={"aruco": "aruco", "dots": "blob"}[self.kind])
        x, y = np.rint(self.truth().xy_px[:, 0])
        return TrackerSettings(
            fps=FPS, kind="patch", points_px=((float(x), float(y)),), size_px=SIZES_PX["patch"]
        )

    def _generator(self, stream: int) -> np.random.Generator:
        kind, codec = sorted(SIZES_PX).index(self.kind), sorted(CODECS).index(self.codec)
        tenths = round(10.0 * self.amplitude_px)
        return np.random.default_rng([self.seed, kind, codec, tenths, self.frames, stream])

    def _drawing(self, truth: Truth) -> FloatArray:
        """The marker at rest in the middle of a picture wide enough for the motion, with all blur."""
        half = 0.5 * self.width_px + self.amplitude_px + 4.0
        axis = np.arange(-round(half * _POINTS_PER_PX), round(half * _POINTS_PER_PX) + 1) / _POINTS_PER_PX
        x, y = np.meshgrid(axis, axis)
        cosine, sine = np.cos(truth.rotation_rad), np.sin(truth.rotation_rad)
        u, v = cosine * x + sine * y, cosine * y - sine * x
        picture = self._shape(u, v)
        box = np.ones(_POINTS_PER_PX + 1)
        box[[0, -1]] = 0.5
        for direction in (0, 1):
            picture = ndimage.gaussian_filter1d(picture, _LENS_BLUR_PX * _POINTS_PER_PX, axis=direction)
            picture = ndimage.convolve1d(picture, box / box.sum(), axis=direction)
        return np.asarray(picture)

    def _shape(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Brightness of the marker in its own axes, in px."""
        rng, size = self._generator(2), SIZES_PX[self.kind]
        if self.kind == "dots":
            inside = np.clip((0.5 * size - np.hypot(u, v)) * _POINTS_PER_PX + 0.5, 0.0, 1.0)
            return np.asarray(_LIGHT + (_DARK - _LIGHT) * inside)
        if self.kind == "patch":
            grain = ndimage.gaussian_filter(rng.standard_normal(u.shape), _GRAIN_PX * _POINTS_PER_PX)
            texture = np.clip(120.0 + 45.0 * grain / grain.std(), 20.0, 230.0)
            edge = np.maximum(np.abs(u), np.abs(v)) <= 0.5 * size + _RIM_PX
            return np.where(edge, texture, 120.0)
        dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
        code = cv2.aruco.generateImageMarker(dictionary, int(rng.integers(20)), _CELLS) > 127
        brightness = np.zeros(u.shape)
        # The mean of 16 points around each: edges of cells fall between the points of the drawing.
        steps = (np.arange(4) - 1.5) / (4 * _POINTS_PER_PX)
        for du in steps:
            for dv in steps:
                column = np.floor((u + du) / size * _CELLS + 0.5 * _CELLS).astype(np.int64)
                row = np.floor((v + dv) / size * _CELLS + 0.5 * _CELLS).astype(np.int64)
                inside = (np.minimum(row, column) >= 0) & (np.maximum(row, column) < _CELLS)
                light = code[np.clip(row, 0, _CELLS - 1), np.clip(column, 0, _CELLS - 1)] | ~inside
                brightness += np.where(light, _LIGHT, _DARK) / 16.0
        return brightness


@dataclass(frozen=True)
class Truth:
    """True values of a film: positions in px, shape (2, n), the position at rest, and the marker's rotation."""

    frequency_hz: float
    damping_ratio: float
    xy_px: FloatArray
    rest_px: FloatArray
    rotation_rad: float

"""The modelled camera, and the positions and angles of the points that it films."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from scipy.interpolate import CubicSpline

from tracker import FloatArray, checked


@dataclass(frozen=True)
class Tuning:
    """Limits of the model."""

    #: [px] lens blur below which a camera is refused
    #: convention: A pixel then takes 16 x 16 points (`order_for`); below, more. Real lenses blur more.
    least_lens_blur_px: float = 0.1


TUNING = Tuning()


@dataclass(frozen=True, kw_only=True)
class Camera:
    """An orthographic camera facing the plane of motion.

    Attributes
    ----------
    origin_px : tuple of float
        (x, y) in px of the world's origin, the clamp.
    exposure_s : float
        0 is an instant.
    lens_blur_px : float
        Standard deviation of the Gaussian point spread function, at least 0.1 px.
    read_noise_sd, noise_gain : float
        In counts, and in counts per electron: the variance of a pixel of mean I counts is
        ``read_noise_sd^2 + noise_gain I``.
    bit_depth : int
        8 to 16; counts run from 0 to ``2^bit_depth - 1``.
    background : float
        Counts outside the markers and the beam.
    flicker_sd : float
        Relative standard deviation of the brightness from frame to frame (white).
    light_gradient : tuple of float
        Relative change of the light from left to right and from top to bottom, 1 in the middle. The sum of the
        magnitudes is below 2, so that the light is positive everywhere.
    vignetting : float
        Relative loss of light in the corners, 0 to below 1, proportional to the square of the distance from the middle.

    Raises
    ------
    ValueError
        If a value is not finite or outside its range.
    """

    width_px: int
    height_px: int
    mm_per_px: float
    origin_px: tuple[float, float]
    exposure_s: float = 0.0
    lens_blur_px: float = 0.6
    read_noise_sd: float = 0.0
    noise_gain: float = 0.0
    bit_depth: int = 8
    background: float = 200.0
    flicker_sd: float = 0.0
    light_gradient: tuple[float, float] = (0.0, 0.0)
    vignetting: float = 0.0

    def __post_init__(self) -> None:
        if self.width_px < 1 or self.height_px < 1:
            msg = f"a frame needs at least 1 x 1 px, got {self.width_px} x {self.height_px}"
            raise ValueError(msg)
        if not 8 <= self.bit_depth <= 16:
            msg = f"bit_depth must be 8 to 16, got {self.bit_depth}"
            raise ValueError(msg)
        if not np.all(np.isfinite(self.origin_px)):
            msg = f"origin_px must be finite, got {self.origin_px}"
            raise ValueError(msg)
        for name in ("exposure_s", "read_noise_sd", "noise_gain", "background", "flicker_sd", "vignetting"):
            checked(name, getattr(self, name), at_least=0.0)
        checked("lens_blur_px", self.lens_blur_px, at_least=TUNING.least_lens_blur_px)
        checked("mm_per_px", self.mm_per_px, positive=True)
        if self.vignetting >= 1.0:
            msg = f"vignetting must be below 1, got {self.vignetting}"
            raise ValueError(msg)
        if not np.sum(np.abs(self.light_gradient)) < 2.0:
            msg = (
                f"light_gradient must leave light in every corner (|x| + |y| < 2), got {self.light_gradient}"
            )
            raise ValueError(msg)

    @property
    def max_count(self) -> int:
        """Largest value of a pixel."""
        return (1 << self.bit_depth) - 1

    @property
    def dtype(self) -> type[np.uint8] | type[np.uint16]:
        """Type of the frames: uint8 for 8 bit, uint16 above."""
        return np.uint8 if self.bit_depth == 8 else np.uint16

    def light(self) -> FloatArray:
        """Relative brightness of the light at each pixel, shape (height_px, width_px); 1 in the middle."""
        x = (np.arange(self.width_px) - 0.5 * (self.width_px - 1)) / self.width_px
        y = (np.arange(self.height_px)[:, None] - 0.5 * (self.height_px - 1)) / self.height_px
        even = 1.0 + self.light_gradient[0] * x + self.light_gradient[1] * y
        corner = self.width_px**2 + self.height_px**2
        towards = 4.0 * ((x * self.width_px) ** 2 + (y * self.height_px) ** 2) / corner
        return np.asarray(even * (1.0 - self.vignetting * towards))

    def to_px(self, x_mm: FloatArray, y_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Pixel coordinates of points in the world; NaN stays NaN."""
        x_px = self.origin_px[0] + np.asarray(x_mm, dtype=np.float64) / self.mm_per_px
        y_px = self.origin_px[1] - np.asarray(y_mm, dtype=np.float64) / self.mm_per_px
        return x_px, y_px

    def to_mm(self, x_px: FloatArray, y_px: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points in the world at pixel coordinates: the inverse of `to_px`."""
        return (x_px - self.origin_px[0]) * self.mm_per_px, (self.origin_px[1] - y_px) * self.mm_per_px


@dataclass(frozen=True)
class Poses:
    """Positions (x right, y up) and angles (counter-clockwise as seen; 0 is upright), shape (times, points)."""

    x_mm: FloatArray
    y_mm: FloatArray
    angle_rad: FloatArray

    def __post_init__(self) -> None:
        if self.x_mm.ndim != 2 or not self.x_mm.shape == self.y_mm.shape == self.angle_rad.shape:
            msg = (
                "x_mm, y_mm and angle_rad need one common shape (times, points), got "
                f"{self.x_mm.shape}, {self.y_mm.shape}, {self.angle_rad.shape}"
            )
            raise ValueError(msg)

    def at(self, rows: slice) -> Poses:
        """Poses at some of the times."""
        return Poses(self.x_mm[rows], self.y_mm[rows], self.angle_rad[rows])


class Motion(Protocol):
    """A callable that gives the poses of its points at any times."""

    def __call__(self, time_s: FloatArray) -> Poses:
        """Poses at `time_s`, shape (k,)."""
        ...


@dataclass(frozen=True)
class SampledMotion:
    """Dense samples of a motion, shape (n, m), at increasing times, interpolated by cubic splines.

    The error is about ``(omega h)^4 / 384`` of the amplitude: 20 samples per cycle give 1e-5.

    Raises
    ------
    ValueError
        If shapes do not match, values are not finite or times not increasing; or, in a call, if a time lies outside the
        samples: nothing is extrapolated.
    """

    time_s: FloatArray
    x_mm: FloatArray
    y_mm: FloatArray
    angle_rad: FloatArray
    _spline: CubicSpline = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        samples = np.stack([self.x_mm, self.y_mm, self.angle_rad], axis=-1)
        if samples.ndim != 3 or self.time_s.shape != samples.shape[:1]:
            msg = f"samples need shape (times, points) for times {self.time_s.shape}, got {self.x_mm.shape}"
            raise ValueError(msg)
        if not (np.all(np.isfinite(samples)) and np.all(np.diff(self.time_s) > 0.0)):
            msg = "samples of a motion must be finite, at increasing times"
            raise ValueError(msg)
        object.__setattr__(self, "_spline", CubicSpline(self.time_s, samples, axis=0))

    def __call__(self, time_s: FloatArray) -> Poses:
        """Poses at `time_s`, shape (k,)."""
        outside = (time_s < self.time_s[0]) | (time_s > self.time_s[-1])
        if np.any(outside):
            msg = (
                f"the motion is sampled from {self.time_s[0]:g} to {self.time_s[-1]:g} s, but is needed at "
                f"{time_s[outside][0]:g} s; include half the exposure before the first and after the last frame"
            )
            raise ValueError(msg)
        values = self._spline(time_s)
        return Poses(values[..., 0], values[..., 1], values[..., 2])

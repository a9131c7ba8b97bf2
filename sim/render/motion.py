"""Positions and angles of points at any time."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from scipy.interpolate import CubicSpline

from tracker import FloatArray


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

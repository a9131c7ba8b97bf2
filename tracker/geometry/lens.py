"""Lens distortion: from image pixels to the pixels of an ideal pinhole camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tracker.arrays import FloatArray
from tracker.checks import checked


@dataclass(frozen=True)
class Tuning:
    """Inversion of the distortion."""

    #: [steps] of the inversion of the distortion, at most
    #: convention: without convergence the result is NaN
    iterations: int = 100
    #: [1] last step, in units of the focal length
    #: convention: far below a millionth of a pixel
    converged: float = 1e-12
    #: [px] half the step of the central differences of the distortion
    #: convention: distortion changes over hundreds of px
    step_px: float = 0.25


TUNING = Tuning()


@dataclass(frozen=True)
class Lens:
    """Model of Brown and Conrady in the form of OpenCV; pixel centres at integers.

    Size of the calibration images, focal length and principal point (x and y), the coefficients k1, k2, p1, p2, k3, and
    the rms reprojection error of the calibration, NaN where unknown.

    Raises
    ------
    ValueError
        If a number is not finite, the focal length not positive, or there are not five coefficients.

    References
    ----------
    Brown, D. C. (1966). Decentering distortion of lenses. Photogrammetric Engineering 32, 444-462.
    """

    width_px: int
    height_px: int
    focal_px: tuple[float, float]
    centre_px: tuple[float, float]
    distortion: tuple[float, ...]
    rms_px: float = float("nan")

    def __post_init__(self) -> None:
        if len(self.distortion) != 5:
            msg = f"distortion must be five finite numbers k1, k2, p1, p2, k3, got {self.distortion}"
            raise ValueError(msg)
        for number in self.distortion + self.centre_px:
            checked("distortion and centre of a lens", number)
        for number in (*self.focal_px, self.width_px, self.height_px):
            checked("focal length and image size of a lens", number, positive=True)


def undistort(lens: Lens, x_px: FloatArray, y_px: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Positions in the image of the same camera without distortion; NaN stays NaN, shapes are kept.

    The model is inverted by fixed-point iteration; where it does not converge, far outside the calibrated field, the
    result is NaN.
    """
    fx, fy = lens.focal_px
    cx, cy = lens.centre_px
    seen_x, seen_y = (x_px - cx) / fx, (y_px - cy) / fy
    x, y = seen_x, seen_y
    step = np.full(x.shape, np.inf)
    for _ in range(TUNING.iterations):
        radial, shift_x, shift_y = _distortion(lens, x, y)
        with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
            new_x, new_y = (seen_x - shift_x) / radial, (seen_y - shift_y) / radial
            step = np.hypot(new_x - x, new_y - y)
        x, y = new_x, new_y
        if not np.any(step > TUNING.converged):
            break
    converged = step <= TUNING.converged
    return np.where(converged, cx + fx * x, np.nan), np.where(converged, cy + fy * y, np.nan)


def _distortion(lens: Lens, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Radial factor and tangential shift at positions in units of the focal length."""
    k1, k2, p1, p2, k3 = lens.distortion
    with np.errstate(invalid="ignore", over="ignore"):
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        shift_x = 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
        shift_y = p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    return radial, shift_x, shift_y


def undistortion_jacobian(lens: Lens, x_px: FloatArray, y_px: FloatArray) -> FloatArray:
    """Derivative of `undistort` at positions of shape (k,): array of shape (k, 2, 2), rows x and y."""
    columns = []
    for dx, dy in ((TUNING.step_px, 0.0), (0.0, TUNING.step_px)):
        ahead, behind = undistort(lens, x_px + dx, y_px + dy), undistort(lens, x_px - dx, y_px - dy)
        columns.append((np.stack(ahead, axis=-1) - np.stack(behind, axis=-1)) / (2.0 * TUNING.step_px))
    return np.stack(columns, axis=-1)

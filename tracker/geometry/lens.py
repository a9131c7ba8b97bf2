"""Lens distortion: from image pixels to those of an ideal pinhole camera; calibration by a ChArUco board."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tracker.arrays import FloatArray
from tracker.checks import Failure, checked


@dataclass(frozen=True)
class Tuning:
    """Inversion of the distortion, and which images calibrate a lens."""

    #: [steps] of the inversion of the distortion, at most
    #: convention: without convergence the result is NaN
    iterations: int = 100
    #: [1] last step, in units of the focal length
    #: convention: far below a millionth of a pixel
    converged: float = 1e-12
    #: [px] half the step of the central differences of the distortion
    #: convention: distortion changes over hundreds of px
    step_px: float = 0.25
    #: [images] without which no lens is calibrated
    #: convention: focal length, centre and distortion need several directions of the board
    least_images: int = 5
    #: [corners] of a view
    #: convention: fewer add no information beyond the view's own pose, six unknowns
    least_corners: int = 8
    #: [1] a view whose corners fit worse than this multiple of the median is left out
    #: convention: it is blurred or the board bent
    worst_ratio: float = 3.0


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


@dataclass(frozen=True)
class Board:
    """A ChArUco board: squares across and down, their side, the markers' side, and the dictionary."""

    squares_x: int
    squares_y: int
    square_mm: float
    marker_mm: float
    dictionary: str


@dataclass(frozen=True)
class LensCalibration:
    """A lens with the standard deviations of its parameters.

    ``sd`` has nine entries: the two focal lengths, the two coordinates of the centre, k1, k2, p1, p2 and k3 (0: it is
    not fitted). Images ``left_out`` show too little of the board or fit badly.
    """

    lens: Lens
    sd: tuple[float, ...]
    used: tuple[str, ...]
    left_out: tuple[str, ...]


def calibrate_lens(
    images: Iterable[tuple[str, NDArray[np.uint8]]], board: Board
) -> LensCalibration | Failure:
    """Focal length, centre and distortion (k1, k2, p1, p2) from named views of a flat board.

    Notes
    -----
    OpenCV's `calibrateCameraExtended` after Zhang (2000), doi:10.1109/34.888718; its standard deviations assume equal
    and independent errors of the corners. If all views are parallel to the sensor the focal length is undetermined: its
    sd is then large.
    """
    import cv2  # noqa: PLC0415 - slow to load, and settings hold a lens

    book = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    drawn = cv2.aruco.CharucoBoard((board.squares_x, board.squares_y), board.square_mm, board.marker_mm, book)
    detector = cv2.aruco.CharucoDetector(drawn)
    corners_mm = np.asarray(drawn.getChessboardCorners())
    names, left_out, objects, points = [], [], [], []
    size: tuple[int, int] | None = None
    for name, image in images:
        height, width = image.shape
        size = size or (width, height)
        if (width, height) != size:
            return Failure(
                f"{name} has {width} x {height} px, the others {size[0]} x {size[1]}: all images must be of one size"
            )
        corners, ids, _, _ = detector.detectBoard(image)
        if ids is None or len(ids) < TUNING.least_corners:
            left_out.append(name)
            continue
        names.append(name)
        objects.append(corners_mm[np.asarray(ids).ravel()].astype(np.float32))
        points.append(np.asarray(corners, dtype=np.float32).reshape(-1, 2))
    if size is None or len(names) < TUNING.least_images:
        return Failure(
            f"{len(names)} of {len(names) + len(left_out)} images show {TUNING.least_corners} or more "
            f"corners of a board of {board.squares_x} x {board.squares_y} squares of {board.dictionary}; "
            f"{TUNING.least_images} are needed. Check the numbers of squares and the dictionary"
        )
    lens, sd, view_rms_px = _fit(objects, points, size)
    good = view_rms_px <= TUNING.worst_ratio * float(np.median(view_rms_px))
    if not good.all() and np.count_nonzero(good) >= TUNING.least_images:
        left_out += [n for n, g in zip(names, good, strict=True) if not g]
        names, objects, points = (
            [item for item, g in zip(items, good, strict=True) if g] for items in (names, objects, points)
        )
        lens, sd, _ = _fit(objects, points, size)
    return LensCalibration(lens, sd, tuple(names), tuple(left_out))


def _fit(
    objects: list[Any], points: list[Any], size: tuple[int, int]
) -> tuple[Lens, tuple[float, ...], FloatArray]:
    """The lens, the sd of its parameters, and the rms error of each view in px."""
    import cv2  # noqa: PLC0415 - as above

    # Without wide-angle images k3 only absorbs noise of k1 and k2.
    rms, camera, distortion, _, _, sd, _, per_view = cv2.calibrateCameraExtended(
        objects, points, size, np.eye(3), np.zeros(5), flags=cv2.CALIB_FIX_K3
    )
    k = np.asarray(camera, dtype=np.float64)
    lens = Lens(
        width_px=size[0],
        height_px=size[1],
        focal_px=(float(k[0, 0]), float(k[1, 1])),
        centre_px=(float(k[0, 2]), float(k[1, 2])),
        distortion=tuple(float(d) for d in np.asarray(distortion).ravel()[:5]),
        rms_px=float(rms),
    )
    sds = tuple(float(s) for s in np.asarray(sd).ravel()[:9])
    return lens, sds, np.asarray(per_view, dtype=np.float64).ravel()

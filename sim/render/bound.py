"""The Cramer-Rao bound of a marker's position in one frame of a modelled camera."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sim.render.camera import Camera, Poses
from sim.render.frames import Scene, render_ideal
from sim.render.markers import ArucoMarker, Marker
from tracker import FloatArray


@dataclass(frozen=True)
class Tuning:
    """Finite differences."""

    #: [px] step of the central differences of a position
    #: physics: Their relative error is of the order of (step / lens blur)^2: 3e-4 at 0.6 px.
    step_px: float = 0.01
    #: [rad] step of the central differences of the angle
    #: physics: 0.05 px at the edge of a marker of 100 px.
    step_rad: float = 1e-3


TUNING = Tuning()
# positions within the pixel over which the bound is averaged
_PHASES = (0.0, 0.37, 0.61)
# of rounding to whole counts
_ROUNDING_VARIANCE = 1.0 / 12.0


def position_bound_px(
    marker: Marker, camera: Camera, path_px: FloatArray, direction_rad: float = 0.0
) -> FloatArray:
    """Smallest standard deviation of a marker's position along its motion, for several lengths of motion blur.

    Parameters
    ----------
    camera : Camera
        Its lens, noise, bit depth and background matter; its frame and exposure do not.
    path_px : array, shape (k,)
        Straight motion during the exposure.
    direction_rad : float
        Direction of the motion from the x axis; the bound is that of the position along it.

    Returns
    -------
    array, shape (k,)
        In px: root mean square over positions within a pixel.

    Notes
    -----
    From the Fisher information of the modelled pixels with normal noise of variance
    ``read_noise_sd^2 + noise_gain I + 1/12`` (Kay, Fundamentals of Statistical Signal Processing, 1993, 3.9; the
    dependence of the variance on position, of the order of gain / I, is neglected). Gain, offset and, for ArUco, the
    angle are unknown as well; the motion during the exposure is known. Clipped pixels are ignored.
    """
    return np.array(
        [np.sqrt(np.mean(_variances_px2(marker, camera, float(path), direction_rad))) for path in path_px]
    )


def _variances_px2(marker: Marker, camera: Camera, path_px: float, direction_rad: float) -> FloatArray:
    """Variance of the position along the motion at each position within a pixel."""
    along = np.array([np.cos(direction_rad), np.sin(direction_rad)])
    across = np.array([-along[1], along[0]])
    # (x, y, angle): at rest, then a step ahead and one behind for each unknown pose
    steps = [np.zeros(3)]
    for direction in (along, across):
        step = np.array([*(TUNING.step_px * direction), 0.0])
        steps += [step, -step]
    if isinstance(marker, ArucoMarker):
        step = np.array([0.0, 0.0, TUNING.step_rad])
        steps += [step, -step]
    positions = np.array([np.array([phase, -phase, 0.0]) + step for phase in _PHASES for step in steps])
    images = _images(marker, camera, positions, path_px * along)
    return np.array([_variance_px2(some, camera) for some in np.split(images, len(_PHASES))])


def _variance_px2(images: FloatArray, camera: Camera) -> float:
    """From the image at rest and pairs of images one step ahead and one behind for each unknown."""
    middle, ahead, behind = images[0], images[1::2], images[2::2]
    # only the step of the position matters: scaling another column does not change the result
    slopes = [*(ahead - behind) / (2.0 * TUNING.step_px), middle, np.ones_like(middle)]
    seen = (middle < camera.max_count) & (middle >= 0.0)
    jacobian = np.array([s[seen] for s in slopes])
    variance = camera.read_noise_sd**2 + camera.noise_gain * middle[seen] + _ROUNDING_VARIANCE
    return float(np.linalg.inv((jacobian / variance) @ jacobian.T)[0, 0])


def _images(marker: Marker, camera: Camera, positions: FloatArray, path_px: FloatArray) -> FloatArray:
    """Mean counts of the marker at `positions` (x px, y px, angle), each moving along `path_px` while exposed."""
    longest = float(np.hypot(*path_px))
    reach = int(np.ceil(marker.half_extent_mm / camera.mm_per_px * np.sqrt(2.0) + 0.5 * longest)) + 6
    side = 2 * reach + 1
    window = replace(
        camera,
        width_px=side,
        height_px=side,
        origin_px=(float(reach), float(reach)),
        exposure_s=1.0 if longest > 0.0 else 0.0,
        light_gradient=(0.0, 0.0),
        vignetting=0.0,
    )

    def poses(time_s: FloatArray) -> Poses:
        # one image every two seconds, exposed for one of them: the path is covered once
        which = np.rint(0.5 * np.asarray(time_s)).astype(int)
        covered = (time_s - 2.0 * which)[:, None] * path_px
        at = camera.mm_per_px * (positions[which, :2] + covered)
        return Poses(at[:, :1], -at[:, 1:], positions[which, 2:])

    scene = Scene(markers=(marker,), motion=poses)
    middles_s = np.arange(0.0, 2.0 * len(positions), 2.0)
    return np.array(list(render_ideal(scene, window, middles_s)))

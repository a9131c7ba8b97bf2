"""The Cramer-Rao bound of a print's position in one frame of a modelled camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim.render.camera import Camera
from sim.render.frames import render_ideal
from sim.render.markers import ArucoPrint, Print
from sim.render.motion import Poses
from sim.render.scene import Scene
from tracker.arrays import FloatArray

# Steps of the central differences: their error is of the order of the step over the lens blur, squared.
_STEP_PX = 0.01
_STEP_RAD = 1e-3
# Positions in the pixel over which the bound is averaged.
_PHASES = (0.0, 0.37, 0.61)
# The rounding to whole counts.
_ROUNDING_VARIANCE = 1.0 / 12.0


def position_bound_px(
    marker: Print, camera: Camera, path_px: FloatArray, direction_rad: float = 0.0
) -> FloatArray:
    """Smallest standard deviation of a print's position along its motion, for several lengths of motion blur.

    Parameters
    ----------
    marker : Print
    camera : Camera
        Its lens, noise, depth and background count; its frame and exposure do not.
    path_px : array, shape (k,)
        Straight motion during the exposure.
    direction_rad : float
        Of the motion, from the x axis; the bound is that of the position along it.

    Returns
    -------
    array, shape (k,)
        In px: root mean square over places within a pixel.

    Notes
    -----
    The Fisher information of the modelled picture's pixels with normal noise of variance
    ``read_noise_sd^2 + noise_gain I + 1/12`` (Kay, Fundamentals of Statistical Signal Processing, 1993, 3.9; the
    variance's own dependence on position, of the order of gain / I, is left out). Unknown beside the position are
    gain, offset and, for ArUco, the angle; the motion during the exposure is taken as known. Clipped pixels
    count as if they were not.
    """
    return np.array(
        [np.sqrt(np.mean(_variances_px2(marker, camera, float(path), direction_rad))) for path in path_px]
    )


def _variances_px2(marker: Print, camera: Camera, path_px: float, direction_rad: float) -> FloatArray:
    """Variance of the position along the motion at each place within a pixel."""
    along = np.array([np.cos(direction_rad), np.sin(direction_rad)])
    across = np.array([-along[1], along[0]])
    # (x, y, turn): at rest, then ahead and behind for each unknown that moves the picture.
    steps = [np.zeros(3)]
    for direction in (along, across):
        step = np.array([*(_STEP_PX * direction), 0.0])
        steps += [step, -step]
    if isinstance(marker, ArucoPrint):
        step = np.array([0.0, 0.0, _STEP_RAD])
        steps += [step, -step]
    places = np.array([np.array([phase, -phase, 0.0]) + step for phase in _PHASES for step in steps])
    pictures = _pictures(marker, camera, places, path_px * along)
    return np.array([_variance_px2(some, camera) for some in np.split(pictures, len(_PHASES))])


def _variance_px2(pictures: FloatArray, camera: Camera) -> float:
    """From the picture and those of one step ahead and behind for each unknown, in pairs."""
    middle, ahead, behind = pictures[0], pictures[1::2], pictures[2::2]
    # A factor of scale does not change what the others cannot imitate: only the position's step matters.
    slopes = [*(ahead - behind) / (2.0 * _STEP_PX), middle, np.ones_like(middle)]
    seen = (middle < camera.max_count) & (middle >= 0.0)
    jacobian = np.array([s[seen] for s in slopes])
    variance = camera.read_noise_sd**2 + camera.noise_gain * middle[seen] + _ROUNDING_VARIANCE
    return float(np.linalg.inv((jacobian / variance) @ jacobian.T)[0, 0])


def _pictures(marker: Print, camera: Camera, places: FloatArray, path_px: FloatArray) -> FloatArray:
    """Mean counts of the print at `places` (x px, y px, turn), each moving along `path_px` while exposed."""
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
        # One picture every two seconds, exposed for one of them: the path is walked once.
        which = np.rint(0.5 * np.asarray(time_s)).astype(int)
        walked = (time_s - 2.0 * which)[:, None] * path_px
        at = camera.mm_per_px * (places[which, :2] + walked)
        return Poses(at[:, :1], -at[:, 1:], places[which, 2:])

    scene = Scene(prints=(marker,), motion=poses)
    middles_s = np.arange(0.0, 2.0 * len(places), 2.0)
    return np.array(list(render_ideal(scene, window, middles_s)))

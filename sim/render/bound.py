"""The Cramer-Rao bound of a print's position in one frame of a modelled camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sim.render.camera import Camera
from sim.render.frames import render_ideal
from sim.render.motion import Poses
from sim.render.prints import ArucoPrint, Print
from sim.render.scene import Scene

FloatArray = NDArray[np.float64]

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
    out = np.empty(len(path_px))
    for k, path in enumerate(path_px):
        squares = [_variance_px2(marker, camera, float(path), direction_rad, phase) for phase in _PHASES]
        out[k] = np.sqrt(np.mean(squares))
    return out


def _variance_px2(
    marker: Print, camera: Camera, path_px: float, direction_rad: float, phase_px: float
) -> float:
    reach = int(np.ceil(marker.half_extent_mm / camera.mm_per_px * np.sqrt(2.0) + 0.5 * path_px)) + 6
    side = 2 * reach + 1
    along = np.array([np.cos(direction_rad), np.sin(direction_rad)])
    window = replace(
        camera,
        width_px=side,
        height_px=side,
        origin_px=(reach + phase_px, reach - phase_px),
        exposure_s=1.0 if path_px > 0.0 else 0.0,
        light_gradient=(0.0, 0.0),
        vignetting=0.0,
    )

    def picture(dx: float = 0.0, dy: float = 0.0, turn: float = 0.0) -> FloatArray:
        def poses(time_s: FloatArray) -> Poses:
            # The exposure lasts from -1/2 to 1/2: the path is walked once.
            t = np.asarray(time_s)[:, None]
            x_px, y_px = dx + path_px * along[0] * t, dy + path_px * along[1] * t
            return Poses(x_px * camera.mm_per_px, -y_px * camera.mm_per_px, np.full(t.shape, turn))

        scene = Scene(prints=(marker,), motion=poses)
        return next(iter(render_ideal(scene, window, np.zeros(1))))

    middle = picture()
    slopes = [
        (
            picture(dx=_STEP_PX * along[0], dy=_STEP_PX * along[1])
            - picture(-_STEP_PX * along[0], -_STEP_PX * along[1])
        )
        / (2.0 * _STEP_PX),
        (
            picture(-_STEP_PX * along[1], _STEP_PX * along[0])
            - picture(_STEP_PX * along[1], -_STEP_PX * along[0])
        )
        / (2.0 * _STEP_PX),
        middle,
        np.ones_like(middle),
    ]
    if isinstance(marker, ArucoPrint):
        slopes.append((picture(turn=_STEP_RAD) - picture(turn=-_STEP_RAD)) / (2.0 * _STEP_RAD))
    seen = (middle < camera.max_count) & (middle >= 0.0)
    jacobian = np.array([s[seen] for s in slopes])
    variance = camera.read_noise_sd**2 + camera.noise_gain * middle[seen] + _ROUNDING_VARIANCE
    return float(np.linalg.inv((jacobian / variance) @ jacobian.T)[0, 0])

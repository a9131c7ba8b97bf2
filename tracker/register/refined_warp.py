"""Shape in the image of a marker that rotates: the corners of one frame do not determine it well enough."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tracker.arrays import FloatArray, IntArray
from tracker.register import kernel
from tracker.register.calibration_frames import CalibrationFrames, registered
from tracker.register.marker import MarkerModel, register


@dataclass(frozen=True)
class Tuning:
    """When and how the shape of a rotating marker is fitted."""

    #: [rad] rotation over the calibration frames from which the shape is fitted
    #: convention: a template absorbs an error of the warp as long as the marker turns less
    least_rotation_rad: float = 0.1
    #: [rad] rotation during an exposure up to which the shape is fitted
    #: convention: no template includes rotation: with more, the shear would only hide the misfit
    largest_blur_rad: float = 0.03
    #: [frames] that are compared
    #: convention: limits time
    frames: int = 16
    #: [steps] Newton steps at most
    #: convention: limits time
    steps: int = 6
    #: [px] change at the marker's rim over which chi-square is differenced
    #: convention: well above the rounding of chi-square and below the blur
    difference_px: float = 0.1
    #: [px] change at the marker's rim that ends the search
    #: convention: far below the tenths of a px by which corners err
    short_px: float = 0.005
    #: [px] shift at which a fit with a trial shape fails
    farthest_px: float = 3.0


TUNING = Tuning()


def with_refined_warp(frames: CalibrationFrames, model: MarkerModel) -> MarkerModel:
    """The model with the warp that explains the marker at all its angles; unchanged where it does not rotate.

    The corners found in one frame err by some tenths of a px. In that frame the template absorbs the shear this causes;
    once the marker has turned, the shear is wrong. Aspect ratio and shear are fitted to frames of different angles.
    Size and rotation belong to the template and to the angle.
    """
    seen = np.flatnonzero(np.all(np.isfinite(model.states), axis=1))
    if np.ptp(model.states[seen, 2]) < TUNING.least_rotation_rad:
        return model
    turned = float(np.median(np.abs(np.diff(model.states[seen, 2])))) * frames.exposure_share
    if turned > TUNING.largest_blur_rad:
        return model
    chosen = seen[np.linspace(0, seen.size - 1, min(TUNING.frames, seen.size)).astype(np.int64)]
    half_px = 0.5 * model.detection.size_px
    step, shear = TUNING.difference_px / half_px, np.zeros(2)
    for _ in range(TUNING.steps):
        change = _newton_step(frames, model, chosen, shear, step)
        shear = shear + change
        if np.hypot(*change) * half_px < TUNING.short_px:
            break
    before, after = (_mean_chi2(frames, model, chosen, at) for at in (np.zeros(2), shear))
    if not after < before:
        return model
    refined = replace(model, warp=_sheared(model.warp, shear))
    return registered(frames, refined, model.states[chosen[0]], model.states) or model


def _sheared(warp: FloatArray, shear: FloatArray) -> FloatArray:
    """The warp with its aspect ratio and shear changed."""
    return np.asarray((np.eye(2) + np.array([[shear[0], shear[1]], [shear[1], -shear[0]]])) @ warp)


def _newton_step(
    frames: CalibrationFrames, model: MarkerModel, chosen: IntArray, at: FloatArray, step: float
) -> FloatArray:
    """Step to the minimum of the parabola through chi-square around `at`, of limited length; none without minimum."""
    ways = np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1], [1, 1], [-1, -1]])
    mid, right, left, up, down, both, neither = (
        _mean_chi2(frames, model, chosen, at + step * way) for way in ways
    )
    slope = np.array([right - left, up - down]) / 2.0
    across, along = right + left - 2.0 * mid, up + down - 2.0 * mid
    mixed = (both + neither - right - left - up - down + 2.0 * mid) / 2.0
    if not (across > 0.0 and along > 0.0 and across * along > mixed**2):
        return np.zeros(2)
    change = -np.linalg.solve(np.array([[across, mixed], [mixed, along]]), slope)
    return np.asarray(step * change * 3.0 / max(3.0, float(np.hypot(*change))))


def _mean_chi2(frames: CalibrationFrames, model: MarkerModel, chosen: IntArray, shear: FloatArray) -> float:
    """Mean chi-square of the chosen frames with a sheared warp; infinite where one is not fitted."""
    warp, total = _sheared(model.warp, shear), 0.0
    for k in chosen:
        result = register(
            frames.images[k],
            model.states[k],
            warp,
            model.template,
            frames.camera,
            with_angle=True,
            max_shift_px=TUNING.farthest_px,
        )
        total += float(result[kernel.CHI2]) if result[kernel.CONVERGED] > 0.0 else np.inf
    return total / len(chosen)

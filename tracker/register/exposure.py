"""How long the exposure was, told by the blur of markers in motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tracker.arrays import FloatArray, GrayImage
from tracker.register import kernel
from tracker.register.marker import Camera, MarkerModel, reach_px, register
from tracker.template.blur import SMALLEST_PX, Blurrer, exposed_path_px, path_length_px, seen_from_marker
from tracker.template.paths import path_derivatives_px
from tracker.template.spline import Template

# Share that is assumed while templates are learned from which it is then told.
FIRST_GUESS = 0.5
# Motion from frame to frame below which no exposure shows.
LEAST_MOTION_PX = 2.0 * SMALLEST_PX
FRAMES = 6
SHARES = np.linspace(0.0, 1.0, 11)
# A template that explains the pixels worse than this tells its own faults, not the exposure.
LARGEST_CHI2 = 5.0
# An exposure is believed when it is so many standard deviations from none.
LEAST_SDS = 4.0


@dataclass(frozen=True)
class ExposureShare:
    """Exposure time over the time between frames, and its standard deviation."""

    share: float
    sd: float


def largest_motion_px(models: tuple[MarkerModel, ...]) -> float:
    """Largest motion of any marker from frame to frame in the calibration frames."""
    steps = [np.linalg.norm(path_derivatives_px(m.states)[0], axis=1).max() for m in models]
    return float(max(steps, default=0.0))


def estimate_exposure(
    frames: list[GrayImage], models: tuple[MarkerModel, ...], camera: Camera
) -> ExposureShare | None:
    """Exposure that explains the blur of the fastest frames best.

    Parameters
    ----------
    frames : list of arrays, shape (height, width)
        Those of the calibration.
    models : tuple of MarkerModel
        Calibrated with a guess of the share, so that templates come from the sharpest frames.

    Returns
    -------
    ExposureShare or None
        None where nothing moves by a px between frames, or no template explains the pixels. Its sd is the larger of
        what chi-square, scaled to its minimum, and the scatter between markers tell.

    Notes
    -----
    Chi-square over the share, of the same pixels for all shares, is taken at eleven shares; the parabola through the
    three about the smallest gives each marker's estimate and its curvature, of which the median and the sum count.
    """
    shares, curvatures = [], []
    for model in models:
        told = _told_by(frames, model, camera)
        if told is not None:
            shares.append(told[0])
            curvatures.append(told[1])
    if not shares:
        return None
    middle = float(np.median(shares))
    scatter = 1.4826 * float(np.median(np.abs(np.array(shares) - middle))) / np.sqrt(len(shares))
    formal = np.sqrt(1.0 / np.sum(curvatures))
    return ExposureShare(min(max(middle, 0.0), 1.0), float(max(scatter, formal)))


def believed(estimate: ExposureShare, largest_motion: float) -> bool:
    """Whether the exposure is surely not none, and changes pictures."""
    return estimate.share > LEAST_SDS * estimate.sd and estimate.share * largest_motion >= SMALLEST_PX


def _told_by(frames: list[GrayImage], model: MarkerModel, camera: Camera) -> tuple[float, float] | None:
    """Share by one marker and the inverse of its variance."""
    motion, bend = path_derivatives_px(model.states)
    speed = np.where(np.all(np.isfinite(model.states), axis=1), np.linalg.norm(motion, axis=1), 0.0)
    speed[[0, -1]] = 0.0  # known from one side only
    fastest = np.argsort(speed)[::-1][:FRAMES]
    fastest = fastest[speed[fastest] >= LEAST_MOTION_PX]
    if fastest.size == 0:
        return None
    blurrer = Blurrer(model.template, model.known)
    total, pixels = np.zeros(SHARES.size), 0.0
    for k in fastest:
        chi2 = _chi2_over_share(frames[k], model, camera, blurrer, (model.states[k], motion[k], bend[k]))
        if np.all(np.isfinite(chi2)):
            total += chi2[:, 0]
            pixels += float(chi2[0, 1])
    if pixels == 0.0 or total.min() > LARGEST_CHI2 * pixels:
        return None
    best = min(max(int(np.argmin(total)), 1), SHARES.size - 2)
    low, mid, high = total[best - 1 : best + 2]
    step = SHARES[1] - SHARES[0]
    second = (high - 2.0 * mid + low) / step**2
    if second <= 0.0:
        return None
    share = SHARES[best] - (high - low) / (2.0 * step) / second
    return float(share), float(0.5 * second / max(total.min() / pixels, 1.0))


def _chi2_over_share(
    image: GrayImage,
    model: MarkerModel,
    camera: Camera,
    blurrer: Blurrer,
    seen: tuple[FloatArray, FloatArray, FloatArray],
) -> FloatArray:
    """Chi-square of a frame and its degrees of freedom for each share; shape (shares, 2)."""
    state, motion, bend = seen
    out = np.full((SHARES.size, 2), np.nan)
    longest = seen_from_marker(exposed_path_px(motion, bend, 1.0), model.warp, state[2])
    for n, share in enumerate(SHARES):
        path = seen_from_marker(exposed_path_px(motion, bend, float(share)), model.warp, state[2])
        template: Template = blurrer.get(path, support_of=longest)
        result = register(
            image,
            state,
            model.warp,
            template,
            camera,
            reach=reach_px(template, model.warp),
            with_angle=model.with_angle,
            max_shift_px=2.0 + path_length_px(longest),
        )
        if result[kernel.CONVERGED] == 0.0:
            return out
        freedom = result[kernel.PIXELS] - (5 if model.with_angle else 4)
        out[n] = result[kernel.CHI2] * freedom, freedom
    # Pixels at the rim come and go with the position: the same number for all.
    out[:, 0] *= out[0, 1] / out[:, 1]
    return out

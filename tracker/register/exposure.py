"""Exposure time, estimated from the motion blur of the markers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tracker.arrays import FloatArray, robust_sd
from tracker.register import kernel
from tracker.register.calibration_frames import CalibrationFrames
from tracker.register.marker import MarkerModel, register
from tracker.template import (
    Blurrer,
    exposed_path_px,
    is_blur,
    path_derivatives_px,
    path_length_px,
    seen_from_marker,
)


@dataclass(frozen=True)
class Tuning:
    """When the exposure is estimated from motion blur."""

    #: [frames] fastest frames of a marker from which it is estimated
    #: convention: limits time
    frames: int = 6
    #: [1] chi-square per degree of freedom above which a template's own errors dominate the estimate
    largest_chi2: float = 5.0
    #: [sd] an exposure is accepted when it differs from 0 by this much
    #: statistics: noise alone does so in one recording of 30 000
    least_sds: float = 4.0
    #: [px] distance, beside the longest path, at which a trial fit fails
    start_px: float = 2.0


TUNING = Tuning()

SHARES = np.linspace(0.0, 1.0, 11)


@dataclass(frozen=True)
class ExposureShare:
    """Exposure time over the time between frames, and its standard deviation."""

    share: float
    sd: float

    def is_significant(self, largest_motion_px: float) -> bool:
        """Whether the exposure is clearly not zero and long enough to blur markers that move this far."""
        return self.share > TUNING.least_sds * self.sd and is_blur(self.share * largest_motion_px)


def largest_motion_px(models: tuple[MarkerModel, ...]) -> float:
    """Largest motion of any marker from frame to frame in the calibration frames."""
    steps = [np.linalg.norm(path_derivatives_px(m.states)[0], axis=1).max() for m in models]
    return float(max(steps, default=0.0))


def estimate_exposure(frames: CalibrationFrames, models: tuple[MarkerModel, ...]) -> ExposureShare | None:
    """Exposure that best explains the blur of the fastest frames.

    The models are calibrated with a guess of the share, so that templates come from the sharpest frames. None where
    nothing moves by a px between frames, or no template explains the pixels. The sd is the larger of that from
    chi-square, scaled to its minimum, and that from the scatter between markers.

    Chi-square, of the same pixels for all shares, is evaluated at eleven shares; the parabola through the three
    smallest gives each marker's estimate and its curvature. The result is their median; the curvatures add up.
    """
    estimates = [e for model in models if (e := _from_marker(frames, model)) is not None]
    if not estimates:
        return None
    shares, curvatures = np.array(estimates).T
    middle = float(np.median(shares))
    scatter = robust_sd(shares - middle) / np.sqrt(len(shares))
    formal = np.sqrt(1.0 / np.sum(curvatures))
    return ExposureShare(min(max(middle, 0.0), 1.0), float(max(scatter, formal)))


def _from_marker(frames: CalibrationFrames, model: MarkerModel) -> tuple[float, float] | None:
    """Share estimated from one marker, and the inverse of its variance."""
    motion, bend = path_derivatives_px(model.states)
    speed = np.where(np.all(np.isfinite(model.states), axis=1), np.linalg.norm(motion, axis=1), 0.0)
    speed[[0, -1]] = 0.0  # only one neighbour
    # half of the motion is a blur that a template includes
    fastest = [k for k in np.argsort(speed)[::-1][: TUNING.frames] if is_blur(0.5 * speed[k])]
    if not fastest:
        return None
    blurrer = Blurrer(model.template, model.known)
    total, pixels = np.zeros(SHARES.size), 0.0
    for k in fastest:
        chi2 = _chi2_over_share(frames, int(k), model, blurrer, (motion[k], bend[k]))
        if np.all(np.isfinite(chi2)):
            total += chi2[:, 0]
            pixels += float(chi2[0, 1])
    if pixels == 0.0 or total.min() > TUNING.largest_chi2 * pixels:
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
    frames: CalibrationFrames,
    k: int,
    model: MarkerModel,
    blurrer: Blurrer,
    derivatives: tuple[FloatArray, FloatArray],
) -> FloatArray:
    """Chi-square of frame k and its degrees of freedom for each share; shape (shares, 2)."""
    state = model.states[k]
    out = np.full((SHARES.size, 2), np.nan)
    longest = seen_from_marker(exposed_path_px(*derivatives, 1.0), model.warp, state[2])
    for n, share in enumerate(SHARES):
        path = seen_from_marker(exposed_path_px(*derivatives, float(share)), model.warp, state[2])
        result = register(
            frames.images[k],
            state,
            model.warp,
            blurrer.get(path, support_of=longest),
            frames.camera,
            with_angle=model.with_angle,
            max_shift_px=TUNING.start_px + path_length_px(longest),
        )
        if result[kernel.CONVERGED] == 0.0:
            return out
        dof = result[kernel.PIXELS] - (5 if model.with_angle else 4)
        out[n] = result[kernel.CHI2] * dof, dof
    # Pixels at the rim enter and leave with the position: normalise to the same number for all.
    out[:, 0] *= out[0, 1] / out[:, 1]
    return out

"""Calibration of all markers of a recording, with the exposure time given or estimated from their motion blur."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tracker.arrays import FloatArray, GrayImage
from tracker.markers import Detection
from tracker.register.calibrate_marker import calibrate
from tracker.register.calibration_frames import CalibrationFrames
from tracker.register.exposure import LEAST_MOTION_PX, ExposureShare, estimate_exposure, largest_motion_px
from tracker.register.marker import Camera, MarkerModel
from tracker.register.moving_object import notes_on_patches, with_motion_sd
from tracker.register.refined_noise import refined_noise
from tracker.template import estimate_noise, sd_factors

# Share of the exposure assumed while learning the templates from which it is then estimated.
FIRST_GUESS = 0.5
# Once with the guess, once more with templates learned with the first estimate.
ESTIMATES = 2
# Markers from which it is estimated, the fastest ones: more hardly improve it and cost time.
EXPOSURE_MARKERS = 8
EXPOSURE_UNKNOWN = (
    "Markers move by more than a px between frames, and the exposure time is neither given as exposure_s nor evident "
    "from their motion blur: set exposure_s, or positions may be affected by the blur."
)


@dataclass(frozen=True)
class Calibration:
    """Result of the calibration on the first frames.

    ``exposure_share`` is the exposure time over the time between frames, 0 where unknown. ``sd_factors``, shape (2, m),
    are factors on the sd of x and y from the spatial correlation of compression errors; 1 for lossless footage.
    """

    models: tuple[MarkerModel, ...]
    camera: Camera
    exposure_share: float
    sd_factors: FloatArray
    notes: tuple[str, ...]


def calibrate_all(
    images: list[GrayImage],
    detections: tuple[Detection, ...],
    camera: Camera,
    *,
    exposure_share: float | None,
    lossy: bool,
) -> Calibration:
    """Calibrate all markers on consecutive first frames of a recording.

    Without an `exposure_share` it is estimated from the motion blur, where markers move far enough. Residuals of
    `lossy` footage hold compression errors besides the camera's noise.
    """
    frames = CalibrationFrames(images, camera, exposure_share or 0.0)
    models, notes = _calibrate_each(frames, detections)
    if exposure_share is None and largest_motion_px(models) >= LEAST_MOTION_PX:
        frames, models, notes = _with_estimated_exposure(frames, detections, models, notes)
    share = frames.exposure_share
    models = tuple(m if m.detection.kind.has_outline else with_motion_sd(frames, m) for m in models)
    factors = np.ones((2, len(models)))
    if lossy:
        pairs = [sd_factors(images, m.states, m.template, m.warp) for m in models]
        factors = np.array(pairs).reshape(-1, 2).T
    else:
        camera = replace(camera, noise=refined_noise(images, models, camera.noise, share))
    return Calibration(models, camera, share, factors, (*notes, *notes_on_patches(models)))


def initial_camera(images: list[GrayImage], *, bit_depth: int, white_level: int) -> Camera:
    """Noise from the images; saturation from their bit depth, or from the largest value where many pixels have it."""
    brightest = max(int(image.max()) for image in images[:4])
    saturation = float(white_level)
    if bit_depth > 8:
        # A 12-bit camera in a 16-bit file saturates at its own white: many pixels at the one largest value.
        share = max(float(np.mean(image == brightest)) for image in images[:4])
        if share > 1e-3:
            saturation = float(brightest)
    return Camera(estimate_noise(images, white_level=saturation), saturation)


def _calibrate_each(
    frames: CalibrationFrames, detections: tuple[Detection, ...]
) -> tuple[tuple[MarkerModel, ...], tuple[str, ...]]:
    models = {detection.name: calibrate(frames, detection) for detection in detections}
    missed = [name for name, model in models.items() if model is None]
    notes: tuple[str, ...] = ()
    if missed:
        notes = (f"{', '.join(missed)} was detected but could not be registered, and is left out.",)
    return tuple(model for model in models.values() if model is not None), notes


def _with_estimated_exposure(
    sharp: CalibrationFrames,
    detections: tuple[Detection, ...],
    models: tuple[MarkerModel, ...],
    notes: tuple[str, ...],
) -> tuple[CalibrationFrames, tuple[MarkerModel, ...], tuple[str, ...]]:
    """Calibration with the exposure estimated from motion blur; the one without blur where it is not evident."""
    estimate = ExposureShare(FIRST_GUESS, 0.0)
    fastest = sorted(models, key=lambda model: -largest_motion_px((model,)))[:EXPOSURE_MARKERS]
    names = {model.detection.name for model in fastest}
    chosen = tuple(detection for detection in detections if detection.name in names)
    for _ in range(ESTIMATES):
        frames = replace(sharp, exposure_share=estimate.share)
        blurred, _ = _calibrate_each(frames, chosen)
        found = estimate_exposure(frames, blurred)
        if found is None:
            return sharp, models, (*notes, EXPOSURE_UNKNOWN)
        if not found.is_significant(largest_motion_px(blurred)):
            return sharp, models, notes
        if estimate.sd > 0.0 and not _blur_fits_better(blurred, models):
            return sharp, models, (*notes, EXPOSURE_UNKNOWN)
        estimate = found
    frames = replace(sharp, exposure_share=estimate.share)
    blurred, blurred_notes = _calibrate_each(frames, detections)
    note = (
        f"exposure_s was not given: the motion blur of the markers gives {estimate.share:.3f} +- {estimate.sd:.3f} of "
        "the time between frames, which is used; set exposure_s if you know it."
    )
    return frames, blurred, (*blurred_notes, note)


def _blur_fits_better(blurred: tuple[MarkerModel, ...], sharp: tuple[MarkerModel, ...]) -> bool:
    """Whether blur explains the pixels of patches better: a template of unknown shape fits nearly as well with any."""
    without = {model.detection.name: model.chi2 for model in sharp}
    ratios = [m.chi2 / without[m.detection.name] for m in blurred if not m.detection.kind.has_outline]
    return not ratios or float(np.median(ratios)) < 1.0

"""Everything the follower needs to know of one marker: its template, where that is valid, how well it fits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tracker.arrays import FloatArray, GrayImage
from tracker.markers.base import Detection
from tracker.register import kernel
from tracker.template.noise import NoiseModel
from tracker.template.spline import Template

# A marker of more pixels is sampled: ten thousandths of a pixel are left to noise by these already.
ENOUGH_PIXELS = 8000.0


@dataclass(frozen=True)
class MarkerModel:
    """A calibrated marker.

    Attributes
    ----------
    detection : Detection
        What the detector saw first.
    template : Template
    source : str
        "parametric", "learned", or "first picture" where nothing better could be had.
    warp : array, shape (2, 2)
        From the picture to the template's frame, in the calibration frames.
    refine : array, shape (2, 2)
        What the calibration multiplied the detector's warp by: to be applied to its later warps as well.
    centre_uv : array, shape (2,)
        Centre of the marker in the template's frame, px.
    with_angle : bool
        Whether the texture settles a rotation.
    chi2 : float
        Median of chi-square per degree of freedom over the calibration frames.
    states : array, shape (n, 5)
        x_px, y_px, angle_rad, gain, offset in the calibration frames; NaN where it was not registered.
    known : uint8 array or None
        Points of the template's grid at which its picture is known, beyond its support too: what blur mixes in. None
        where the marker moves too little for it to be asked.
    """

    detection: Detection
    template: Template
    source: Literal["parametric", "learned", "first picture"]
    warp: FloatArray
    refine: FloatArray
    centre_uv: FloatArray
    with_angle: bool
    chi2: float
    states: FloatArray
    known: NDArray[np.uint8] | None = None


@dataclass(frozen=True)
class Camera:
    """What registration needs to know of the pixels: their noise and the level at which they saturate."""

    noise: NoiseModel
    saturation: float


def reach_px(template: Template, warp: FloatArray) -> float:
    """How far from the marker's centre, in px of the picture, the template's support reaches."""
    return template.reach_px / float(np.linalg.svd(warp, compute_uv=False)[-1]) + 1.0


def register(
    image: GrayImage,
    start: FloatArray,
    warp: FloatArray,
    template: Template,
    camera: Camera,
    *,
    reach: float,
    with_angle: bool,
    max_shift_px: float,
) -> FloatArray:
    """Fit a template to a frame; see `tracker.register.kernel.register` for the result's columns."""
    result = np.empty(kernel.RESULT)
    coefs, support = template.grid
    kernel.register(
        image,
        start,
        warp,
        coefs,
        support,
        template.oversampling,
        reach,
        stride(template, warp),
        camera.noise.as_array(),
        camera.saturation,
        kernel.make_space(),
        with_angle,
        max_shift_px,
        result,
    )
    return result


def stride(template: Template, warp: FloatArray) -> int:
    """Pixels of a large marker that may be left out without being missed."""
    pixels = template.area_px / abs(float(np.linalg.det(warp)))
    return max(1, int(np.sqrt(pixels / ENOUGH_PIXELS)))


def contrast_state(image: GrayImage, detection: Detection) -> FloatArray:
    """Start of the very first fit: gain and offset from the brightness around the detection."""
    if detection.kind == "patch":
        return np.array([detection.x_px, detection.y_px, 0.0, 1.0, 0.0])
    half = 0.5 * detection.size_px + 3.0
    top, left = max(int(detection.y_px - half), 0), max(int(detection.x_px - half), 0)
    part = image[top : int(detection.y_px + half) + 2, left : int(detection.x_px + half) + 2]
    dark, light = np.percentile(part, (10, 90)) if part.size else (0.0, 1.0)
    return np.array([detection.x_px, detection.y_px, 0.0, max(float(light - dark), 1.0), float(dark)])

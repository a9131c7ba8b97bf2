"""A calibrated marker: its template, the validity of that template, and the registration of it to a frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tracker.arrays import FloatArray, GrayImage
from tracker.markers import Detection
from tracker.register import kernel
from tracker.register.poor_fit import reconsider
from tracker.template import NoiseModel, Template


@dataclass(frozen=True)
class MarkerModel:
    """A calibrated marker.

    Attributes
    ----------
    source : str
        "first image" where the template could neither be learned nor fitted.
    warp : array, shape (2, 2)
        From the image to the template's frame, in the calibration frames.
    refine : array, shape (2, 2)
        Correction of the detector's warp by the calibration: to be applied to its later warps as well.
    centre_uv : array, shape (2,)
        Centre of the marker in the template's frame, px.
    chi2 : float
        Median of chi-square per degree of freedom over the calibration frames.
    states : array, shape (n, 5)
        x_px, y_px, angle_rad, gain, offset in the calibration frames; NaN where it was not registered.
    known : uint8 array or None
        Grid points of the template at which the image is known, including surroundings that motion blur mixes in. None
        where the marker moves too little for this to matter.
    motion_sd : float
        Relative standard deviation of its displacements, the same in all frames, where background may be part of the
        window; infinite where the marker moves too little in the calibration frames to tell. 0 for other markers.
    left_out : float
        Share of the window that does not move with the marker and is left out.
    """

    detection: Detection
    template: Template
    source: Literal["parametric", "learned", "first image"]
    warp: FloatArray
    refine: FloatArray
    centre_uv: FloatArray
    with_angle: bool
    chi2: float
    states: FloatArray
    known: NDArray[np.uint8] | None = None
    motion_sd: float = 0.0
    left_out: float = 0.0


@dataclass(frozen=True)
class Camera:
    """Properties of the pixels that registration needs: noise model and saturation level."""

    noise: NoiseModel
    saturation: float

    @cached_property
    def pixels(self) -> kernel.Pixels:
        """Both for compiled code."""
        return kernel.Pixels(self.noise.as_array(), self.saturation)


def register(
    image: GrayImage,
    start: FloatArray,
    warp: FloatArray,
    template: Template,
    camera: Camera,
    *,
    with_angle: bool,
    max_shift_px: float,
    light: float | None = None,
) -> FloatArray:
    """Fit a template to a frame; see `tracker.register.kernel.register` for the columns of the result.

    With the last share of uneven `light`, poor fits are reconsidered by `tracker.register.poor_fit.reconsider`.
    """
    result = np.empty(kernel.RESULT)
    reach, stride = template.image_reach_px(warp), template.stride(warp)
    grid, space = kernel.Grid(*template.grid, template.oversampling, reach, stride), kernel.make_workspace()
    kernel.register(image, start, warp, grid, camera.pixels, space, with_angle, max_shift_px, result)
    if light is not None:
        result[kernel.LIGHT] = light
        reconsider(image, warp, grid, camera.pixels, space, with_angle, max_shift_px, result)
    return result


def contrast_state(image: GrayImage, detection: Detection, centre_px: FloatArray | None = None) -> FloatArray:
    """Start of a first fit: position of the detection (or `centre_px`), gain and offset from the brightness there."""
    if centre_px is not None:
        detection = detection.at(centre_px)
    gain, offset = detection.kind.start_contrast(image, detection)
    return np.array([detection.x_px, detection.y_px, 0.0, gain, offset])

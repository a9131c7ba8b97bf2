"""A calibrated marker: template and its validity, registration to a frame, coarse search, fixed point."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from tracker.acceptance import TUNING as ACCEPTANCE
from tracker.arrays import FloatArray, GrayImage
from tracker.markers import Detection, part_around
from tracker.register import kernel
from tracker.register.poor_fit import reconsider
from tracker.register.sampling import picture
from tracker.template import NoiseModel, Template


@dataclass(frozen=True)
class Tuning:
    """Search for a marker, and when its surroundings are too white to register."""

    #: [1] share of the pixels at the white level below which edges are seen
    many_white: float = 0.1
    #: [1] range of the other gray levels, relative to white, above which an edge is seen
    #: physics: an edge across a marker of 5 px fills a tenth of its surroundings with the gray levels between dark and
    #: white
    one_level: float = 0.05


TUNING = Tuning()


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
    pixels = picture(image)
    kernel.register(pixels, start, warp, grid, camera.pixels, space, with_angle, max_shift_px, result)
    if light is not None:
        result[kernel.LIGHT] = light
        reconsider(pixels, warp, grid, camera.pixels, space, with_angle, max_shift_px, result)
    return result


def contrast_state(image: GrayImage, detection: Detection, centre_px: FloatArray | None = None) -> FloatArray:
    """Start of a first fit: position of the detection (or `centre_px`), gain and offset from the brightness there."""
    if centre_px is not None:
        detection = detection.at(centre_px)
    gain, offset = detection.kind.start_contrast(image, detection)
    return np.array([detection.x_px, detection.y_px, 0.0, gain, offset])


def coarse_search(
    image: GrayImage,
    centre_px: FloatArray,
    reach_px: float,
    template: Template,
    warp: FloatArray,
    gain: float,
) -> FloatArray | None:
    """Whole-pixel position of the best normalised correlation with a template, or None.

    The marker's centre is sought within `reach_px` of `centre_px` in x and y. Only the sign of `gain` is used: with a
    negative gain the negative of the template is searched for.
    """
    half = int(np.ceil(template.reach_px / np.linalg.svd(warp, compute_uv=False)[-1] / np.sqrt(2.0))) + 1
    v, u = np.mgrid[-half : half + 1, -half : half + 1].astype(np.float64)
    pattern, support = template.sampled(np.einsum("ij,jrc->irc", warp, np.stack([u, v])))
    height, width = image.shape
    x, y = round(float(centre_px[0])), round(float(centre_px[1]))
    span = half + int(np.ceil(reach_px))
    top, left = max(y - span, 0), max(x - span, 0)
    part = image[top : min(y + span + 1, height), left : min(x + span + 1, width)].astype(np.float32)
    if part.shape[0] < pattern.shape[0] or part.shape[1] < pattern.shape[1]:
        return None
    signed = (np.sign(gain) * pattern).astype(np.float32)
    score = cv2.matchTemplate(part, signed, cv2.TM_CCOEFF_NORMED, mask=support.astype(np.float32))
    score[~np.isfinite(score)] = -1.0
    best = np.unravel_index(int(np.argmax(score)), score.shape)
    if score[best] < ACCEPTANCE.least_score:
        return None
    return np.array([left + best[1] + half, top + best[0] + half], dtype=np.float64)


def without_edges(images: list[GrayImage], detections: tuple[Detection, ...], white_level: float) -> str:
    """Reason why no marker can be registered where all have white pixels and one dark level only; empty else."""
    shares = []
    for found in detections:
        part, _, _ = part_around(images[found.frame], found.x_px, found.y_px, found.size_px, beyond=2)
        below = part[part < white_level].astype(float)
        share = 1.0 - below.size / max(part.size, 1)
        levels = np.ptp(np.quantile(below, [0.02, 0.98])) if below.size else 0.0
        if share < TUNING.many_white or levels > TUNING.one_level * white_level:
            return ""
        shares.append(share)
    if not shares:
        return ""
    white = f"the white level, {white_level:g}"
    return (
        f"markers were detected, but {100.0 * float(np.median(shares)):.0f} % of the pixels around them are at "
        f"{white}, and the others have one gray level: white pixels may be brighter than the file can state and are "
        f"not used, so no edge is left to register. Reduce exposure or light until white is below {white_level:g}; in "
        "a film that is drawn, use a darker white or edges with gray levels between"
    )


def fixed_point_px(model: MarkerModel) -> FloatArray:
    """Where a marker that grows is registered, as if it grew about this point; x and y from its centre, shape (2,).

    The template keeps its size. Least squares of the change of the image by growth on its changes by all parameters of
    the registration: a dot has its centre there, a code or a piece of texture the point about which its edges balance.
    """
    template = model.template
    inside = template.support > 0
    gray, by_u, by_v = (image[inside] for image in (template.values(), *template.slopes()))
    rows, columns = np.nonzero(inside)
    u, v = (
        (at - 0.5 * (size - 1)) for at, size in zip((columns, rows), template.coefs.shape[::-1], strict=True)
    )
    others = [gray, np.ones_like(gray), *([u * by_v - v * by_u] if model.with_angle else [])]
    found = np.linalg.lstsq(np.column_stack([by_u, by_v, *others]), u * by_u + v * by_v, rcond=None)[0]
    return np.asarray(np.linalg.solve(model.warp, found[:2] / template.oversampling - model.centre_uv))

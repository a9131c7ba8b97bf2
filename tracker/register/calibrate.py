"""Calibration of markers: learn each template or fit the ideal one, then refine noise and exposure time."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tracker.acceptance import TUNING as ACCEPTANCE
from tracker.arrays import FloatArray, GrayImage
from tracker.markers import Detection, IdealFit, part_around
from tracker.register import kernel
from tracker.register.calibration_frames import TUNING as FOLLOWED
from tracker.register.calibration_frames import (
    CalibrationFrames,
    core_of,
    normalised,
    notes_on_patches,
    registered,
    with_motion_sd,
    with_refined_warp,
    without_background,
)
from tracker.register.exposure import ExposureShare, estimate_exposure, largest_motion_px
from tracker.register.marker import Camera, MarkerModel, contrast_state, register
from tracker.template import (
    Blurrer,
    NoiseModel,
    Template,
    estimate_noise,
    fit_line,
    grid_px,
    is_blur,
    learn_template,
    modelled_pixels,
    path_length_px,
    paths_px,
    residual_map,
    sd_factors,
    seen_from_marker,
    sharp_states,
    trimmed_support,
    unblurred,
    widened,
)
from tracker.template import blur as motion_blur
from tracker.template import noise as pixel_noise
from tracker.template import template as templates


@dataclass(frozen=True)
class Tuning:
    """Choice between templates, the refined noise, and the exposure from blur."""

    #: [1] ratio of chi-square up to which the ideal template is preferred to the learned one
    #: convention: a learned template adapts to the noise it is learned from, so that its chi-square is slightly too low
    parametric_margin: float = 1.06
    #: [1] the same where neither template fits
    #: convention: the marker's appearance then changes, and the ideal template represents its mean better
    lenient_margin: float = 2.0
    #: [px] a patch whose positions changed by less in a round is learned
    #: convention: below the usual sd of a position; effect of the number not measured
    settled_px: float = 2e-3
    #: [1] white rim of a large marker whose pixels are used to fit its ideal template, relative to its size
    #: convention: less than a cell of a code of 4 x 4 cells and its border
    large_rim: float = 0.125
    #: [1] the angle is fitted where it raises the sd of the position by less than this factor
    angle_cost: float = 1.3
    #: [1] intervals of brightness in which the residuals' variance is taken
    bins: int = 12
    #: [1] chi-square under the first noise model from which a marker's template can be correct
    least_plausible_chi2: float = 0.2
    #: [1] the same, at most
    #: convention: as above
    largest_plausible_chi2: float = 1.6
    #: [1] share of the exposure assumed while the templates are learned from which it is then estimated
    #: convention: the middle of what is possible; a second round removes its effect
    first_guess: float = 0.5
    #: [rounds] of the estimate of the exposure
    #: convention: once with the guess, once more with templates learned with the first estimate
    estimates: int = 2
    #: [markers] from which the exposure is estimated, the fastest ones
    #: convention: more hardly improve it and cost time
    exposure_markers: int = 8
    #: [1] share of the pixels at one largest value from which it is the camera's white
    #: convention: a camera of 12 bit in a file of 16 saturates at its own white; without saturation few pixels share
    #: the largest value
    common_white: float = 1e-3


TUNING = Tuning()


def calibrate(frames: CalibrationFrames, detection: Detection) -> MarkerModel | None:
    """Template of one marker from the first frames of a recording; None when no frame can be registered."""
    first = MarkerModel(
        detection=detection,
        template=detection.template,
        source="first image",
        warp=detection.warp,
        refine=np.eye(2),
        centre_uv=np.zeros(2),
        with_angle=False,
        chi2=np.inf,
        states=np.full((len(frames.images), 5), np.nan),
    )
    if detection.size_px > detection.kind.largest_learned_px:
        large = _fit_large(frames, first)
        return None if large is None else replace(large, with_angle=True)
    guess = registered(frames, first, contrast_state(frames.images[detection.frame], detection))
    if guess is None:
        return None
    if detection.kind.decodes_shape:
        guess = with_refined_warp(frames, guess)
    if not detection.kind.has_outline:
        guess = without_background(frames, guess)
    learned = _learn(frames, guess)
    if learned is None:
        return guess
    ideal = _fit_ideal(frames, learned)
    worst_ratio = TUNING.lenient_margin if learned.chi2 > ACCEPTANCE.good_chi2 else TUNING.parametric_margin
    best = ideal if ideal is not None and ideal.chi2 <= worst_ratio * learned.chi2 else learned
    return replace(best, with_angle=_angle_is_determined(frames, best, learned))


def _learn(frames: CalibrationFrames, guess: MarkerModel) -> MarkerModel | None:
    """Alternately learn the template and register it; the support of a marker loses points that move differently."""
    detection, images, share = guess.detection, frames.images, frames.exposure_share
    beyond = _beyond_px(guess.states, share)
    support, known = _first_support(guess, beyond)
    core = core_of(
        detection, Template(np.zeros(support.shape), support, templates.TUNING.learned_oversampling)
    )
    current, learned, has_outline = guess, None, detection.kind.has_outline
    chi2 = 1.0 if has_outline else guess.chi2
    blurred: Template | None = None
    for _ in range(detection.kind.learning_rounds):
        states = normalised(current.states)
        sharp = sharp_states(states, share)
        start = None if blurred is None else blurred.coefs
        noise, saturation = frames.camera.noise, frames.camera.saturation
        # Only downwards: a template that is too smooth raises chi-square itself.
        chi2 = min(chi2, current.chi2)
        blurred = learn_template(images, sharp, current.warp, known, noise, saturation, start, chi2)
        if blurred is None:
            return learned
        if has_outline:
            known = trimmed_support(blurred, residual_map(images, sharp, current.warp, blurred, noise), core)
            support = np.ascontiguousarray(support * known)
        at_rest = _at_rest(blurred, states, sharp, current.warp, share)
        current = replace(
            current,
            template=Template(at_rest.coefs, support, templates.TUNING.learned_oversampling),
            source="learned",
            known=known if beyond else None,
        )
        updated = registered(frames, current, states[detection.frame], states)
        if updated is None:
            return learned
        moved_px = np.abs(updated.states[:, :2] - states[:, :2])
        current = learned = updated
        if not has_outline and np.nanmax(moved_px, initial=0.0) < TUNING.settled_px:
            break
    return learned


def _beyond_px(states: FloatArray, exposure_share: float) -> float:
    """Distance beyond its support from which the longest motion mixes surroundings into a marker."""
    longest = max((path_length_px(p) for p in paths_px(states, exposure_share)), default=0.0)
    return min(longest, motion_blur.TUNING.longest_px) + 1.0 if is_blur(longest) else 0.0


def _first_support(guess: MarkerModel, beyond_px: float) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Support of the first template on the learned template's grid, and the same with its surroundings."""
    detection, old = guess.detection, guess.detection.template
    rows, cols = np.nonzero(old.support)
    centre = (np.array(old.support.shape) - 1) / 2
    half_v = float(np.abs(rows - centre[0]).max()) / old.oversampling
    half_u = float(np.abs(cols - centre[1]).max()) / old.oversampling
    u, v = grid_px(half_u + beyond_px, half_v + beyond_px, templates.TUNING.learned_oversampling)

    def within(more_px: float) -> NDArray[np.uint8]:
        inside = detection.kind.covers(u[None, :], v[:, None], half_u + more_px, half_v + more_px)
        return inside.astype(np.uint8)

    support, known = within(0.0), within(beyond_px)
    if not detection.kind.has_outline:
        support *= guess.template.sampled(np.stack(np.meshgrid(u, v)))[1].astype(np.uint8)
    return support, known


def _at_rest(
    blurred: Template, states: FloatArray, sharp: FloatArray, warp: FloatArray, exposure_share: float
) -> Template:
    """The learned template without the motion that remains in the sharpest frames."""
    seen = np.all(np.isfinite(sharp), axis=1)
    moving = zip(paths_px(states, exposure_share)[seen], states[seen, 2], strict=True)
    paths = [seen_from_marker(path, warp, angle) for path, angle in moving]
    still = not is_blur(max(path_length_px(p) for p in paths))
    return blurred if still else unblurred(blurred, paths)


def _fit_ideal(frames: CalibrationFrames, learned: MarkerModel) -> MarkerModel | None:
    """The parametric template fitted to the learned one, registered in all frames; None where there is none."""
    fit = learned.detection.kind.fit_learned(learned.detection, learned.template)
    if fit is None:
        return None
    model = _with_support_of(_parametric(learned, fit), learned, fit.centre_uv)
    states = learned.states.copy()
    # The learned template's origin lies `centre_uv` off the marker's centre.
    angle = np.nanmedian(learned.states[:, 2])
    cosine, sine = np.cos(angle), np.sin(angle)
    turned = np.array([[cosine, -sine], [sine, cosine]]) @ fit.centre_uv
    states[:, :2] += np.linalg.inv(learned.warp) @ turned
    states[:, 4] = learned.states[:, 4] + learned.states[:, 3] * fit.dark
    states[:, 3] = learned.states[:, 3] * (fit.light - fit.dark)
    return registered(frames, model, states[model.detection.frame], states)


def _parametric(model: MarkerModel, fit: IdealFit) -> MarkerModel:
    return replace(
        model,
        detection=replace(model.detection, size_px=fit.size_px),
        template=fit.template,
        source="parametric",
        warp=fit.matrix @ model.warp,
        refine=fit.matrix @ model.refine,
        centre_uv=np.zeros(2),
    )


def _with_support_of(model: MarkerModel, learned: MarkerModel, centre_uv: FloatArray) -> MarkerModel:
    """Parametric model that excludes the same points as the learned one."""
    template, old = model.template, learned.template
    if learned.known is not None:
        half = [(t.support.shape[0] - 1) / (2.0 * t.oversampling) for t in (old, template)]
        template = widened(template, max(half[0] - half[1], 0.0))
    u, v = template.axes_px()
    matrix = model.warp @ np.linalg.inv(learned.warp)
    points = np.linalg.inv(matrix) @ np.stack([a.ravel() for a in np.meshgrid(u, v)]) + centre_uv[:, None]
    mask = old if learned.known is None else Template(old.coefs, learned.known, old.oversampling)
    kept = mask.sampled(points)[1].reshape(template.support.shape).astype(np.uint8)
    support = np.ascontiguousarray(template.support * kept)
    template = Template(template.coefs, support, template.oversampling)
    return replace(model, template=template, known=None if learned.known is None else kept)


def _fit_large(frames: CalibrationFrames, model: MarkerModel) -> MarkerModel | None:
    """The parametric template fitted to the pixels of the detection's frame: many pixels need no averaging."""
    detection = model.detection
    image = frames.images[detection.frame]
    reach = model.template.image_reach_px(model.warp)
    part, left, top = part_around(image, detection.x_px, detection.y_px, reach)
    y, x = np.indices(part.shape)
    points = model.warp @ np.stack([x.ravel() + left - detection.x_px, y.ravel() + top - detection.y_px])
    inside = np.max(np.abs(points), axis=0) <= 0.5 * detection.size_px * (1.0 + TUNING.large_rim)
    inside &= part.ravel() < frames.camera.saturation
    fit = detection.kind.fit_pixels(detection, points[:, inside], part.ravel()[inside].astype(np.float64))
    if fit is None:
        return None
    ideal = _parametric(model, fit)
    centre = np.array([detection.x_px, detection.y_px]) + np.linalg.inv(model.warp) @ fit.centre_uv
    return registered(frames, ideal, np.array([*centre, 0.0, fit.light - fit.dark, fit.dark]))


def _angle_is_determined(frames: CalibrationFrames, model: MarkerModel, learned: MarkerModel) -> bool:
    """Whether fitting the angle raises the standard deviation of the position by less than a third."""
    if not model.detection.kind.can_have_angle:
        return False
    states = sharp_states(learned.states, frames.exposure_share)
    seen = np.flatnonzero(np.all(np.isfinite(states), axis=1))
    if seen.size == 0:
        return False
    image, start = frames.images[int(seen[0])], states[int(seen[0])]
    if model.source == "parametric":
        start = contrast_state(image, model.detection, start[:2])
    fits = [
        register(
            image,
            start,
            model.warp,
            model.template,
            frames.camera,
            with_angle=with_angle,
            max_shift_px=FOLLOWED.shift_px,
        )
        for with_angle in (False, True)
    ]
    fixed, free = (np.hypot(fit[kernel.SD_X], fit[kernel.SD_Y]) for fit in fits)
    return bool(free <= TUNING.angle_cost * fixed)


def refined_noise(
    frames: list[GrayImage], models: tuple[MarkerModel, ...], first: NoiseModel, exposure_share: float = 0.0
) -> NoiseModel:
    """Noise model from the residuals of markers whose parametric template fits.

    Small markers contain no smooth areas, so their brightness can be missing in an estimate from differences of
    frames; the residuals include it. The first model is returned where no marker fits well enough for its residuals to
    be noise.
    """
    good = [
        m
        for m in models
        if m.source == "parametric" and TUNING.least_plausible_chi2 < m.chi2 < TUNING.largest_plausible_chi2
    ]
    if not good:
        return first
    gain = np.nanmedian([np.nanmedian(m.states[:, 3]) for m in good])
    offset = np.nanmedian([np.nanmedian(m.states[:, 4]) for m in good])
    low, high = sorted((float(offset), float(offset + gain)))
    width = max((high - low) / TUNING.bins, 1e-9)
    sums = np.zeros((3, TUNING.bins))
    fits = 0
    for model in good:
        seen = np.flatnonzero(np.all(np.isfinite(sharp_states(model.states, exposure_share)), axis=1))
        paths = paths_px(model.states, exposure_share)
        blurrer = Blurrer(model.template, model.known)
        for k in seen[:: max(1, seen.size // pixel_noise.TUNING.residual_frames)]:
            state = model.states[k]
            template = blurrer.get(seen_from_marker(paths[k], model.warp, state[2]))
            at, pixel, level = modelled_pixels(
                frames[k], state, model.warp, template.coefs, template.oversampling
            )
            inside = template.support[at] > 0
            pixel, level = pixel[inside], level[inside]
            index = np.clip(((level - low) / width).astype(np.int64), 0, TUNING.bins - 1)
            for total, amount in zip(sums, (np.ones(level.size), level, (pixel - level) ** 2), strict=True):
                np.add.at(total, index, amount)
            fits += 1
    used = sums[0] >= pixel_noise.TUNING.least_in_bin
    if not used.any():
        return first
    # Each fit determined x, y, angle, gain and offset from its pixels.
    pixels = float(sums[0].sum())
    correction = pixels / max(pixels - 5.0 * fits, 0.5 * pixels)
    count, level, square = sums[:, used]
    return fit_line(level / count, correction * square / count, count)


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
    if exposure_share is None and is_blur(0.5 * largest_motion_px(models)):
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
        if share > TUNING.common_white:
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
    estimate = ExposureShare(TUNING.first_guess, 0.0)
    fastest = sorted(models, key=lambda model: -largest_motion_px((model,)))[: TUNING.exposure_markers]
    names = {model.detection.name for model in fastest}
    chosen = tuple(detection for detection in detections if detection.name in names)
    for _ in range(TUNING.estimates):
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

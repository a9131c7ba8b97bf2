"""Calibration of one marker: learn its template, fit the ideal one, and choose the one that fits the pixels better."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tracker.arrays import FloatArray
from tracker.markers import Detection, IdealFit
from tracker.register import kernel
from tracker.register.calibration_frames import CalibrationFrames, core_of, normalised, registered
from tracker.register.marker import MarkerModel, contrast_state, register
from tracker.register.moving_object import without_background
from tracker.register.refined_warp import with_refined_warp
from tracker.template import (
    LONGEST_PX,
    OVERSAMPLING,
    SMALLEST_PX,
    Template,
    grid_px,
    learn_template,
    path_length_px,
    paths_px,
    residual_map,
    seen_from_marker,
    sharp_states,
    trimmed_support,
    unblurred,
    widened,
)

# A learned template adapts to the noise it is learned from, so its chi-square is slightly too low.
PARAMETRIC_MARGIN = 1.06
# Where neither template fits, the marker's appearance changes; the ideal template then represents its mean better.
NEITHER_FITS = 3.0
# A patch whose positions changed by less than this in a round is learned.
SETTLED_PX = 2e-3
# White rim around a large marker whose pixels are used to fit its ideal template, relative to the marker's size.
LARGE_RIM = 1.0 / 8.0


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
    worst_ratio = 2.0 if learned.chi2 > NEITHER_FITS else PARAMETRIC_MARGIN
    best = ideal if ideal is not None and ideal.chi2 <= worst_ratio * learned.chi2 else learned
    return replace(best, with_angle=_angle_is_determined(frames, best, learned))


def _learn(frames: CalibrationFrames, guess: MarkerModel) -> MarkerModel | None:
    """Alternately learn the template and register it; the support of a marker loses points that move differently."""
    detection, images, share = guess.detection, frames.images, frames.exposure_share
    beyond = _beyond_px(guess.states, share)
    support, known = _first_support(guess, beyond)
    core = core_of(detection, Template(np.zeros(support.shape), support, OVERSAMPLING))
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
            template=Template(at_rest.coefs, support, OVERSAMPLING),
            source="learned",
            known=known if beyond else None,
        )
        updated = registered(frames, current, states[detection.frame], states)
        if updated is None:
            return learned
        moved_px = np.abs(updated.states[:, :2] - states[:, :2])
        current = learned = updated
        if not has_outline and np.nanmax(moved_px, initial=0.0) < SETTLED_PX:
            break
    return learned


def _beyond_px(states: FloatArray, exposure_share: float) -> float:
    """Distance beyond its support from which the longest motion mixes surroundings into a marker."""
    longest = max((path_length_px(p) for p in paths_px(states, exposure_share)), default=0.0)
    return min(longest, LONGEST_PX) + 1.0 if longest >= SMALLEST_PX else 0.0


def _first_support(guess: MarkerModel, beyond_px: float) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Support of the first template on the learned template's grid, and the same with its surroundings."""
    detection, old = guess.detection, guess.detection.template
    rows, cols = np.nonzero(old.support)
    centre = (np.array(old.support.shape) - 1) / 2
    half_v = float(np.abs(rows - centre[0]).max()) / old.oversampling
    half_u = float(np.abs(cols - centre[1]).max()) / old.oversampling
    u, v = grid_px(half_u + beyond_px, half_v + beyond_px, OVERSAMPLING)

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
    still = max(path_length_px(p) for p in paths) < SMALLEST_PX
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
    top, left = max(int(detection.y_px - reach), 0), max(int(detection.x_px - reach), 0)
    part = image[top : int(detection.y_px + reach) + 1, left : int(detection.x_px + reach) + 1]
    y, x = np.indices(part.shape)
    points = model.warp @ np.stack([x.ravel() + left - detection.x_px, y.ravel() + top - detection.y_px])
    inside = np.max(np.abs(points), axis=0) <= 0.5 * detection.size_px * (1.0 + LARGE_RIM)
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
            image, start, model.warp, model.template, frames.camera, with_angle=with_angle, max_shift_px=3.0
        )
        for with_angle in (False, True)
    ]
    fixed, free = (np.hypot(fit[kernel.SD_X], fit[kernel.SD_Y]) for fit in fits)
    return bool(free <= 1.3 * fixed)

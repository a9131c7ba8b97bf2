"""Calibration of one marker: learn its template, fit the ideal one, and choose the one that fits the pixels better."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tracker.arrays import BoolArray, FloatArray, GrayImage
from tracker.markers.base import Detection, IdealFit
from tracker.register import kernel
from tracker.register.marker import Camera, MarkerModel, contrast_state, register
from tracker.template.blur import (
    LONGEST_PX,
    SMALLEST_PX,
    BlurBank,
    path_length_px,
    seen_from_marker,
    unblurred,
    widened,
)
from tracker.template.exposure_paths import extrapolated, paths_px, sharp_states, typical_chi2
from tracker.template.learned import OVERSAMPLING, learn_template, residual_map, trimmed_support
from tracker.template.spline import Template, grid_px

# A learned template adapts to the noise it is learned from, so its chi-square is slightly too low.
PARAMETRIC_MARGIN = 1.06
# Where neither template fits, the marker's appearance changes; the ideal template then represents its mean better.
NEITHER_FITS = 3.0
# White rim around a large marker whose pixels are used to fit its ideal template, relative to the marker's size.
LARGE_RIM = 1.0 / 8.0


@dataclass(frozen=True)
class CalibrationFrames:
    """Consecutive first frames, the camera, and the exposed share of the frame interval (0 where unknown)."""

    images: list[GrayImage]
    camera: Camera
    exposure_share: float = 0.0


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
    guess = _registered(frames, first, contrast_state(frames.images[detection.frame], detection))
    if guess is None:
        return None
    learned = _learn(frames, guess)
    if learned is None:
        return guess
    ideal = _fit_ideal(frames, learned)
    worst_ratio = 2.0 if learned.chi2 > NEITHER_FITS else PARAMETRIC_MARGIN
    best = ideal if ideal is not None and ideal.chi2 <= worst_ratio * learned.chi2 else learned
    return replace(best, with_angle=_angle_is_determined(frames, best, learned))


def _registered(
    frames: CalibrationFrames, model: MarkerModel, start: FloatArray, states: FloatArray | None = None
) -> MarkerModel | None:
    """The model with its states and chi-square in all frames; None where it fits in no frame.

    Frames are followed forward and backward from the detection's. Earlier `states`, where given, are the starts, and
    their path during the exposure is the blur; otherwise the previous frames are extrapolated.
    """
    n = len(frames.images)
    if states is not None and not np.all(np.isfinite(start)):
        # The detection's own frame was not fitted: use the state of the nearest frame that was.
        seen = np.flatnonzero(np.all(np.isfinite(states), axis=1))
        if seen.size:
            start = states[seen[np.argmin(np.abs(seen - model.detection.frame))]]
    fitted, chi2 = np.full((n, 5), np.nan), np.full(n, np.nan)
    bank = BlurBank(model.template, model.known)
    paths = None if states is None else paths_px(states, frames.exposure_share)
    first, path_px = model.detection.frame, model.detection.path_px
    for sequence in (range(first, n), range(first - 1, -1, -1)):
        past: list[FloatArray] = []
        state = start.copy()
        if sequence.step < 0 and np.isfinite(chi2[first]):
            state = fitted[first].copy()
            past = [s[:2].copy() for s in fitted[first : first + 3][::-1] if np.isfinite(s[0])]
        for k in sequence:
            guess, motion = state.copy(), np.zeros(2)
            if states is not None and paths is not None and np.all(np.isfinite(states[k])):
                guess = states[k].copy()
                template = bank.exact(seen_from_marker(paths[k], model.warp, guess[2]))
            else:
                if past:
                    guess[:2], motion = extrapolated(past)
                if path_px is not None and np.all(np.isfinite(path_px[k])):
                    guess[:2], motion = path_px[k], np.nan_to_num(np.gradient(path_px, axis=0)[k])
                path = np.stack([frames.exposure_share * motion, np.zeros(2)])
                template = bank.get(seen_from_marker(path, model.warp, guess[2])[0])
            result = register(
                frames.images[k],
                guess,
                model.warp,
                template,
                frames.camera,
                with_angle=model.detection.kind.angle_while_learning,
                max_shift_px=3.0 + 0.25 * model.detection.size_px,
            )
            if result[kernel.CONVERGED] == 0.0:
                past = past[-1:]
                continue
            state = result[:5].copy()
            past = [*past[-2:], state[:2].copy()]
            fitted[k], chi2[k] = state, result[kernel.CHI2]
    if not np.any(np.isfinite(chi2)):
        return None
    return replace(model, states=fitted, chi2=typical_chi2(chi2, fitted, frames.exposure_share))


def _learn(frames: CalibrationFrames, guess: MarkerModel) -> MarkerModel | None:
    """Alternately learn the template and register it; the support loses points that move differently."""
    detection, images, share = guess.detection, frames.images, frames.exposure_share
    beyond = _beyond_px(guess.states, share)
    support, known = _first_support(detection, beyond)
    core = _core(detection, support.shape)
    current, learned = guess, None
    blurred: Template | None = None
    for _ in range(detection.kind.learning_rounds):
        states = _normalised(current.states)
        sharp = sharp_states(states, share)
        start = None if blurred is None else blurred.coefs
        noise, saturation = frames.camera.noise, frames.camera.saturation
        blurred = learn_template(images, sharp, current.warp, known, noise, saturation, start)
        if blurred is None:
            return learned
        known = trimmed_support(blurred, residual_map(images, sharp, current.warp, blurred, noise), core)
        support = np.ascontiguousarray(support * known)
        at_rest = _at_rest(blurred, states, sharp, current.warp, share)
        current = replace(
            current,
            template=Template(at_rest.coefs, support, OVERSAMPLING),
            source="learned",
            known=known if beyond else None,
        )
        updated = _registered(frames, current, states[detection.frame], states)
        if updated is None:
            return learned
        current = learned = updated
    return learned


def _normalised(states: FloatArray) -> FloatArray:
    """States with gain and offset relative to their medians: the learned template is in gray levels."""
    gain, offset = np.nanmedian(states[:, 3]), np.nanmedian(states[:, 4])
    out = states.copy()
    out[:, 3] = states[:, 3] / gain
    out[:, 4] = states[:, 4] - offset * out[:, 3]
    return out


def _beyond_px(states: FloatArray, exposure_share: float) -> float:
    """Distance beyond its support from which the longest motion mixes surroundings into a marker."""
    longest = max((path_length_px(p) for p in paths_px(states, exposure_share)), default=0.0)
    return min(longest, LONGEST_PX) + 1.0 if longest >= SMALLEST_PX else 0.0


def _first_support(detection: Detection, beyond_px: float) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Support of the first template on the learned template's grid, and the same with its surroundings."""
    old = detection.template
    rows, cols = np.nonzero(old.support)
    centre = (np.array(old.support.shape) - 1) / 2
    half_v = float(np.abs(rows - centre[0]).max()) / old.oversampling
    half_u = float(np.abs(cols - centre[1]).max()) / old.oversampling
    u, v = grid_px(half_u + beyond_px, half_v + beyond_px, OVERSAMPLING)

    def within(more_px: float) -> NDArray[np.uint8]:
        inside = detection.kind.covers(u[None, :], v[:, None], half_u + more_px, half_v + more_px)
        return inside.astype(np.uint8)

    return within(0.0), within(beyond_px)


def _core(detection: Detection, shape: tuple[int, ...]) -> BoolArray:
    """Grid points that belong to the marker itself and not to its surroundings."""
    v = np.abs(np.arange(shape[0]) - 0.5 * (shape[0] - 1))[:, None] / OVERSAMPLING
    u = np.abs(np.arange(shape[1]) - 0.5 * (shape[1] - 1))[None, :] / OVERSAMPLING
    half = detection.kind.core_half_px(detection.size_px)
    return detection.kind.covers(u, v, half, half)


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
    return _registered(frames, model, states[model.detection.frame], states)


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
    return _registered(frames, ideal, np.array([*centre, 0.0, fit.light - fit.dark, fit.dark]))


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

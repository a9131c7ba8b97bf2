"""Registration of one marker in all calibration frames; for a patch, the part that moves as one object.

The shape in the image of a marker that rotates is fitted to all: the corners of one frame do not determine it well
enough.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tracker.acceptance import TUNING as ACCEPTANCE
from tracker.arrays import BoolArray, FloatArray, GrayImage, IntArray
from tracker.geometry import median_over_time
from tracker.markers import Detection
from tracker.register import kernel
from tracker.register.kernel import acceptable, correlation
from tracker.register.marker import Camera, MarkerModel, coarse_search, register
from tracker.template import (
    BlurBank,
    ObjectMotion,
    Template,
    extrapolated,
    learn_template,
    motion_shares,
    object_motion,
    paths_px,
    scaled_motion,
    seen_from_marker,
    typical_chi2,
)


@dataclass(frozen=True)
class Tuning:
    """Following a marker through the calibration frames, the object in a patch, the shape of a rotating marker."""

    #: [1] correlation below which a fit during the calibration is not the marker
    #: convention: where a fit anywhere counted, patches, dots and codes at 25 px a frame were learned from wrong
    #: places; the number is chosen
    least_while_learning: float = 0.6
    #: [1] usual chi-square of a template that is one image
    #: statistics: it has as much noise as the frame
    chi2_of_one_image: float = 2.0
    #: [frames] since a marker was found, over which its search grows
    #: convention: limits time
    most_lost: int = 4
    #: [px] largest search
    #: convention: limits time
    farthest_px: float = 200.0
    #: [px] from a start at which a fit fails; the first fit, beside the share of the size below
    shift_px: float = 3.0
    #: [1] share of the marker's size that is added to it
    shift_share: float = 0.25
    #: [px] nearer starts are the same
    #: convention: Gauss-Newton steps from both lead to the same minimum
    apart_px: float = 1.0
    #: [rounds] in which the template of a window and the part of it that is the object are found
    #: convention: rounds end when they change nothing; effect of the limit not measured
    rounds: int = 4
    #: [frames] from which they are found
    #: convention: limits time
    frames: int = 32
    #: [1] the fitted motion is multiplied by the object's share if the sd of that share is below this
    #: convention: a factor that is less certain would be an error of its own
    share_sd: float = 0.03
    #: [sd] a share this close to 1 needs no further round
    #: statistics: half a standard deviation is not significant
    settled: float = 0.5
    #: [1] smaller shares of a window and relative errors are not mentioned
    #: convention: chosen; a note changes no result
    worth_a_note: float = 0.05
    #: [rad] rotation over the calibration frames from which the shape is fitted
    #: convention: a template absorbs an error of the warp as long as the marker turns less
    least_rotation_rad: float = 0.1
    #: [rad] rotation during an exposure up to which the shape is fitted
    #: convention: no template includes rotation: with more, the shear would only hide the misfit
    largest_blur_rad: float = 0.03
    #: [frames] that are compared
    #: convention: limits time
    warp_frames: int = 16
    #: [steps] Newton steps at most
    #: convention: limits time
    warp_steps: int = 6
    #: [px] change at the marker's rim over which chi-square is differenced
    #: convention: well above the rounding of chi-square and below the blur
    difference_px: float = 0.1
    #: [px] change at the marker's rim that ends the search
    #: convention: far below the tenths of a px by which corners err
    short_px: float = 0.005


TUNING = Tuning()


@dataclass(frozen=True)
class CalibrationFrames:
    """Consecutive first frames, the camera, and the exposed share of the frame interval (0 where unknown)."""

    images: list[GrayImage]
    camera: Camera
    exposure_share: float = 0.0


def registered(
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
    velocity_px = None if path_px is None else _velocity_px(path_px)
    for sequence in (range(first, n), range(first - 1, -1, -1)):
        past: list[FloatArray] = []
        state, seen_at = start.copy(), first
        if sequence.step < 0 and np.isfinite(chi2[first]):
            state = fitted[first].copy()
            past = [s[:2].copy() for s in fitted[first : first + 3][::-1] if np.isfinite(s[0])]
        for k in sequence:
            guess, motion, others = state.copy(), np.zeros(2), []
            known = states is not None and bool(np.all(np.isfinite(states[k])))
            if known and states is not None and paths is not None:
                guess = states[k].copy()
                template = bank.exact(seen_from_marker(paths[k], model.warp, guess[2]))
            else:
                # Near a quarter of the frame rate or above, a motion does not continue: it may also be where it was.
                # One that others look like must not be sought there.
                others = [state.copy(), start.copy()] if past and not model.detection.kind.has_outline else []
                if past:
                    guess[:2], motion = extrapolated(past)
                if path_px is not None and velocity_px is not None and np.all(np.isfinite(path_px[k])):
                    guess[:2], motion = path_px[k], velocity_px[k]
                path = np.stack([frames.exposure_share * motion, np.zeros(2)])
                template = bank.get(seen_from_marker(path, model.warp, guess[2])[0])
            result = _best_fit(frames, k, model, template, [guess, *others])
            if k != first and not known:
                result = _confirmed(frames, k, model, template, result, guess, abs(k - seen_at))
            if result[kernel.CONVERGED] == 0.0:
                past = past[-1:]
                continue
            state, seen_at = result[:5].copy(), k
            past = [*past[-2:], state[:2].copy()]
            fitted[k], chi2[k] = state, result[kernel.CHI2]
    if not np.any(np.isfinite(chi2)):
        return None
    return replace(model, states=fitted, chi2=typical_chi2(chi2, fitted, frames.exposure_share))


def _confirmed(
    frames: CalibrationFrames,
    k: int,
    model: MarkerModel,
    template: Template,
    result: FloatArray,
    guess: FloatArray,
    lost: int,
) -> FloatArray:
    """Fit of a marker whose position was only guessed, failed where it is not the marker.

    Where it correlates poorly, a marker that no other looks like is searched for: within its own width, and farther
    when it was not found in the last `lost` frames.
    """
    kind = model.detection.kind
    if correlation(result) < ACCEPTANCE.least_correlation and (kind.decodes_shape or not kind.has_outline):
        size_px = model.detection.size_px
        reach = min(
            0.5 * size_px + max(ACCEPTANCE.reach_px, size_px) * min(lost, TUNING.most_lost),
            TUNING.farthest_px,
        )
        found = coarse_search(frames.images[k], guess[:2], reach, model.template, model.warp, float(guess[3]))
        if found is not None:
            other = _best_fit(frames, k, model, template, [np.append(found, guess[2:])])
            result = max(result, other, key=correlation)
    if not acceptable(result, float(guess[3]), TUNING.chi2_of_one_image, TUNING.least_while_learning):
        result[kernel.CONVERGED] = 0.0
    return result


def _velocity_px(path_px: FloatArray) -> FloatArray:
    """Motion per frame along a path, shape (n, 2); 0 where it is unknown."""
    return np.nan_to_num(np.gradient(path_px, axis=0)) if len(path_px) > 1 else np.zeros_like(path_px)


def _best_fit(
    frames: CalibrationFrames, k: int, model: MarkerModel, template: Template, starts: list[FloatArray]
) -> FloatArray:
    """The fit to frame k that correlates best, of those from starts more than a px apart."""
    best, used = np.full(kernel.RESULT, np.nan), list[FloatArray]()
    best[kernel.CONVERGED] = 0.0
    for start in starts:
        if any(np.hypot(*(start[:2] - other[:2])) < TUNING.apart_px for other in used):
            continue
        used.append(start)
        result = register(
            frames.images[k],
            start,
            model.warp,
            template,
            frames.camera,
            with_angle=model.detection.kind.angle_while_learning,
            max_shift_px=TUNING.shift_px + TUNING.shift_share * model.detection.size_px,
        )
        if correlation(result) > correlation(best):
            best = result
    return best


def normalised(states: FloatArray) -> FloatArray:
    """States with gain and offset relative to their medians: the learned template is in gray levels."""
    gain, offset = np.nanmedian(states[:, 3]), np.nanmedian(states[:, 4])
    out = states.copy()
    out[:, 3] = states[:, 3] / gain
    out[:, 4] = states[:, 4] - offset * out[:, 3]
    return out


def core_of(detection: Detection, template: Template) -> BoolArray:
    """Grid points that belong to the marker itself and not to its surroundings."""
    u, v = (np.abs(axis) for axis in template.axes_px())
    half = detection.kind.core_half_px(detection.size_px)
    return detection.kind.covers(u[None, :], v[:, None], half, half)


def without_background(frames: CalibrationFrames, first: MarkerModel) -> MarkerModel:
    """The model on the part of its window that moves as one object, with that object's motion.

    Background at rest biases the positions towards rest, and a finely sampled template learned from such positions
    reproduces the bias. Therefore the windows here have one grid point per px.
    """
    current = first
    for _ in range(TUNING.rounds):
        found = _object_motion(frames, current, first.template)
        if found is None:
            break
        window, motion, states = found
        settled = abs(motion.share - 1.0) < TUNING.settled * motion.sd
        if settled and np.array_equal(motion.support, current.template.support):
            break
        template = Template(window.coefs, motion.support, window.oversampling)
        updated = registered(
            frames, replace(current, template=template), states[first.detection.frame], states
        )
        if updated is None:
            break
        current = updated
    return current


def with_motion_sd(frames: CalibrationFrames, model: MarkerModel) -> MarkerModel:
    """The model with the relative standard deviation of its displacements and the share of its window left out."""
    window = model.detection.template
    found = _object_motion(frames, model, window)
    if found is None:
        return replace(model, motion_sd=np.inf)
    motion, left_out = found[1], 1.0 - model.template.area_px / window.area_px
    # A share that still differs from 1 may be an error of the share or of the motion.
    return replace(
        model, motion_sd=float(np.hypot(motion.sd, motion.share - 1.0)), left_out=max(left_out, 0.0)
    )


def _object_motion(
    frames: CalibrationFrames, model: MarkerModel, window: Template
) -> tuple[Template, ObjectMotion, FloatArray] | None:
    """Template of the whole window with one grid point per px, the object in it, and states with its motion."""
    states, noise = normalised(model.states), frames.camera.noise
    images, saturation = frames.images, frames.camera.saturation
    seen = np.flatnonzero(np.all(np.isfinite(states), axis=1))
    # Not evenly spaced: at the same phase of each cycle they would show too little of the motion.
    chosen = (
        np.random.default_rng(0).permutation(seen)[: TUNING.frames] if seen.size > TUNING.frames else seen
    )
    images, used = [images[k] for k in chosen], states[chosen]
    learned = learn_template(
        images, used, model.warp, window.support, noise, saturation, oversampling=window.oversampling
    )
    if learned is None:
        return None
    shares = motion_shares(images, used, model.warp, learned, noise)
    motion = object_motion(learned.support, learned.oversampling, shares, core_of(model.detection, learned))
    if motion.sd < TUNING.share_sd:
        states = scaled_motion(states, motion.share)
    return learned, motion, states


def notes_on_patches(models: tuple[MarkerModel, ...]) -> tuple[str, ...]:
    """What the user must know about the windows of patches, each a full sentence."""
    notes = []
    for model in models:
        name = model.detection.name
        if model.detection.kind.has_outline:
            continue
        if not np.isfinite(model.motion_sd):
            notes.append(
                f"Patch {name} moves too little in the first {len(model.states)} frames to tell it from background at "
                "rest, which makes displacements too small: choose a window inside the moving object, or begin with "
                "frames in which it moves."
            )
        elif model.left_out > TUNING.worth_a_note or model.motion_sd > TUNING.worth_a_note:
            notes.append(
                f"Patch {name}: {100.0 * model.left_out:.0f} % of its window does not move with it and is left out; "
                f"the size of its motion is known to {100.0 * model.motion_sd:.1f} %, which is part of the sd."
            )
    return tuple(notes)


def with_motion_errors(positions_px: FloatArray, sd_px: FloatArray, motion_sd: FloatArray) -> FloatArray:
    """Standard deviations, shape (n, m), that include the errors in the size of the markers' motion.

    `motion_sd`, shape (m,), are those errors relative to the motion, as in `MarkerModel`; infinite ones are left out.
    """
    relative = np.where(np.isfinite(motion_sd), motion_sd, 0.0)
    moved = positions_px - median_over_time(positions_px)
    return np.asarray(np.hypot(sd_px, relative * moved))


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
    chosen = seen[np.linspace(0, seen.size - 1, min(TUNING.warp_frames, seen.size)).astype(np.int64)]
    half_px = 0.5 * model.detection.size_px
    step, shear = TUNING.difference_px / half_px, np.zeros(2)
    for _ in range(TUNING.warp_steps):
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
            max_shift_px=TUNING.shift_px,
        )
        total += float(result[kernel.CHI2]) if result[kernel.CONVERGED] > 0.0 else np.inf
    return total / len(chosen)

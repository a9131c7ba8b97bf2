"""Patches: the part of the window that moves as one object, and the standard deviation of its motion's size."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tracker.arrays import FloatArray
from tracker.geometry import median_over_time
from tracker.register.calibration_frames import CalibrationFrames, core_of, normalised, registered
from tracker.register.marker import MarkerModel
from tracker.template import (
    ObjectMotion,
    Template,
    learn_template,
    motion_shares,
    object_motion,
    scaled_motion,
)

# Rounds in which the template of a window and the part of it that is the object are found.
ROUNDS = 4
# Frames from which they are found.
FRAMES = 32
# The fitted motion is multiplied by the object's share if the sd of the share is below this.
SHARE_SD = 0.03
# A share this close to 1, in sd, needs no further round.
SETTLED = 0.5
# Smaller shares of a window and relative errors are not mentioned.
WORTH_A_NOTE = 0.05


def without_background(frames: CalibrationFrames, first: MarkerModel) -> MarkerModel:
    """The model on the part of its window that moves as one object, with that object's motion.

    Background at rest biases the positions towards rest, and a finely sampled template learned from such positions
    reproduces the bias. Therefore the windows here have one grid point per px.
    """
    current = first
    for _ in range(ROUNDS):
        found = _object_motion(frames, current, first.template)
        if found is None:
            break
        window, motion, states = found
        settled = abs(motion.share - 1.0) < SETTLED * motion.sd
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
    chosen = np.random.default_rng(0).permutation(seen)[:FRAMES] if seen.size > FRAMES else seen
    images, used = [images[k] for k in chosen], states[chosen]
    learned = learn_template(
        images, used, model.warp, window.support, noise, saturation, oversampling=window.oversampling
    )
    if learned is None:
        return None
    shares = motion_shares(images, used, model.warp, learned, noise)
    motion = object_motion(learned.support, learned.oversampling, shares, core_of(model.detection, learned))
    if motion.sd < SHARE_SD:
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
        elif model.left_out > WORTH_A_NOTE or model.motion_sd > WORTH_A_NOTE:
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

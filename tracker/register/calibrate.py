"""From a first detection to a calibrated template: follow, learn, fit the model, keep what explains the pixels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tracker.arrays import FloatArray, GrayImage
from tracker.markers.base import Detection
from tracker.register import kernel
from tracker.register.marker import Camera, MarkerModel, contrast_state, reach_px, register
from tracker.template.blur import (
    LONGEST_PX,
    SMALLEST_PX,
    BlurBank,
    path_length_px,
    seen_from_marker,
    unblurred,
)
from tracker.template.ideal import fit_aruco, fit_disc, ideal_aruco
from tracker.template.learned import OVERSAMPLING, learn_template, residual_map, trimmed_support
from tracker.template.paths import moved_on, paths_px, sharp_states, usual_chi2
from tracker.template.spline import Template, grid_px

# Rounds of registering and learning: the start of a patch is one noisy picture, that of a marker a model.
ROUNDS = {"aruco": 2, "blob": 2, "patch": 4}
# A learned template bends to the noise it learns from, so its chi-square is a little too low.
PARAMETRIC_MARGIN = 1.06
# Where neither template fits, the marker changes its look; the model then stands for its mean better.
NEITHER_FITS = 3.0
# An ArUco marker larger than this is not learned: its model is fitted to its many pixels.
LARGEST_LEARNED_PX = 90.0


def calibrate(
    frames: list[GrayImage], detection: Detection, camera: Camera, exposure_share: float = 0.0
) -> MarkerModel | None:
    """Template of one marker from the first frames of a recording.

    Parameters
    ----------
    frames : list of arrays, shape (height, width)
        Neighbours in time.
    detection : Detection
        Its `frame` is an index of `frames`.
    exposure_share : float
        Exposure time over the time between frames; 0 when it is not known.

    Returns
    -------
    MarkerModel or None
        None when the marker cannot be registered in a single frame.
    """
    first = MarkerModel(
        detection=detection,
        template=detection.template,
        source="first picture",
        warp=detection.warp,
        refine=np.eye(2),
        centre_uv=np.zeros(2),
        with_angle=False,
        chi2=np.inf,
        states=np.full((len(frames), 5), np.nan),
    )
    if detection.kind == "aruco" and detection.size_px > LARGEST_LEARNED_PX:
        large = _large_aruco(frames, first, camera, exposure_share)
        return None if large is None else replace(large, with_angle=True)
    states, chi2 = _follow(
        frames,
        first,
        camera,
        contrast_state(frames[detection.frame], detection),
        exposure_share=exposure_share,
    )
    if not np.any(np.isfinite(chi2)):
        return None
    best = replace(first, chi2=usual_chi2(chi2, states, exposure_share), states=states)
    taught = _learn(frames, states, best, camera, exposure_share)
    if taught is None:
        return best
    learned, states = taught
    modelled = _model(frames, states, learned, camera, exposure_share)
    if modelled is not None:
        fits = modelled.chi2 <= PARAMETRIC_MARGIN * learned.chi2
        fits |= learned.chi2 > NEITHER_FITS and modelled.chi2 < 2.0 * learned.chi2
        if fits:
            learned = modelled
    return replace(
        learned, with_angle=_angle_is_settled(frames, learned, camera, sharp_states(states, exposure_share))
    )


def _follow(
    frames: list[GrayImage],
    model: MarkerModel,
    camera: Camera,
    start: FloatArray,
    known: FloatArray | None = None,
    *,
    exposure_share: float = 0.0,
) -> tuple[FloatArray, FloatArray]:
    """States (n, 5) and chi-squares (n,) of a marker in all frames, forward and backward from its detection.

    Where `known` states exist they are the starts, and their path during the exposure is the blur; else the states of
    the frames before, moved on.
    """
    n = len(frames)
    if known is not None and not np.all(np.isfinite(start)):
        # The frame of the detection itself was not fitted: the look of the nearest one that was.
        seen = np.flatnonzero(np.all(np.isfinite(known), axis=1))
        if seen.size:
            start = known[seen[np.argmin(np.abs(seen - model.detection.frame))]]
    states, chi2 = np.full((n, 5), np.nan), np.full(n, np.nan)
    bank = BlurBank(model.template, model.known)
    paths = None if known is None else paths_px(known, exposure_share)
    here = model.detection.frame
    for sequence in (range(here, n), range(here - 1, -1, -1)):
        past: list[FloatArray] = []
        state = start.copy()
        if sequence.step < 0 and np.isfinite(chi2[here]):
            state = states[here].copy()
            past = [s[:2].copy() for s in states[here : here + 3][::-1] if np.isfinite(s[0])]
        for k in sequence:
            guess, motion = state.copy(), np.zeros(2)
            if known is not None and paths is not None and np.all(np.isfinite(known[k])):
                guess = known[k].copy()
                template = bank.exact(seen_from_marker(paths[k], model.warp, guess[2]))
            else:
                if past:
                    guess[:2], motion = moved_on(past)
                path = np.stack([exposure_share * motion, np.zeros(2)])
                template = bank.get(seen_from_marker(path, model.warp, guess[2])[0])
            result = register(
                frames[k],
                guess,
                model.warp,
                template,
                camera,
                reach=reach_px(template, model.warp),
                with_angle=model.detection.kind == "aruco",
                max_shift_px=3.0 + 0.25 * model.detection.size_px,
            )
            if result[kernel.CONVERGED] == 0.0:
                past = past[-1:]
                continue
            state = result[:5].copy()
            past = [*past[-2:], state[:2].copy()]
            states[k], chi2[k] = state, result[kernel.CHI2]
    return states, chi2


def _normalised(states: FloatArray) -> FloatArray:
    """States whose gain and offset are relative to their medians: the learned picture is in gray levels."""
    gain, offset = np.nanmedian(states[:, 3]), np.nanmedian(states[:, 4])
    out = states.copy()
    out[:, 3] = states[:, 3] / gain
    out[:, 4] = states[:, 4] - offset * out[:, 3]
    return out


def _first_support(detection: Detection, beyond_px: float) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Support of the first template on the learned template's grid, and the same with its surroundings."""
    old = detection.template
    rows, cols = np.nonzero(old.support)
    centre = (np.array(old.support.shape) - 1) / 2
    half_v = float(np.abs(rows - centre[0]).max()) / old.oversampling
    half_u = float(np.abs(cols - centre[1]).max()) / old.oversampling
    u, v = grid_px(half_u + beyond_px, half_v + beyond_px, OVERSAMPLING)

    def within(more_px: float) -> NDArray[np.uint8]:
        if detection.kind == "blob":
            inside = np.hypot(v[:, None], u[None, :]) <= half_u + more_px
        else:
            inside = (np.abs(v)[:, None] <= half_v + more_px) & (np.abs(u)[None, :] <= half_u + more_px)
        return inside.astype(np.uint8)

    return within(0.0), within(beyond_px)


def _core(detection: Detection, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Grid points that are the marker itself and not its surroundings."""
    v = np.abs(np.arange(shape[0]) - 0.5 * (shape[0] - 1))[:, None] / OVERSAMPLING
    u = np.abs(np.arange(shape[1]) - 0.5 * (shape[1] - 1))[None, :] / OVERSAMPLING
    half = 0.5 * detection.size_px + 1.0
    if detection.kind == "blob":
        return np.asarray(np.hypot(u, v) <= half)
    if detection.kind == "patch":
        half = 0.25 * detection.size_px
    return np.asarray((u <= half) & (v <= half))


def _learn(
    frames: list[GrayImage], states: FloatArray, model: MarkerModel, camera: Camera, exposure_share: float
) -> tuple[MarkerModel, FloatArray] | None:
    """Alternate learning the picture and registering it; the support loses what moves otherwise."""
    beyond = _beyond_px(states, exposure_share)
    support, known = _first_support(model.detection, beyond)
    core = _core(model.detection, support.shape)
    current, found = model, None
    blurred: Template | None = None
    for _ in range(ROUNDS[model.detection.kind]):
        states = _normalised(states)
        sharp = sharp_states(states, exposure_share)
        start = None if blurred is None else blurred.coefs
        blurred = learn_template(frames, sharp, current.warp, known, camera.noise, camera.saturation, start)
        if blurred is None:
            return found
        known = trimmed_support(
            blurred, residual_map(frames, sharp, current.warp, blurred, camera.noise), core
        )
        support = np.ascontiguousarray(support * known)
        template = Template(
            _at_rest(blurred, states, sharp, current.warp, exposure_share).coefs, support, OVERSAMPLING
        )
        current = replace(current, template=template, source="learned", known=known if beyond else None)
        updated, chi2 = _follow(
            frames, current, camera, states[current.detection.frame], states, exposure_share=exposure_share
        )
        if not np.any(np.isfinite(chi2)):
            return found
        states = updated
        current = replace(current, chi2=usual_chi2(chi2, states, exposure_share), states=states)
        found = (current, states)
    return found


def _beyond_px(states: FloatArray, exposure_share: float) -> float:
    """How far beyond its support a marker's surroundings are mixed into it by the longest motion."""
    longest = max((path_length_px(p) for p in paths_px(states, exposure_share)), default=0.0)
    return min(longest, LONGEST_PX) + 1.0 if longest >= SMALLEST_PX else 0.0


def _at_rest(
    blurred: Template, states: FloatArray, sharp: FloatArray, warp: FloatArray, exposure_share: float
) -> Template:
    """The learned picture without the motion that is left in the sharpest frames."""
    seen = np.all(np.isfinite(sharp), axis=1)
    moving = zip(paths_px(states, exposure_share)[seen], states[seen, 2], strict=True)
    paths = [seen_from_marker(path, warp, angle) for path, angle in moving]
    if max(path_length_px(p) for p in paths) < SMALLEST_PX:
        return blurred
    return unblurred(blurred, paths)


def _model(
    frames: list[GrayImage], states: FloatArray, learned: MarkerModel, camera: Camera, exposure_share: float
) -> MarkerModel | None:
    """The parametric template fitted to the learned picture, and how well it explains the frames."""
    if learned.detection.kind == "aruco":
        fitted = fit_aruco(learned)
    elif learned.detection.kind == "blob":
        fitted = fit_disc(learned)
    else:
        return None
    if fitted is None:
        return None
    model, dark, light, shift = fitted
    moved = states.copy()
    # The learned picture's own zero lies `shift` off the marker's centre.
    turn = np.nanmedian(states[:, 2])
    cosine, sine = np.cos(turn), np.sin(turn)
    moved[:, :2] += np.linalg.inv(learned.warp) @ (np.array([[cosine, -sine], [sine, cosine]]) @ shift)
    moved[:, 4] = states[:, 4] + states[:, 3] * dark
    moved[:, 3] = states[:, 3] * (light - dark)
    moved, chi2 = _follow(
        frames, model, camera, moved[model.detection.frame], moved, exposure_share=exposure_share
    )
    if not np.any(np.isfinite(chi2)):
        return None
    return replace(model, chi2=usual_chi2(chi2, moved, exposure_share), states=moved)


def _large_aruco(
    frames: list[GrayImage], model: MarkerModel, camera: Camera, exposure_share: float
) -> MarkerModel | None:
    """The ideal marker fitted to the pixels of the frame of its detection: many pixels need no averaging."""
    detection = model.detection
    image = frames[detection.frame]
    reach = reach_px(model.template, model.warp)
    top, left = max(int(detection.y_px - reach), 0), max(int(detection.x_px - reach), 0)
    part = image[top : int(detection.y_px + reach) + 1, left : int(detection.x_px + reach) + 1]
    y, x = np.indices(part.shape)
    points = model.warp @ np.stack([x.ravel() + left - detection.x_px, y.ravel() + top - detection.y_px])
    inside = np.max(np.abs(points), axis=0) <= 0.5 * detection.size_px * (1.0 + 1.0 / 8.0)
    inside &= part.ravel() < camera.saturation
    fitted = ideal_aruco(model, points[:, inside], part.ravel()[inside].astype(np.float64))
    if fitted is None:
        return None
    ideal, dark, light, shift = fitted
    centre = np.array([detection.x_px, detection.y_px]) + np.linalg.inv(model.warp) @ shift
    start = np.array([centre[0], centre[1], 0.0, light - dark, dark])
    states, chi2 = _follow(frames, ideal, camera, start, exposure_share=exposure_share)
    if not np.any(np.isfinite(chi2)):
        return None
    return replace(ideal, chi2=usual_chi2(chi2, states, exposure_share), states=states)


def _angle_is_settled(
    frames: list[GrayImage], model: MarkerModel, camera: Camera, states: FloatArray
) -> bool:
    """Whether freeing the angle costs the position less than a third of its standard deviation."""
    if model.detection.kind == "blob":
        return False
    seen = np.flatnonzero(np.all(np.isfinite(states), axis=1))
    if seen.size == 0:
        return False
    k = int(seen[0])
    start = states[k].copy()
    if model.source == "parametric":
        start = contrast_state(frames[k], replace(model.detection, x_px=start[0], y_px=start[1]))
    sds = []
    for with_angle in (False, True):
        result = register(
            frames[k],
            start,
            model.warp,
            model.template,
            camera,
            reach=reach_px(model.template, model.warp),
            with_angle=with_angle,
            max_shift_px=3.0,
        )
        sds.append(np.hypot(result[kernel.SD_X], result[kernel.SD_Y]))
    return bool(sds[1] <= 1.3 * sds[0])

"""From a first sighting to a calibrated template: follow, learn, fit the model, keep what explains the pixels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from tracker.find.finder import Sighting
from tracker.registration import kernel
from tracker.registration.blur import (
    LONGEST_PX,
    SMALLEST_PX,
    BlurBank,
    exposed_path_px,
    path_length_px,
    seen_from_marker,
    unblurred,
    widened,
)
from tracker.registration.learned import OVERSAMPLING, learn_template, residual_map, trimmed_support
from tracker.registration.model import Camera, MarkerModel, contrast_state, reach_px, register
from tracker.registration.parametric import aruco_template, aruco_values, disc_template, disc_values
from tracker.registration.template import Template, grid_px
from tracker.series import FloatArray
from tracker.source import GrayImage

# Rounds of registering and learning: the start of a patch is one noisy picture, that of a marker a model.
ROUNDS = {"aruco": 2, "blob": 2, "patch": 4}
# A learned template bends to the noise it learns from, so its chi-square is a little too low.
PARAMETRIC_MARGIN = 1.06
# Where neither template fits, the marker changes its look; the model then stands for its mean better.
NEITHER_FITS = 3.0
# An ArUco marker larger than this is not learned: its model is fitted to its many pixels.
LARGEST_LEARNED_PX = 90.0
POINTS_FOR_SHAPE = 1500
# Frames with as little motion during the exposure as can be had, from which a template is learned.
LEAST_SHARP = 12


def calibrate(
    frames: list[GrayImage], sighting: Sighting, camera: Camera, exposure_share: float = 0.0
) -> MarkerModel | None:
    """Template of one marker from the first frames of a recording.

    Parameters
    ----------
    frames : list of arrays, shape (height, width)
        Neighbours in time.
    sighting : Sighting
        Its `frame` is an index of `frames`.
    exposure_share : float
        Exposure time over the time between frames; 0 when it is not known.

    Returns
    -------
    MarkerModel or None
        None when the marker cannot be registered in a single frame.
    """
    first = MarkerModel(
        sighting=sighting,
        template=sighting.template,
        source="first picture",
        warp=sighting.warp,
        refine=np.eye(2),
        centre_uv=np.zeros(2),
        with_angle=False,
        chi2=np.inf,
        states=np.full((len(frames), 5), np.nan),
    )
    if sighting.kind == "aruco" and sighting.size_px > LARGEST_LEARNED_PX:
        large = _large_aruco(frames, first, camera, exposure_share)
        return None if large is None else replace(large, with_angle=True)
    states, chi2 = _follow(
        frames, first, camera, contrast_state(frames[sighting.frame], sighting), exposure_share=exposure_share
    )
    if not np.any(np.isfinite(chi2)):
        return None
    best = replace(first, chi2=_usual_chi2(chi2, states, exposure_share), states=states)
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
    """States (n, 5) and chi-squares (n,) of a marker in all frames, forward and backward from its sighting.

    Where `known` states exist they are the starts, and their path during the exposure is the blur; else the states of
    the frames before, moved on.
    """
    n = len(frames)
    if known is not None and not np.all(np.isfinite(start)):
        # The frame of the sighting itself was not fitted: the look of the nearest one that was.
        seen = np.flatnonzero(np.all(np.isfinite(known), axis=1))
        if seen.size:
            start = known[seen[np.argmin(np.abs(seen - model.sighting.frame))]]
    states, chi2 = np.full((n, 5), np.nan), np.full(n, np.nan)
    bank = BlurBank(model.template, model.known)
    paths = None if known is None else paths_px(known, exposure_share)
    here = model.sighting.frame
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
                    guess[:2], motion = _moved_on(past)
                path = np.stack([exposure_share * motion, np.zeros(2)])
                template = bank.get(seen_from_marker(path, model.warp, guess[2])[0])
            result = register(
                frames[k],
                guess,
                model.warp,
                template,
                camera,
                reach=reach_px(template, model.warp),
                with_angle=model.sighting.kind == "aruco",
                max_shift_px=3.0 + 0.25 * model.sighting.size_px,
            )
            if result[kernel.CONVERGED] == 0.0:
                past = past[-1:]
                continue
            state = result[:5].copy()
            past = [*past[-2:], state[:2].copy()]
            states[k], chi2[k] = state, result[kernel.CHI2]
    return states, chi2


def _moved_on(past: list[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Next position by the polynomial through up to three positions, and the motion from frame to frame there."""
    last = past[-1]
    if len(past) == 1:
        return last, np.zeros(2)
    if len(past) == 2:
        return 2.0 * last - past[0], last - past[0]
    ahead = 3.0 * last - 3.0 * past[1] + past[0]
    return ahead, 0.5 * (ahead - past[1]) + (ahead - 2.0 * last + past[1])


def _motion(states: FloatArray) -> FloatArray:
    """Motion from frame to frame at each frame, by differences over four or two; 0 where a neighbour is missing."""
    motion = np.zeros((len(states), 2))
    if len(states) > 2:
        motion[1:-1] = 0.5 * (states[2:, :2] - states[:-2, :2])
        if len(states) > 4:
            wider = (4.0 * motion[2:-2] - 0.25 * (states[4:, :2] - states[:-4, :2])) / 3.0
            motion[2:-2] = np.where(np.isfinite(wider), wider, motion[2:-2])
        motion[0], motion[-1] = 2.0 * motion[1] - motion[2], 2.0 * motion[-2] - motion[-3]
    return np.where(np.isfinite(motion), motion, 0.0)


def _bend(states: FloatArray) -> FloatArray:
    """Second difference of the position at each frame; 0 where a neighbour is missing."""
    bend = np.zeros((len(states), 2))
    if len(states) > 2:
        bend[1:-1] = states[2:, :2] - 2.0 * states[1:-1, :2] + states[:-2, :2]
        bend[0], bend[-1] = bend[1], bend[-2]
    return np.where(np.isfinite(bend), bend, 0.0)


def path_derivatives_px(states: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Motion from frame to frame and its change at each frame, both of shape (n, 2); 0 where they are not known."""
    return _motion(states), _bend(states)


def paths_px(states: FloatArray, exposure_share: float) -> FloatArray:
    """Path during the exposure of each frame, shape (n, 2, 2); see `tracker.registration.blur.exposed_path_px`."""
    motion, bend = path_derivatives_px(states)
    return np.array([exposed_path_px(m, b, exposure_share) for m, b in zip(motion, bend, strict=True)])


def sharp_states(states: FloatArray, exposure_share: float) -> FloatArray:
    """States without those of blurred frames, as long as enough sharp ones are there."""
    if exposure_share == 0.0:
        return states
    length = np.array([path_length_px(p) for p in paths_px(states, exposure_share)])
    seen = np.all(np.isfinite(states), axis=1)
    if not seen.any():
        return states
    enough = float(np.sort(length[seen])[min(LEAST_SHARP, int(np.count_nonzero(seen))) - 1])
    return np.where((length <= max(enough, SMALLEST_PX))[:, None], states, np.nan)


def _usual_chi2(chi2: FloatArray, states: FloatArray, exposure_share: float) -> float:
    """Median of chi-square where nothing hangs on a few frames.

    A picture learned from a dozen sharp frames holds their noise and explains them too well: the next sharpest count,
    where there are as many. Without blur it is learned from many, and all count.
    """
    fitted = np.isfinite(chi2)
    learned = np.all(np.isfinite(sharp_states(states, exposure_share)), axis=1) & fitted
    others = np.flatnonzero(fitted & ~learned)
    if others.size < LEAST_SHARP:
        return float(np.nanmedian(chi2))
    length = np.array([path_length_px(p) for p in paths_px(states, exposure_share)])
    return float(np.median(chi2[others[np.argsort(length[others])[: 2 * LEAST_SHARP]]]))


def _normalised(states: FloatArray) -> FloatArray:
    """States whose gain and offset are relative to their medians: the learned picture is in gray levels."""
    gain, offset = np.nanmedian(states[:, 3]), np.nanmedian(states[:, 4])
    out = states.copy()
    out[:, 3] = states[:, 3] / gain
    out[:, 4] = states[:, 4] - offset * out[:, 3]
    return out


def _first_support(sighting: Sighting, beyond_px: float) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Support of the first template on the learned template's grid, and the same with its surroundings."""
    old = sighting.template
    rows, cols = np.nonzero(old.support)
    centre = (np.array(old.support.shape) - 1) / 2
    half_v = float(np.abs(rows - centre[0]).max()) / old.oversampling
    half_u = float(np.abs(cols - centre[1]).max()) / old.oversampling
    u, v = grid_px(half_u + beyond_px, half_v + beyond_px, OVERSAMPLING)

    def within(more_px: float) -> NDArray[np.uint8]:
        if sighting.kind == "blob":
            inside = np.hypot(v[:, None], u[None, :]) <= half_u + more_px
        else:
            inside = (np.abs(v)[:, None] <= half_v + more_px) & (np.abs(u)[None, :] <= half_u + more_px)
        return inside.astype(np.uint8)

    return within(0.0), within(beyond_px)


def _core(sighting: Sighting, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Grid points that are the marker itself and not its surroundings."""
    v = np.abs(np.arange(shape[0]) - 0.5 * (shape[0] - 1))[:, None] / OVERSAMPLING
    u = np.abs(np.arange(shape[1]) - 0.5 * (shape[1] - 1))[None, :] / OVERSAMPLING
    half = 0.5 * sighting.size_px + 1.0
    if sighting.kind == "blob":
        return np.asarray(np.hypot(u, v) <= half)
    if sighting.kind == "patch":
        half = 0.25 * sighting.size_px
    return np.asarray((u <= half) & (v <= half))


def _learn(
    frames: list[GrayImage], states: FloatArray, model: MarkerModel, camera: Camera, exposure_share: float
) -> tuple[MarkerModel, FloatArray] | None:
    """Alternate learning the picture and registering it; the support loses what moves otherwise."""
    beyond = _beyond_px(states, exposure_share)
    support, known = _first_support(model.sighting, beyond)
    core = _core(model.sighting, support.shape)
    current, found = model, None
    blurred: Template | None = None
    for _ in range(ROUNDS[model.sighting.kind]):
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
            frames, current, camera, states[current.sighting.frame], states, exposure_share=exposure_share
        )
        if not np.any(np.isfinite(chi2)):
            return found
        states = updated
        current = replace(current, chi2=_usual_chi2(chi2, states, exposure_share), states=states)
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
    if learned.sighting.kind == "aruco":
        fitted = _fit_aruco(learned)
    elif learned.sighting.kind == "blob":
        fitted = _fit_disc(learned)
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
        frames, model, camera, moved[model.sighting.frame], moved, exposure_share=exposure_share
    )
    if not np.any(np.isfinite(chi2)):
        return None
    return replace(model, chi2=_usual_chi2(chi2, moved, exposure_share), states=moved)


def _grid_of(template: Template) -> tuple[FloatArray, FloatArray]:
    rows, cols = template.coefs.shape
    u = (np.arange(cols) - 0.5 * (cols - 1)) / template.oversampling
    v = (np.arange(rows) - 0.5 * (rows - 1)) / template.oversampling
    return u, v


def _fit_aruco(learned: MarkerModel) -> tuple[MarkerModel, float, float, FloatArray] | None:
    """The ideal marker that the learned picture shows."""
    u, v = _grid_of(learned.template)
    inside = learned.template.support > 0
    points = np.stack([a[inside] for a in np.meshgrid(u, v)])
    fitted = _ideal_aruco(learned, points, learned.template.values()[inside])
    if fitted is None:
        return None
    model, dark, light, shift = fitted
    matrix = model.warp @ np.linalg.inv(learned.warp)
    return _with_support_of(model, learned, matrix, shift), dark, light, shift


def _ideal_aruco(
    model: MarkerModel, points_uv: FloatArray, picture: FloatArray
) -> tuple[MarkerModel, float, float, FloatArray] | None:
    """Affine map, blur and the two gray levels of the ideal marker behind scattered gray levels.

    Parameters
    ----------
    points_uv : array, shape (2, n)
        In px of the model's frame.
    picture : array, shape (n,)

    Returns
    -------
    tuple or None
        The parametric model, dark and light gray level, and its centre in the frame of `model`; None when
        the fit left the marker's neighbourhood.
    """
    sighting = model.sighting
    if sighting.bits is None:
        return None
    bits = sighting.bits
    every = max(1, points_uv.shape[1] // POINTS_FOR_SHAPE)
    points, gray = points_uv[:, ::every], picture[::every]
    low, high = np.percentile(gray, (10, 90))

    def residual(p: FloatArray) -> FloatArray:
        matrix = np.array([[1.0 + p[2], p[3]], [p[4], 1.0 + p[5]]])
        at = matrix @ (points - p[:2, None])
        ideal = aruco_values(at[0], at[1], bits, sighting.size_px, np.exp(p[6]))
        return np.asarray((p[7] + (p[8] - p[7]) * ideal - gray) / max(high - low, 1e-9))

    start = np.array([0, 0, 0, 0, 0, 0, np.log(0.7), low, high])
    scales = [1, 1, 0.1, 0.1, 0.1, 0.1, 1, 50, 50]
    fit = least_squares(residual, start, method="lm", x_scale=scales, max_nfev=120, ftol=1e-6, xtol=1e-6)
    matrix = np.eye(2) + fit.x[2:6].reshape(2, 2)
    blur = float(np.exp(fit.x[6]))
    if not 0.6 < np.linalg.det(matrix) < 1.6 or blur > 0.3 * sighting.size_px or fit.x[8] <= fit.x[7]:
        return None
    ideal = replace(
        model,
        template=aruco_template(bits, sighting.size_px, blur),
        source="parametric",
        warp=matrix @ model.warp,
        refine=matrix @ model.refine,
        centre_uv=np.zeros(2),
    )
    return ideal, float(fit.x[7]), float(fit.x[8]), fit.x[:2]


def _large_aruco(
    frames: list[GrayImage], model: MarkerModel, camera: Camera, exposure_share: float
) -> MarkerModel | None:
    """The ideal marker fitted to the pixels of the frame of its sighting: many pixels need no averaging."""
    sighting = model.sighting
    image = frames[sighting.frame]
    reach = reach_px(model.template, model.warp)
    top, left = max(int(sighting.y_px - reach), 0), max(int(sighting.x_px - reach), 0)
    part = image[top : int(sighting.y_px + reach) + 1, left : int(sighting.x_px + reach) + 1]
    y, x = np.indices(part.shape)
    points = model.warp @ np.stack([x.ravel() + left - sighting.x_px, y.ravel() + top - sighting.y_px])
    inside = np.max(np.abs(points), axis=0) <= 0.5 * sighting.size_px * (1.0 + 1.0 / 8.0)
    inside &= part.ravel() < camera.saturation
    fitted = _ideal_aruco(model, points[:, inside], part.ravel()[inside].astype(np.float64))
    if fitted is None:
        return None
    ideal, dark, light, shift = fitted
    centre = np.array([sighting.x_px, sighting.y_px]) + np.linalg.inv(model.warp) @ shift
    start = np.array([centre[0], centre[1], 0.0, light - dark, dark])
    states, chi2 = _follow(frames, ideal, camera, start, exposure_share=exposure_share)
    if not np.any(np.isfinite(chi2)):
        return None
    return replace(ideal, chi2=_usual_chi2(chi2, states, exposure_share), states=states)


def _fit_disc(learned: MarkerModel) -> tuple[MarkerModel, float, float, FloatArray] | None:
    """Radius, blur and gray levels of the ideal dot that the learned picture shows."""
    u, v = _grid_of(learned.template)
    inside = learned.template.support > 0
    values = learned.template.values()
    picture = values[inside]
    middle = values[np.hypot(v[:, None], u[None, :]) < 0.25 * learned.sighting.size_px]
    centre_level = float(np.median(middle))
    rim_level = float(np.percentile(picture, 90 if centre_level < np.median(picture) else 10))
    span = max(abs(centre_level - rim_level), 1e-9)

    def residual(p: FloatArray) -> FloatArray:
        ideal = disc_values(u - p[0], v - p[1], p[2], np.exp(p[3]))[inside]
        return np.asarray((p[4] + (p[5] - p[4]) * ideal - picture) / span)

    start = np.array([0, 0, 0.5 * learned.sighting.size_px, np.log(0.7), rim_level, centre_level])
    fit = least_squares(
        residual, start, method="lm", x_scale=[1, 1, 1, 1, 50, 50], max_nfev=120, ftol=1e-6, xtol=1e-6
    )
    radius, blur = float(fit.x[2]), float(np.exp(fit.x[3]))
    if not 0.25 < radius / learned.sighting.size_px < 1.0 or blur > radius:
        return None
    template = disc_template(radius, blur)
    sighting = replace(learned.sighting, size_px=2.0 * radius)
    model = replace(learned, sighting=sighting, template=template, source="parametric", centre_uv=np.zeros(2))
    model = _with_support_of(model, learned, np.eye(2), fit.x[:2])
    return model, float(fit.x[4]), float(fit.x[5]), fit.x[:2]


def _with_support_of(
    model: MarkerModel, learned: MarkerModel, matrix: FloatArray, shift: FloatArray
) -> MarkerModel:
    """Parametric model that leaves out what the learned one had to leave out."""
    template, old = model.template, learned.template
    known = None
    if learned.known is not None:
        half = [(t.support.shape[0] - 1) / (2.0 * t.oversampling) for t in (old, template)]
        template = widened(template, max(half[0] - half[1], 0.0))
    u, v = _grid_of(template)
    points = np.linalg.inv(matrix) @ np.stack([a.ravel() for a in np.meshgrid(u, v)]) + shift[:, None]
    kept = _at_points(old, old.support if learned.known is None else learned.known, points)
    kept = kept.reshape(template.support.shape)
    if learned.known is not None:
        known = kept
    support = np.ascontiguousarray(template.support * kept)
    return replace(model, template=Template(template.coefs, support, template.oversampling), known=known)


def _at_points(template: Template, mask: NDArray[np.uint8], points: FloatArray) -> NDArray[np.uint8]:
    """A mask on the template's grid at points of its frame, shape (2, n); 0 beyond the grid."""
    rows, cols = mask.shape
    col = np.rint(points[0] * template.oversampling + 0.5 * (cols - 1)).astype(np.int64)
    row = np.rint(points[1] * template.oversampling + 0.5 * (rows - 1)).astype(np.int64)
    inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
    kept = np.zeros(points.shape[1], dtype=np.uint8)
    kept[inside] = mask[row[inside], col[inside]]
    return kept


def _angle_is_settled(
    frames: list[GrayImage], model: MarkerModel, camera: Camera, states: FloatArray
) -> bool:
    """Whether freeing the angle costs the position less than a third of its standard deviation."""
    if model.sighting.kind == "blob":
        return False
    seen = np.flatnonzero(np.all(np.isfinite(states), axis=1))
    if seen.size == 0:
        return False
    k = int(seen[0])
    start = states[k].copy()
    if model.source == "parametric":
        start = contrast_state(frames[k], replace(model.sighting, x_px=start[0], y_px=start[1]))
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

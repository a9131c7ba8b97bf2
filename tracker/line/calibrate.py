"""Calibration of a line on the first frames: where it is, and its profile, learned in rounds."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from tracker.arrays import BoolArray, FloatArray, GrayImage
from tracker.checks import Failure
from tracker.line import kernel
from tracker.line.follower import Fit, FoundPath, LineFollower, centred, find_path, straightened
from tracker.line.light import learned_light
from tracker.line.model import TUNING as MODEL
from tracker.line.model import Centreline, CurveAt, LineModel, learned_background, resampled, smoothed
from tracker.line.profile import STEP_PX, ProfileSums, add_to_profile, middle_px, node_weights, width_px


@dataclass(frozen=True)
class Tuning:
    """Calibration of a line."""

    #: [px] of line for each station, unless their number is given
    spacing_px: float = 5.0
    #: [stations] at least
    #: convention: as few as the settings accept
    least_stations: int = 6
    #: [stations] at most, unless their number is given
    #: convention: limits time
    most_stations: int = 200
    #: [px] search across the given line, at least
    least_reach_px: float = 12.0
    #: [1] search across it, as a share of its length where the line is curved
    reach_share: float = 0.2
    #: [px] accuracy of given ends
    #: convention: a hand places them to a few px
    ends_px: float = 6.0
    #: [px] of surface on either side of a strip in its window
    flank_px: float = 4.0
    #: [px] of surface on either side of an edge
    #: measurement: it tells the levels of both surfaces, which the displacement depends on: with 10 px its sd is 1.06
    #: of that for known levels, with 6 px 1.11
    edge_flank_px: float = 10.0
    #: [px] beyond the window up to which the profile is learned
    #: convention: for blur and for the first steps of a fit
    beyond_px: float = 3.0
    #: [rounds] in which the profile is learned
    #: convention: they end when settled
    most_rounds: int = 24
    #: [sd] change of the profile, of the standard deviation of a station, below which it is learned
    #: statistics: its square is far below the variance of a station
    settled: float = 0.02
    #: [stations] for each node of the profile along the line, at least
    stations_per_node: int = 12
    #: [nodes] of the profile
    most_nodes: int = 6
    #: [1] limit of the usual chi-square before the background is known
    #: convention: what a textured background adds must not reject the stations
    largest_first_chi2: float = 10.0
    #: [sd] contrast of the path above the noise of a pixel
    #: statistics: noise alone exceeds it in one place of 740
    least_contrast_sd: float = 3.0
    #: [1] share of the path that must have that contrast
    least_seen: float = 0.75
    #: [px] distance of the given ends within which the ends are searched for
    #: convention: twice the accuracy of given ends and more
    end_px: float = 14.0
    #: [px] of image beyond them that are needed
    end_least_px: float = 4.0
    #: [1] contrast beyond an end, at most
    #: convention: half of that of the end itself
    end_contrast: float = 0.25
    #: [1] points of the polyline over which the slope at an end is taken
    end_slope: int = 12
    #: [1] points of the polyline
    #: convention: finer than a px up to 400 px of length
    polyline: int = 400
    #: [px] motion that may be left out when a profile is learned, rms, beside as much as the noise of the stations
    #: convention: below the usual sd of a station
    motion_left_px: float = 0.005
    #: [1] share of the first frames in which the line must be followed
    least_followed: float = 0.5
    #: [px] profiles are learned from frames with less blur, where there are enough
    sharp_px: float = 0.3


TUNING = Tuning()

Feature = Literal["strip", "edge", "auto"]


def calibrate_line(
    images: list[GrayImage],
    ends_px: FloatArray,
    camera: FloatArray,
    *,
    stations: int | None = None,
    feature: Feature = "auto",
    exposure_share: float = 0.0,
) -> LineModel | Failure:
    """Centreline and profile of a line.

    Parameters
    ----------
    images : list of array
        Consecutive first frames.
    ends_px : array, shape (2, 2)
        Clamped end and free end in the first image, to a few px.
    camera : array, shape (3,)
        Variance a + b I of a pixel of intensity I, and the level of saturation.
    stations : int or None
        Number of stations; one for each 5 px without it.
    """
    curve, path = _first_path(images[0], ends_px, feature)
    noise = float(np.sqrt(camera[0] + camera[1] * np.mean(images[0])))
    seen = float(np.mean(path.contrast > TUNING.least_contrast_sd * noise))
    if seen < TUNING.least_seen:
        words = "strip or edge" if feature == "auto" else feature
        return Failure(
            f"no {words} was found along line_px in the first frame: only {100.0 * seen:.0f} % of it stands out from "
            f"both sides, with a noise of {noise:.1f} gray levels; give the ends of a line that does, in that frame"
        )
    # Beyond the end of a strip the path wanders.
    weights = np.clip(path.contrast / np.median(path.contrast), 0.01, 1.0) ** 2
    rough = curve.points + path.offsets_px[:, None] * curve.normals
    rough = centred(images[0], smoothed(rough, weights, MODEL.least_wide_splines), path, TUNING.flank_px)
    points, length_px = resampled(
        _to_the_ends(smoothed(rough, weights, MODEL.most_wide_splines)), TUNING.polyline
    )
    points, length_px, tip_seen = _to_the_end(images[0], points, length_px, path)
    back, length_px, clamp_seen = _to_the_end(images[0], points[::-1], length_px, path)
    points, length_px = _without_ends(back[::-1], length_px)
    count = stations or int(
        np.clip(round(length_px / TUNING.spacing_px), TUNING.least_stations, TUNING.most_stations)
    )
    line = Centreline(length_px, count)
    start = line.from_points(resampled(points, 2 * count + 1)[0])
    model = replace(
        _first_model(images[0], line, start, path, camera),
        exposure_share=exposure_share,
        ends_seen=(clamp_seen, tip_seen),
    )
    return _refined(images, model) or Failure(
        f"the {path.feature} along line_px was found in the first frame, but could not be followed: its profile "
        "changes along the line or from frame to frame"
    )


def _to_the_ends(points_px: FloatArray) -> FloatArray:
    """Middles of equal parts of a line, extended by half a part at both ends."""
    first = 1.5 * points_px[0] - 0.5 * points_px[1]
    last = 1.5 * points_px[-1] - 0.5 * points_px[-2]
    return np.concatenate([first[None], points_px, last[None]])


def _without_ends(points_px: FloatArray, length_px: float) -> tuple[FloatArray, float]:
    """The line without two px at both ends, where lens and clamp change the profile."""
    arc = np.linspace(0.0, length_px, len(points_px))
    at = np.linspace(MODEL.inset_px, length_px - MODEL.inset_px, TUNING.polyline)
    return np.stack([np.interp(at, arc, c) for c in points_px.T], axis=1), length_px - 2.0 * MODEL.inset_px


def _to_the_end(
    image: GrayImage, points_px: FloatArray, length_px: float, path: FoundPath
) -> tuple[FloatArray, float, bool]:
    """The line up to where a strip is seen to end near the last point: points, length, and whether it is.

    At a free end, or where it enters a clamp that hides it or looks like it.
    """
    outward = points_px[-1] - points_px[-1 - TUNING.end_slope]
    outward /= np.linalg.norm(outward)
    beyond = np.arange(-TUNING.end_px, TUNING.end_px + 1.0)
    at = points_px[-1] + beyond[:, None] * outward
    inside = np.all((at >= 0) & (at <= np.array(image.shape[::-1]) - 1), axis=1)
    beyond, at = beyond[inside], at[inside]
    if path.feature == "edge" or beyond[0] > -TUNING.end_px or beyond[-1] < TUNING.end_least_px:
        return points_px, length_px, False
    half = 0.5 * path.width_px
    curve = CurveAt(at, np.tile(outward, (len(at), 1)), np.zeros(len(at)), np.ones(len(at)))
    levels = straightened(image, curve, int(np.ceil(half + TUNING.flank_px)), 1.0)
    across = np.abs(np.arange(levels.shape[1]) - levels.shape[1] // 2)
    contrast = levels[:, across <= max(half - 0.5, 0.5)].mean(axis=1) - levels[:, across > half + 1.0].mean(
        axis=1
    )
    contrast = contrast / np.median(contrast[: int(TUNING.end_px) // 2])
    ended = contrast < 0.5
    # The strip ends once, and well before the last place.
    if (
        not np.any(ended)
        or not np.all(ended[np.argmax(ended) :])
        or np.mean(contrast[-4:]) > TUNING.end_contrast
    ):
        return points_px, length_px, False
    k = int(np.argmax(ended))
    if k == 0:
        return points_px, length_px, False
    end = beyond[k - 1] + (contrast[k - 1] - 0.5) / (contrast[k - 1] - contrast[k])
    arc = np.linspace(0.0, length_px, len(points_px))
    kept = points_px[arc < length_px + min(end, 0.0)]
    points, length = resampled(np.concatenate([kept, (points_px[-1] + end * outward)[None]]), TUNING.polyline)
    return points, length, True


def _refined(images: list[GrayImage], model: LineModel) -> LineModel | None:
    """The model after rounds of following the line and learning its profile; None where it is lost.

    Where few of its pixels differ in their position relative to the line, as along a line at rest in the direction of
    the pixels, the profile converges slowly.
    """
    across = np.arange(-model.half_across_px, model.half_across_px, 0.1)
    for _ in range(TUNING.most_rounds):
        learned = _learned(images, model, 1, must_begin=False)
        if learned is None:
            return None
        before, after = model.profile.values(across), learned[0].profile.values(across)
        change_px = np.sqrt(np.mean((after - before) ** 2)) / (
            np.sqrt(np.mean(np.gradient(after, 0.1) ** 2)) + 1e-9
        )
        model, sd_px = learned
        if change_px < TUNING.settled * sd_px:
            break
    nodes = int(np.clip(model.line.stations // TUNING.stations_per_node, 1, TUNING.most_nodes))
    learned = _learned(images, model, nodes, must_begin=True)
    return None if learned is None else _with_light(images, learned[0])


def _with_light(images: list[GrayImage], model: LineModel) -> LineModel:
    """The model with the light of an edge, which the displacement depends on."""
    if model.feature != "edge":
        return model
    follower, results, used = LineFollower(model), [], []
    for image in images:
        follower.step(image)
        if follower.fit is not None:
            results.append(follower.fit.results)
            used.append(follower.fit.accepted)
    if not used:
        return model
    return replace(model, light=learned_light(np.stack(results), np.stack(used), model.line.off_smooth))


def _first_path(image: GrayImage, ends_px: FloatArray, feature: Feature) -> tuple[CurveAt, FoundPath]:
    """The path along the straight line between the given ends."""
    length = float(np.linalg.norm(ends_px[1] - ends_px[0]))
    spacing = 4.0
    count = max(int(length / spacing), 4)
    share = (np.arange(count) + 0.5) / count
    tangent = (ends_px[1] - ends_px[0]) / length
    curve = CurveAt(
        ends_px[0] + share[:, None] * (ends_px[1] - ends_px[0]),
        np.tile(tangent, (count, 1)),
        np.zeros(count),
        np.ones(count),
    )
    reach = int(max(TUNING.least_reach_px, TUNING.reach_share * length)) + 40
    across = straightened(image, curve, reach, 0.5 * spacing)
    return curve, find_path(across, length / count, feature, TUNING.ends_px)


def _first_model(
    image: GrayImage, line: Centreline, start: FloatArray, path: FoundPath, camera: FloatArray
) -> LineModel:
    """The model whose profile consists of the pixels around the first path."""
    half = TUNING.edge_flank_px if path.feature == "edge" else 0.5 * path.width_px + TUNING.flank_px + 2.0
    sums = ProfileSums(half + TUNING.beyond_px, 1)
    # Without pixels, of the right shape.
    model = LineModel(line, start, sums.solve(), path.feature, half, camera, np.ones(line.stations))
    states = np.tile([0.0, 1.0, 0.0], (line.stations, 1))
    model = _with_profile(model, sums, [image], [_wider(model.stations(start))], [states])
    # A textured background is not yet known: what it adds must not reject the stations.
    results = np.empty((line.stations, kernel.RESULT))
    view = model.stations(model.start)
    kernel.register_line(
        image, view, model.profiles(), camera, model.background, states, model.half_across_px, results
    )
    chi2 = np.clip(np.nanmedian(results[:, kernel.CHI2]), 1.0, TUNING.largest_first_chi2)
    return replace(model, typical_chi2=np.full(line.stations, chi2))


def _learned(
    images: list[GrayImage], model: LineModel, nodes: int, *, must_begin: bool
) -> tuple[LineModel, float] | None:
    """The model with its start and its profile learned again from all frames, and the typical sd of a station, px.

    None where the line is lost in too many frames, or in the first one if it `must_begin` there: a first profile, of
    one frame, may be too poor for that.
    """
    follower, line = LineFollower(model), model.line
    used, fits, frames, first_seen = [], [], [], True
    for index, image in enumerate(images):
        follower.step(image)
        if follower.fit is not None:
            used.append(image)
            fits.append(follower.fit)
            frames.append(index)
        elif not fits:
            first_seen = False
    if len(fits) < TUNING.least_followed * len(images) or (must_begin and not first_seen):
        return None
    results = np.stack([np.where(fit.accepted[:, None], fit.results, np.nan) for fit in fits])
    states = _normalised(results[:, :, : kernel.STATE])
    states[:, :, kernel.SHIFT] = _smooth_shifts(line, fits, states[:, :, kernel.SHIFT])
    largest_step_px = _largest_step_px(fits, states[:, :, kernel.SHIFT], np.diff(frames) == 1)
    states[_too_blurred(np.stack([fit.stations.blur for fit in fits]))] = np.nan
    sums = ProfileSums(model.half_across_px + TUNING.beyond_px, nodes)
    views = [_wider(fit.stations) for fit in fits]
    learned = _with_profile(model, sums, used, views, list(states))
    moved_px = learned.profile.first_px - sums.first_px
    for state in states:
        state[:, kernel.SHIFT] -= moved_px
    background = learned_background(used, views, list(states), learned)
    start = follower.moved(fits[0].coefs, fits[0].smooth - moved_px) if first_seen else model.start
    seen = np.any(np.isfinite(results[:, :, kernel.CHI2]), axis=0)
    chi2 = np.ones(model.line.stations)
    chi2[seen] = np.maximum(np.nanmedian(results[:, seen, kernel.CHI2], axis=0), 1.0)
    learned = replace(
        learned, start=start, typical_chi2=chi2, largest_step_px=largest_step_px, background=background
    )
    return learned, float(np.nanmedian(results[:, :, kernel.SD]))


def _with_profile(
    model: LineModel,
    sums: ProfileSums,
    images: list[GrayImage],
    views: list[kernel.Stations],
    states: list[FloatArray],
) -> LineModel:
    """The model with the profile of these pixels, centred on the line, and windows to match."""
    weights = node_weights(model.line.arc_px, model.line.length_px, len(sums.rhs))
    for image, view, state in zip(images, views, states, strict=True):
        add_to_profile(
            image,
            view,
            sums.first_px,
            STEP_PX,
            model.camera,
            model.background,
            state,
            weights,
            sums.normal,
            sums.rhs,
        )
    profile = sums.solve()
    is_edge = model.feature == "edge"
    reach = model.half_across_px + 1.0
    profile = profile.shifted(middle_px(profile, reach, is_edge=is_edge))
    width = 0.0 if is_edge else width_px(profile, reach)
    half = TUNING.edge_flank_px if is_edge else 0.5 * width + TUNING.flank_px
    return replace(model, profile=profile, half_across_px=half, width_px=width)


def _largest_step_px(fits: list[Fit], shifts_px: FloatArray, follows: BoolArray) -> float:
    """Largest motion of a station from frame to frame, of those frames that follow the one before."""
    found, _ = _found_points(fits, shifts_px)
    steps = np.linalg.norm(np.diff(found, axis=0), axis=2)[follows]
    return float(np.max(steps, initial=0.0, where=np.isfinite(steps)))


def _found_points(fits: list[Fit], shifts_px: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Stations displaced from each fit's centreline, and its normals; shape (n, m, 2)."""
    tangents = np.stack([fit.stations.tangents for fit in fits])
    normals = np.stack([-tangents[:, :, 1], tangents[:, :, 0]], axis=2)
    points = np.stack([fit.stations.points for fit in fits])
    return points + shifts_px[:, :, None] * normals, normals


def _wider(view: kernel.Stations) -> kernel.Stations:
    """The windows with all pixels of which the profile is learned."""
    return view._replace(half_across=view.half_across + TUNING.beyond_px)


def _smooth_shifts(line: Centreline, fits: list[Fit], shifts_px: FloatArray) -> FloatArray:
    """Displacements about each fit's centreline to a smooth motion of a smooth line; shape (n, m).

    With displacements of its own, each station of a line along the pixels could have any error that depends on its
    position within the pixel: the profile learned from them would reproduce it. The line has as few splines, and then
    the motion as few shapes, as leave out no more of it than noise: such errors are not smooth along a slanted line,
    and of a motion over several px they are not in its shapes.
    """
    points = np.stack([fit.stations.points for fit in fits])
    found, normals = _found_points(fits, shifts_px)
    seen = np.any(np.isfinite(shifts_px), axis=0)
    smooth, left = [], []
    for count in line.wide_counts:
        smooth.append(np.stack([line.widely_smooth(each, count) for each in found]))
        off = np.sum((found - smooth[-1]) * normals, axis=2)[:, seen]
        moving = off - np.nanmedian(off, axis=0)
        left.append(float(np.nanmean(moving**2)) / (1.0 - count / line.stations))
    may_miss = min(left) + TUNING.motion_left_px**2
    smoothest = smooth[int(np.argmax(np.array(left) <= min(left) + may_miss))]
    off = np.sum((_few_shapes(smoothest, may_miss) - points) * normals, axis=2)
    return np.where(np.isfinite(shifts_px), off, np.nan)


def _few_shapes(points_px: FloatArray, may_miss: float) -> FloatArray:
    """Points of a line in n frames, (n, m, 2), with its motion about the mean in few shapes, to a mean square error."""
    known = np.all(np.isfinite(points_px), axis=(1, 2))
    middle = points_px[known].mean(axis=0)
    motion = (points_px[known] - middle).reshape(np.count_nonzero(known), -1)
    # Of the few frames, the decomposition takes a hundredth of the time of that of all coordinates.
    squares, over_time = np.linalg.eigh(motion @ motion.T)
    missed = np.cumsum(np.maximum(squares, 0.0)) / (motion.shape[0] * points_px.shape[1])
    over_time = over_time[:, missed > may_miss]
    out = points_px.copy()
    out[known] = middle + (over_time @ (over_time.T @ motion)).reshape(-1, *middle.shape)
    return out


def _normalised(states: FloatArray) -> FloatArray:
    """States, shape (n, m, 3), with gains and offsets relative to their medians: the profile is in gray levels."""
    gain, offset = np.nanmedian(states[:, :, kernel.GAIN]), np.nanmedian(states[:, :, kernel.OFFSET])
    out = states.copy()
    out[:, :, kernel.GAIN] /= gain
    out[:, :, kernel.OFFSET] -= offset * out[:, :, kernel.GAIN]
    return out


def _too_blurred(blur_px: FloatArray) -> BoolArray:
    """Frames in which a station is blurred, but for the sharpest quarter of each; shape (n, m)."""
    return np.asarray(blur_px > np.maximum(np.quantile(blur_px, 0.25, axis=0), TUNING.sharp_px))

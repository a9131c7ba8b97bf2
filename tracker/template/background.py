"""Background at rest inside a patch's window: the share of the motion with which each point moves, with its sd."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tracker.arrays import BoolArray, FloatArray, GrayImage
from tracker.template.noise import NoiseModel
from tracker.template.spline import Template, modelled_pixels

# Side of the neighbourhood, px, whose share of the motion is determined; the larger one where that is uncertain.
SIDES_PX = (3.0, 9.0)
# A share is used if its sd is below this.
LARGEST_SD = 0.2
# Points are left out whose share differs from the object's by this much, relative, and by this many sd.
DIFFERS, SURELY = 0.15, 3.0
# Errors of compression are correlated over about this many pixels.
CORRELATED_PX = 4.0
# Within this distance of background at rest the lens mixes it into the object; but its edges are kept if less than this
# share of the information would remain.
EDGE_PX, LEAST_INFORMATION = 2.0, 0.25
# Nothing is left out of a window if less than this share of its area would remain.
LEAST_LEFT = 0.1
# Efficiency of a median; number of neighbourhoods beyond which errors are common, as those of the sampling of an edge.
MEDIAN_SD, MOST_INDEPENDENT = 1.25, 16.0


@dataclass(frozen=True)
class MotionShares:
    """How far the image around each grid point of a template moves, relative to the fitted motion.

    Attributes
    ----------
    share, sd : array, shape of the grid
        1 where it follows the fitted motion, 0 where it rests; sd is infinite where it shows no motion.
    information : array, shape of the grid
        Fisher information of the pixels at that point about the size of the motion.
    """

    share: FloatArray
    sd: FloatArray
    information: FloatArray


def motion_shares(
    frames: list[GrayImage], states: FloatArray, warp: FloatArray, template: Template, noise: NoiseModel
) -> MotionShares:
    """Share of the fitted motion with which each part of a window moves.

    Notes
    -----
    The residual of a pixel is regressed on what more motion would change there: gradient of the template times the
    displacement along the main axis of the motion. Background at rest draws the fit towards rest; the object's share
    then is above 1.
    """
    shape, ov = template.coefs.shape, template.oversampling
    down, across = (_slope(template.coefs, axis) * ov for axis in (0, 1))
    seen = np.flatnonzero(np.all(np.isfinite(states), axis=1))
    moved, axis = _along_axis(states[seen])
    sums = np.zeros((4, *shape))
    for k, along in zip(seen, moved, strict=True):
        at, pixel, model = modelled_pixels(frames[k], states[k], warp, template.coefs, ov)
        cosine, sine = np.cos(states[k, 2]), np.sin(states[k, 2])
        direction = np.array([[cosine, sine], [-sine, cosine]]) @ warp @ axis
        change = -states[k, 3] * along * (direction[0] * across[at] + direction[1] * down[at])
        weight = 1.0 / (noise.read_variance + noise.gain * np.maximum(model, 0.0))
        residual = pixel - model
        parts = (weight * change * residual, weight * change**2, weight * residual**2, np.ones_like(weight))
        for total, part in zip(sums, parts, strict=True):
            np.add.at(total, at, part)
    share, sd = np.ones(shape), np.full(shape, np.inf)
    for side in SIDES_PX:
        size = 2 * int(0.5 * side * ov) + 1
        product, square, rest, count = (ndimage.uniform_filter(s, size, mode="constant") for s in sums)
        with np.errstate(divide="ignore", invalid="ignore"):
            beyond = product / square
            chi2 = np.maximum((rest - beyond * product) / count, 1.0)
            found_sd = np.sqrt(chi2 * CORRELATED_PX / (square * size**2))
        better = (sd > LARGEST_SD) & np.isfinite(beyond) & (found_sd < sd)
        share[better], sd[better] = 1.0 + beyond[better], found_sd[better]
    return MotionShares(share, sd, sums[1])


def _slope(coefs: FloatArray, axis: int) -> FloatArray:
    """Derivative of a cubic spline at its knots along an axis, per grid step."""
    along = ndimage.correlate1d(coefs, [-0.5, 0.0, 0.5], axis=axis, mode="nearest")
    return np.asarray(ndimage.correlate1d(along, [1 / 6, 4 / 6, 1 / 6], axis=1 - axis, mode="nearest"))


@dataclass(frozen=True)
class ObjectMotion:
    """The part of a window that moves as one object, and the object's share of the fitted motion.

    Attributes
    ----------
    support : uint8 array, shape of the grid
        1 where the window shows the object.
    share, sd : float
        The object's share of the fitted motion: below 1 where that is too large. 1 and infinite where the motion is too
        small for a distinction of object and background.
    """

    support: NDArray[np.uint8]
    share: float
    sd: float


def object_motion(
    window: NDArray[np.uint8], oversampling: float, shares: MotionShares, core: BoolArray
) -> ObjectMotion:
    """Object in a window: what moves as the middle of the window does; the whole window if that is not determined."""
    inside = window > 0
    known = inside & (shares.sd < LARGEST_SD)
    middle = known & core & (shares.share > 0.5)
    if not np.any(middle):
        return ObjectMotion(window, 1.0, np.inf)
    share = _median(shares, middle)
    off = np.abs(shares.share - share)
    other = inside & (off > DIFFERS * share) & (off > SURELY * shares.sd)
    kept = inside & ~other
    resting = other & (shares.share < 0.5 * share)
    if np.any(resting):
        inner = kept & (ndimage.distance_transform_edt(~resting) > EDGE_PX * oversampling)
        if shares.information[inner].sum() > LEAST_INFORMATION * shares.information[kept].sum():
            kept = inner
    if np.count_nonzero(kept) < LEAST_LEFT * np.count_nonzero(inside):
        return ObjectMotion(window, 1.0, np.inf)
    used = kept & known
    share = _median(shares, used)
    return ObjectMotion(
        np.ascontiguousarray(kept, dtype=np.uint8), share, _median_sd(shares, used, share, oversampling)
    )


def _median(shares: MotionShares, chosen: BoolArray) -> float:
    """Median of the chosen shares, weighted by their information."""
    values, weights = shares.share[chosen], shares.information[chosen]
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, 0.5 * total[-1])])


def _median_sd(shares: MotionShares, chosen: BoolArray, share: float, oversampling: float) -> float:
    """Standard deviation of that median, from the scatter of neighbourhoods."""
    weights = shares.information[chosen]
    scatter = np.sum(weights * (shares.share[chosen] - share) ** 2) / np.sum(weights)
    independent = np.sum(weights) ** 2 / np.sum(weights**2) / (SIDES_PX[0] * oversampling) ** 2
    return float(MEDIAN_SD * np.sqrt(scatter / np.clip(independent, 1.0, MOST_INDEPENDENT)))


def scaled_motion(states: FloatArray, factor: float) -> FloatArray:
    """States, shape (n, 5), with their displacements along the main axis of the motion multiplied."""
    seen = np.all(np.isfinite(states), axis=1)
    moved, axis = _along_axis(states[seen])
    scaled = states.copy()
    scaled[seen, :2] += (factor - 1.0) * moved[:, None] * axis
    return scaled


def _along_axis(states: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Displacement of n states along the main axis of their motion, shape (n,), and that axis, shape (2,)."""
    moved = states[:, :2] - states[:, :2].mean(axis=0)
    axis = np.linalg.svd(moved, full_matrices=False)[2][0]
    return moved @ axis, axis

"""Background at rest inside a patch's window: the share of the motion with which each point moves, with its sd."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from tracker.arrays import BoolArray, FloatArray, GrayImage
from tracker.template.noise import NoiseModel
from tracker.template.spline import Template, modelled_pixels


@dataclass(frozen=True)
class Tuning:
    """What of a window moves as one object."""

    #: [px] side of the neighbourhood whose share of the motion is determined
    side_px: float = 3.0
    #: [1] a share is used if its sd is below this
    largest_sd: float = 0.2
    #: [1] points are left out whose share differs from the object's by this, relative to it
    differs: float = 0.15
    #: [sd] and by this many standard deviations
    #: statistics: noise alone exceeds it at one point of 370
    surely: float = 3.0
    #: [px^2] pixels over which errors of compression are correlated
    correlated_px: float = 4.0
    #: [px] distance of background at rest within which the lens mixes it into the object
    #: physics: beyond two px a lens blur of 0.7 px is over
    edge_px: float = 2.0
    #: [1] share of the information without which those edges are kept
    least_information: float = 0.25
    #: [1] share of a window's area without which nothing is left out
    least_left: float = 0.1
    #: [1] neighbourhoods beyond which errors are common, as those of the sampling of an edge
    most_independent: float = 16.0


TUNING = Tuning()
# Standard deviation of a median relative to that of a mean: the root of pi / 2.
MEDIAN_SD = 1.25


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
    across, down = (slope * ov for slope in template.slopes())
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
    for side in (TUNING.side_px, 3.0 * TUNING.side_px):  # wider where the share is uncertain
        size = 2 * int(0.5 * side * ov) + 1
        product, square, rest, count = (ndimage.uniform_filter(s, size, mode="constant") for s in sums)
        with np.errstate(divide="ignore", invalid="ignore"):
            beyond = product / square
            chi2 = np.maximum((rest - beyond * product) / count, 1.0)
            found_sd = np.sqrt(chi2 * TUNING.correlated_px / (square * size**2))
        better = (sd > TUNING.largest_sd) & np.isfinite(beyond) & (found_sd < sd)
        share[better], sd[better] = 1.0 + beyond[better], found_sd[better]
    return MotionShares(share, sd, sums[1])


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
    known = inside & (shares.sd < TUNING.largest_sd)
    # midway between rest and the fitted motion
    middle = known & core & (shares.share > 0.5)
    if not np.any(middle):
        return ObjectMotion(window, 1.0, np.inf)
    share = _median(shares, middle)
    off = np.abs(shares.share - share)
    other = inside & (off > TUNING.differs * share) & (off > TUNING.surely * shares.sd)
    kept = inside & ~other
    resting = other & (shares.share < 0.5 * share)
    if np.any(resting):
        inner = kept & (ndimage.distance_transform_edt(~resting) > TUNING.edge_px * oversampling)
        if shares.information[inner].sum() > TUNING.least_information * shares.information[kept].sum():
            kept = inner
    if np.count_nonzero(kept) < TUNING.least_left * np.count_nonzero(inside):
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
    independent = np.sum(weights) ** 2 / np.sum(weights**2) / (TUNING.side_px * oversampling) ** 2
    return float(MEDIAN_SD * np.sqrt(scatter / np.clip(independent, 1.0, TUNING.most_independent)))


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

"""Noise of the stations of a line in compressed footage: standard deviation, and motion that the codec leaves out."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from tracker import flags
from tracker.arrays import FloatArray, GrayImage
from tracker.line import kernel
from tracker.line.follower import Fit, LineFollower
from tracker.line.model import LineModel
from tracker.line.profile import spline_values
from tracker.results import MarkerTracks
from tracker.template import correlation_factors
from tracker.template import noise as pixel_noise


@dataclass(frozen=True)
class Tuning:
    """Stations that a codec repeats, and the correlation of their residuals."""

    #: [sd] a step below this share of the stated sd is a repetition
    #: statistics: white noise has such steps in 3 % of the frames
    small_step: float = 0.05
    #: [1] share of repetitions from which the codec decides when a station moves
    #: measurement: prongs of filmed forks: 0.02 to 0.1 where frequency and amplitude agree with those of the weights,
    #: 0.2 to 0.9 where the amplitude doubles and halves at random
    largest_share: float = 0.15
    #: [sd] motion of a larger rms is followed in spite of repetitions
    #: convention: these are then its turning points
    least_motion_sd: float = 4.0
    #: [1] share of the record over which slower changes are drift
    drift_share: float = 0.125
    #: [frames] without which nothing is said of a station
    #: convention: as few as an identification needs (`tracker.track`)
    least_frames: int = 12
    #: [stations] spacing of the stations whose residuals give the correlation
    #: convention: limits time
    every_station: int = 3


TUNING = Tuning()

REASON = (
    "the codec repeats the pixels there from frame to frame while the motion is within about "
    f"{TUNING.least_motion_sd:.0f} standard deviations of a position, so that it shows when the codec acted rather "
    "than the motion; record with less compression"
)


def codec_skipped(tracks: MarkerTracks) -> tuple[tuple[str, str], ...]:
    """Stations of a line that hardly move and are repeated by the codec, each with the reason to leave it out.

    Their noise between frames is far below their error, and the amplitude that is left of a vibration jumps.
    """
    if not tracks.decode.predictive:
        return ()
    # Frames repeated as a whole say nothing about a station.
    found = np.isfinite(tracks.x_px) & ((tracks.flags & flags.LEFT_OUT) == 0)
    stations = np.flatnonzero(np.count_nonzero(found, axis=0) >= TUNING.least_frames)
    if not stations.size:
        return ()
    sd = np.hypot(tracks.sd_x_px, tracks.sd_y_px)
    own = np.array([np.median(sd[found[:, k], k]) for k in stations])
    # A station repeated throughout may state less than the others: it never differs from its profile.
    typical = np.maximum(own, np.median(own))
    skipped = []
    for k, least in zip(stations.tolist(), typical, strict=True):
        xy = np.stack([tracks.x_px[found[:, k], k], tracks.y_px[found[:, k], k]])
        repeated = np.mean(np.hypot(*np.diff(xy, axis=1)) < TUNING.small_step * least)
        if repeated > TUNING.largest_share and _motion_px(xy) < TUNING.least_motion_sd * least:
            skipped.append((tracks.markers[k], REASON))
    return tuple(skipped)


def _motion_px(xy: FloatArray) -> float:
    """Rms of the motion, (2, n), about its drift."""
    width = max(int(TUNING.drift_share * xy.shape[1]), 3)
    return float(np.sqrt(np.sum(np.mean((xy - uniform_filter1d(xy, width, axis=1)) ** 2, axis=1))))


def line_sd_factor(images: list[GrayImage], model: LineModel) -> float:
    """Factor on the sd of the stations due to the spatial correlation of the residuals; 1 to 6.

    Pooled over the stations, for the gradient along the normal.
    """
    follower = LineFollower(model)

    def windows() -> Iterator[tuple[FloatArray, ...]]:
        for image in images[: pixel_noise.TUNING.residual_frames]:
            follower.step(image)
            if follower.fit is not None:
                for k in np.flatnonzero(follower.fit.accepted)[:: TUNING.every_station]:
                    yield _residual_and_slope(image, model, follower.fit, int(k))

    return correlation_factors(windows(), 1)[0]


def _residual_and_slope(
    image: GrayImage, model: LineModel, fit: Fit, k: int
) -> tuple[FloatArray, FloatArray]:
    """Residual and derivative by the displacement of the pixels of one station; 0 outside its window."""
    stations, state = fit.stations, fit.results[k, : kernel.STATE]
    tangent = stations.tangents[k]
    normal = np.array([-tangent[1], tangent[0]])
    centre = stations.points[k] + state[kernel.SHIFT] * normal
    along, across = stations.half_along[k], stations.half_across[k]
    half = np.abs(tangent) * along + np.abs(normal) * across
    low = np.maximum(np.ceil(centre - half), 0).astype(int)
    high = np.minimum(np.floor(centre + half), np.array(image.shape[::-1]) - 1).astype(int)
    y, x = np.mgrid[low[1] : high[1] + 1, low[0] : high[0] + 1]
    u = (x - centre[0]) * tangent[0] + (y - centre[1]) * tangent[1]
    v = (x - centre[0]) * normal[0] + (y - centre[1]) * normal[1]
    inside = (np.abs(u) <= along) & (np.abs(v) <= across)
    coefs, _, first, step = model.profiles()
    values, ahead, behind = (spline_values(coefs[k], first, v + d) for d in (0.0, step, -step))
    window = np.s_[low[1] : high[1] + 1, low[0] : high[0] + 1]
    levels = image[window].astype(np.float64)
    texture, uncovered = model.background
    if texture.size:
        values = values + texture[window] * (uncovered[0] + uncovered[1] * values)
    residual = levels - state[kernel.GAIN] * values - state[kernel.OFFSET]
    return residual * inside, (ahead - behind) * inside

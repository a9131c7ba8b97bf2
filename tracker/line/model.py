"""A calibrated line: its centreline, the profile across it and the noise of the pixels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from tracker.arrays import FloatArray
from tracker.line.curve import Centreline
from tracker.line.kernel import Background, Profiles, Stations
from tracker.line.light import UNKNOWN_LIGHT, Light
from tracker.line.line_kernels import LineArrays, place_stations
from tracker.line.profile import LearnedProfile, node_weights

# The stations begin and end this far from the ends of the line.
INSET_PX = 2.0
NO_BACKGROUND = Background(np.zeros((0, 0), np.float32), np.array([1.0, 0.0]))


@dataclass(frozen=True)
class LineModel:
    """A calibrated line.

    Attributes
    ----------
    start : array, shape (splines, 2)
        Coefficients of the centreline in the first frame.
    feature : str
        "strip", or "edge" for a single edge.
    half_across_px : float
        Half size of the windows across the line, at rest.
    camera : array, shape (3,)
        Variance a + b I of a pixel of intensity I, and the level of saturation.
    typical_chi2 : array, shape (m,)
        Median of chi-square per degree of freedom of each station in the calibration frames, at least 1.
    width_px : float
        Width of a strip between its outer half levels; 0 for an edge.
    largest_step_px : float
        Largest motion of a station from frame to frame in the calibration frames.
    exposure_share : float
        Exposure time over the time between frames; 0 where unknown.
    background : Background
        Texture of what is at rest behind a strip.
    light : Light
        Gain and offset along an edge; unknown for a strip, whose position does not depend on them.
    ends_seen : tuple of bool
        Whether the clamped end and the free end are where the strip is seen to end in the first frame; otherwise they
        are the given ones.
    """

    line: Centreline
    start: FloatArray
    profile: LearnedProfile
    feature: Literal["strip", "edge"]
    half_across_px: float
    camera: FloatArray
    typical_chi2: FloatArray
    width_px: float = 0.0
    largest_step_px: float = 0.0
    exposure_share: float = 0.0
    background: Background = NO_BACKGROUND
    light: Light = UNKNOWN_LIGHT
    ends_seen: tuple[bool, bool] = (False, False)

    @property
    def clamp_px(self) -> FloatArray:
        """Begin of the stations, `INSET_PX` from the clamp, in the first frame; shape (2,)."""
        return np.asarray(self.line.fine(self.start).points[0])

    @property
    def length_px(self) -> float:
        """Length of the whole line."""
        return self.line.length_px + 2.0 * INSET_PX

    @property
    def from_clamp_px(self) -> FloatArray:
        """Distance of the stations from the clamp along the line; shape (m,)."""
        return np.asarray(self.line.arc_px + INSET_PX)

    def profiles(self) -> Profiles:
        """Profile of each station."""
        nodes = node_weights(self.line.arc_px, self.line.length_px, len(self.profile.coefs))
        return self.profile.at_stations(nodes)

    def arrays(self) -> LineArrays:
        """The line for compiled code."""
        return self.line.arrays(
            self.clamp_px, self.half_across_px, self.typical_chi2, self.camera, self.background, self.light
        )

    def stations(self, coefs: FloatArray) -> Stations:
        """Windows at the stations of a centreline at rest."""
        found = empty_stations(self.line.stations)
        place_stations(self.arrays(), coefs, np.zeros(self.line.stations), found)
        return found


def empty_stations(count: int) -> Stations:
    """Windows to be filled."""
    return Stations(np.empty((count, 2)), np.empty((count, 2)), *(np.empty(count) for _ in range(4)))

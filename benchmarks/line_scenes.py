"""Films of bare strips and edges without any marker, drawn without the packages: the truth for the benchmark and tests.

The centreline is an inextensible curve given by its angle along the arc length, and the profile across it is analytic:
a strip or an edge behind a Gaussian lens. Each pixel is the integral over its area, by Gauss-Legendre quadrature.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.special import ndtr

Array = NDArray[np.float64]

NODES, WEIGHTS = np.polynomial.legendre.leggauss(4)
# Roots of cos(x) cosh(x) = -1 of the bending modes of a cantilever.
ROOTS = (1.8751040687, 4.6940911330, 7.8547574382, 10.9955407349, 14.1371683910)
# Pixels farther from the centreline than this beyond the half width show the background alone.
FAR_PX = 5.0
# Images averaged for an exposure, more than one per half px of the blur in these scenes.
EXPOSURES = 12
STEP_PX = 0.5
# How films are stored: encoder, suffix of the file, options.
CODECS: dict[str, tuple[str, str, dict[str, Any]]] = {
    "lossless": ("ffv1", "mkv", {}),
    "MJPG": ("mjpeg", "avi", {"quality": 3}),
    "H.264": ("libx264", "mp4", {"crf": 18}),
}


@dataclass(frozen=True)
class LineScene:
    """A strip or an edge that vibrates in `modes` of a cantilever.

    Lengths are in px, angles in rad; y points down. ``bend_rad`` is the rotation of the tip at rest against the clamp,
    ``tip_px`` the amplitude of each mode at the tip, ``cycles_per_frame`` its frequency and ``phase_rad`` that of all.
    ``texture`` is the standard deviation of the gray levels of the resting background, ``light`` the relative change of
    the light along the strip.

    Material points of a straight strip move across it by the sum of the modes at any amplitude: the sine of the
    rotation is that sum's slope. With the rotation itself equal to the slope, the displacement would lack a cubic term,
    and of a motion that decays exponentially it would decay more slowly at first.
    """

    feature: str = "strip"
    width_px: float = 4.0
    length_px: float = 300.0
    clamp_px: tuple[float, float] = (80.3, 30.6)
    angle_rad: float = 0.5 * np.pi + 0.02
    bend_rad: float = 0.0
    modes: tuple[int, ...] = (1, 2)
    tip_px: tuple[float, ...] = (4.0, 1.0)
    cycles_per_frame: tuple[float, ...] = (0.0371, 0.213)
    phase_rad: float = 0.0
    decay: float = 0.0
    blur_px: float = 0.55
    exposure: float = 0.0
    dark: float = 60.0
    bright: float = 180.0
    noise: float = 2.0
    texture: float = 0.0
    light: float = 0.0
    shape: tuple[int, int] = (360, 160)
    seed: int = 0

    def curve(self, time_frames: float) -> tuple[Array, Array, Array]:
        """Arc length, points (n, 2) and angle of the centreline at a time."""
        s = np.arange(0.0, self.length_px + 0.5 * STEP_PX, STEP_PX)
        slope = np.zeros(s.size)
        for mode, tip, rate in zip(self.modes, self.tip_px, self.cycles_per_frame, strict=True):
            turns = 2.0 * np.pi * rate * time_frames + self.phase_rad
            swing = tip * np.exp(-self.decay * time_frames) * np.cos(turns)
            slope = slope + swing * _slope(ROOTS[mode - 1], s / self.length_px) / self.length_px
        angle = self.angle_rad + self.bend_rad * (s / self.length_px) ** 2 + np.arcsin(slope)
        steps = 0.5 * STEP_PX * (_unit(angle[1:]) + _unit(angle[:-1]))
        points = np.array(self.clamp_px) + np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
        return s, points, angle

    def points(self, time_frames: float, arc_px: Array) -> tuple[Array, Array]:
        """Material points at distances from the clamp, and normals there; both (n, 2), means over the exposure."""
        found = []
        for time in self._times(time_frames):
            s, curve, angle = self.curve(time)
            at = np.interp(arc_px, s, angle)
            found.append(
                [[np.interp(arc_px, s, c) for c in curve.T], [-np.sin(at), np.cos(at)]],
            )
        points, normals = np.mean(found, axis=0)
        return points.T, normals.T

    def image(self, time_frames: float, shift_px: float = 0.0) -> Array:
        """Noise-free image in gray levels; the whole line may be shifted along its normals."""
        background = self._background
        image = np.zeros(self.shape)
        times = self._times(time_frames)
        for time in times:
            cover, along = self._cover(time, shift_px)
            strip = self.dark * (1.0 + self.light * along / self.length_px)
            image += (background * (1.0 - cover) + strip * cover) / len(times)
        return image

    def frames(self, count: int, first: int = 0) -> list[NDArray[np.uint8]]:
        """Images of 8 bit with noise."""
        rng = np.random.default_rng((self.seed, 1))
        return [
            np.clip(np.rint(self.image(k) + rng.normal(0.0, self.noise, self.shape)), 0, 255).astype(np.uint8)
            for k in range(first, first + count)
        ]

    def _times(self, time_frames: float) -> Array:
        if self.exposure == 0.0:
            return np.array([time_frames])
        return time_frames + self.exposure * ((np.arange(EXPOSURES) + 0.5) / EXPOSURES - 0.5)

    @cached_property
    def _background(self) -> Array:
        grain = np.random.default_rng((self.seed, 2)).normal(0.0, 1.0, self.shape)
        # Grains of about 3 px; the binomial filter keeps 0.14 of the sd in two dimensions.
        for axis in (0, 1):
            for _ in range(4):
                grain = 0.5 * grain + 0.25 * (np.roll(grain, 1, axis) + np.roll(grain, -1, axis))
        return np.asarray(self.bright + self.texture * grain / grain.std())

    def _cover(self, time: float, shift_px: float) -> tuple[Array, Array]:
        """Share of each pixel that the strip covers, and the arc length there."""
        s, points, angle = self.curve(time)
        points = points + shift_px * np.stack([-np.sin(angle), np.cos(angle)], axis=1)
        rows, columns = np.indices(self.shape)
        pixels = np.stack([columns.ravel(), rows.ravel()], axis=1).astype(np.float64)
        far, at = cKDTree(points).query(pixels, distance_upper_bound=FAR_PX + 0.5 * self.width_px)
        near = np.flatnonzero(np.isfinite(far))
        cover, arc = np.zeros(len(pixels)), np.zeros(len(pixels))
        if self.feature == "edge":
            # Everything on the right of the directed line is covered, also far from it.
            at = 8 * cKDTree(points[::8]).query(pixels)[1]
            offset, t = pixels - points[at], _unit(angle[at])
            cover = (t[:, 0] * offset[:, 1] - t[:, 1] * offset[:, 0] > 0).astype(np.float64)
        at = at[near]
        offset, t, bend = pixels[near] - points[at], _unit(angle[at]), np.gradient(angle, STEP_PX)[at]
        along, across = np.sum(offset * t, axis=1), t[:, 0] * offset[:, 1] - t[:, 1] * offset[:, 0]
        cover[near] = 0.0
        for node_y, weight_y in zip(0.5 * NODES, 0.5 * WEIGHTS, strict=True):
            for node_x, weight_x in zip(0.5 * NODES, 0.5 * WEIGHTS, strict=True):
                u = along + node_x * t[:, 0] + node_y * t[:, 1]
                v = across + t[:, 0] * node_y - t[:, 1] * node_x - 0.5 * bend * u**2
                cover[near] += weight_x * weight_y * self._profile(v, s[at] + u)
        arc[near] = (s[at] + along).clip(0.0, self.length_px)
        return cover.reshape(self.shape), arc.reshape(self.shape)

    def _profile(self, across: Array, along: Array) -> Array:
        """Cover of a point behind the lens; the strip ends at the tip."""
        if self.feature == "edge":
            return np.asarray(ndtr(across / self.blur_px))
        half = 0.5 * self.width_px
        strip = ndtr((across + half) / self.blur_px) - ndtr((across - half) / self.blur_px)
        ends = ndtr(along / self.blur_px) - ndtr((along - self.length_px) / self.blur_px)
        return np.asarray(strip * ends)


def bound_px(
    scene: LineScene,
    time_frames: float,
    arc_px: Array,
    spacing_px: float,
    reach_px: float,
    *,
    light_known: bool = False,
) -> Array:
    """Cramer-Rao bound of the normal displacement of each station, shape (stations,).

    Gain and offset are unknown unless `light_known`.

    The pixels of a station are those nearest to it along the line and within `reach_px` across it; the noise is that of
    the camera and of rounding to whole gray levels.
    """
    h = 0.02
    slope = (scene.image(time_frames, h) - scene.image(time_frames, -h)) / (2.0 * h)
    image = scene.image(time_frames)
    points, normals = scene.points(time_frames, arc_px)
    normals = normals / np.linalg.norm(normals, axis=1)[:, None]
    rows, columns = np.indices(scene.shape)
    bounds = []
    for point, normal in zip(points, normals, strict=True):
        v = (columns - point[0]) * normal[0] + (rows - point[1]) * normal[1]
        u = (columns - point[0]) * normal[1] - (rows - point[1]) * normal[0]
        inside = (np.abs(u) <= 0.5 * spacing_px) & (np.abs(v) <= reach_px)
        design = np.stack([slope[inside], image[inside], np.ones(int(inside.sum()))])
        design = design[:1] if light_known else design
        covariance = np.linalg.inv(design @ design.T) * (scene.noise**2 + 1.0 / 12.0)
        bounds.append(np.sqrt(covariance[0, 0]))
    return np.array(bounds)


def _unit(angle: Array) -> Array:
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def mode_shape(mode: int, x: Array) -> Array:
    """Displacement of a cantilever's mode over x from 0 to 1, 1 at the tip."""
    root = ROOTS[mode - 1]
    ratio = (np.cosh(root) + np.cos(root)) / (np.sinh(root) + np.sin(root))
    shape, tip = (
        np.cosh(z) - np.cos(z) - ratio * (np.sinh(z) - np.sin(z)) for z in (root * x, np.float64(root))
    )
    return np.asarray(shape / tip)


def _slope(root: float, x: Array) -> Array:
    """Slope of a cantilever's mode over x from 0 to 1, for a displacement of 1 at the tip."""
    ratio = (np.cosh(root) + np.cos(root)) / (np.sinh(root) + np.sin(root))
    arg = root * x
    slope = root * (np.sinh(arg) + np.sin(arg) - ratio * (np.cosh(arg) - np.cos(arg)))
    tip = np.cosh(root) - np.cos(root) - ratio * (np.sinh(root) - np.sin(root))
    return np.asarray(slope / tip)

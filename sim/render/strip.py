"""A bare beam seen edge-on: its centreline, its surface, and its image in front of a still background.

The motion is that of an inextensible beam given by the angle of its centreline, with any rest shape and rotation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from math import ceil, sqrt

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from sim.render.camera import Camera, Motion, Poses
from sim.render.kernels import TUNING as KERNELS
from sim.render.kernels import add_strip_points, panels
from sim.render.markers import Texture
from tracker import FloatArray, checked

# samples that cubic interpolation needs beyond the strip
_MARGIN = 3


@dataclass(frozen=True)
class Tuning:
    """Accuracy of the tables."""

    #: [per sd] samples of a stripe per standard deviation
    #: physics: Cubic interpolation is exact to 0.0234 h^4 3 / sigma^4: 2e-5 of its height.
    stripe_samples: int = 8


TUNING = Tuning()


@dataclass(frozen=True, kw_only=True)
class Stripe:
    """A reflection along the strip: a Gaussian across of `width_mm` (standard deviation), `gray` counts high.

    `offset_mm` is the distance of its middle from the centreline, to the left of the direction of growing arc length.
    """

    gray: float
    width_mm: float
    offset_mm: float = 0.0

    def __post_init__(self) -> None:
        checked("width_mm of a stripe", self.width_mm, positive=True)


@dataclass(frozen=True, kw_only=True)
class Surface:
    """What the camera sees of a bare strip, in counts; the stripe and the texture move with it."""

    gray: float
    stripe: Stripe | None = None
    texture: Texture | None = None

    def table(
        self, length_mm: float, width_mm: float
    ) -> tuple[FloatArray, tuple[float, float, float, float]]:
        """Counts at (distance to the left of the centreline, distance along it), for cubic interpolation.

        With the first value and the reciprocal step of its rows and of its columns, in mm.
        """
        step_along = length_mm if self.texture is None else min(length_mm, self.texture.step_mm)
        fine = [width_mm, *([] if self.texture is None else [self.texture.step_mm])]
        if self.stripe is not None:
            fine.append(self.stripe.width_mm / TUNING.stripe_samples)
        step_across = min(fine)
        along, across = _samples(length_mm, step_along), _samples(width_mm, step_across) - 0.5 * width_mm
        values: FloatArray = np.full((across.size, along.size), self.gray)
        if self.stripe is not None:
            distance = (across - self.stripe.offset_mm) / self.stripe.width_mm
            values += self.stripe.gray * np.exp(-0.5 * distance**2)[:, None]
        if self.texture is not None:
            values += self.texture.on_grid(along, across)
        return values, (float(across[0]), 1.0 / step_across, float(along[0]), 1.0 / step_along)

    def narrowest(self, lens_blur_mm: float) -> float:
        """Standard deviation of the narrowest Gaussian across the strip: the stripe within the lens blur."""
        if self.stripe is None:
            return lens_blur_mm
        return 1.0 / sqrt(lens_blur_mm**-2 + self.stripe.width_mm**-2)


def _samples(length: float, step: float) -> FloatArray:
    """From 0 to `length`, and what interpolation needs beyond."""
    return np.asarray(step * (np.arange(ceil(length / step) + 1 + 2 * _MARGIN) - _MARGIN), dtype=np.float64)


@dataclass(frozen=True, kw_only=True)
class BareStrip:
    """The beam itself as the marker: a strip of constant width around a curved centreline, with square ends.

    A marker hides it between the points where the circle of its half extent crosses the centreline.

    Attributes
    ----------
    width_mm : float
    arc_mm : array, shape (p,)
        Material coordinate of each point of the motion: distance from the first along the undeformed centreline.
    motion : Motion
        Of these points; the angles are not used. Between them the centreline is a cubic spline in `arc_mm`, whose error
        is ``(k h)^4 / 384`` of a wave of wave number k for points at distances h.
    surface : Surface

    Raises
    ------
    ValueError
        If the width is not positive or the arc does not increase from 0, with four points at least.
    """

    width_mm: float
    arc_mm: FloatArray
    motion: Motion
    surface: Surface = field(default_factory=lambda: Surface(gray=60.0))

    def __post_init__(self) -> None:
        checked("width_mm of a strip", self.width_mm, positive=True)
        arc = np.asarray(self.arc_mm)
        if arc.ndim != 1 or arc.size < 4 or arc[0] != 0.0 or not np.all(np.diff(arc) > 0.0):
            msg = "arc_mm of a strip needs four increasing values or more, from 0"
            raise ValueError(msg)

    def curve(self, points: Poses) -> CubicSpline:
        """Centreline at k instants as a function of `arc_mm`: values of shape (k, 2), x and y in mm.

        Raises
        ------
        ValueError
            If the motion does not have one point for each value of `arc_mm`.
        """
        if points.x_mm.shape[1] != self.arc_mm.size:
            msg = f"the strip has {self.arc_mm.size} values of arc_mm, but its motion {points.x_mm.shape[1]} points"
            raise ValueError(msg)
        return CubicSpline(self.arc_mm, np.stack([points.x_mm.T, points.y_mm.T], axis=-1))

    def points_mm(self, time_s: FloatArray, arc_mm: FloatArray) -> FloatArray:
        """Material points of the centreline at `arc_mm`, shape (times, points, 2); ValueError beyond the strip."""
        at = np.asarray(arc_mm, dtype=np.float64)
        if not (np.all(at >= 0.0) and np.all(at <= self.arc_mm[-1])):
            msg = f"points of the strip lie at 0 to {self.arc_mm[-1]:g} mm, got {at.min():g} to {at.max():g}"
            raise ValueError(msg)
        return np.moveaxis(self.curve(self.motion(np.asarray(time_s)))(at), 0, 1)

    def geometry(self, curve: CubicSpline, arc_mm: FloatArray) -> FloatArray:
        """Centreline at one instant at distances `arc_mm`, (n,).

        Returns
        -------
        array, shape (n, 6)
            x and y in mm, unit tangent x and y, curvature per mm (positive where it turns left), and the length of
            the centreline per undeformed length.

        Raises
        ------
        ValueError
            If the strip is bent to a radius below its width.
        """
        at, slope, bend = (curve(arc_mm, order)[:, 0] for order in range(3))
        stretch = np.hypot(slope[:, 0], slope[:, 1])
        curvature = (slope[:, 0] * bend[:, 1] - slope[:, 1] * bend[:, 0]) / stretch**3
        if np.any(np.abs(curvature) * self.width_mm > 1.0):
            msg = (
                f"the strip is bent to a radius below its width of {self.width_mm:g} mm: lower the amplitude, or give "
                "more points of its motion"
            )
            raise ValueError(msg)
        return np.column_stack([at, slope / stretch[:, None], curvature, stretch])


def visible_parts(curve: CubicSpline, covers_mm: FloatArray, step_mm: float) -> list[tuple[float, float]]:
    """Distances (from, to) along the centreline at one instant between which no circle of `covers_mm` hides it.

    Circles have rows x, y, radius; one that the centreline enters and leaves within `step_mm` may be missed.
    """
    last = float(curve.x[-1])
    arc = np.linspace(0.0, last, max(2, ceil(last / step_mm) + 1))
    points = curve(arc)[:, 0]
    edges = [0.0, last]
    for x, y, radius in covers_mm:

        def depth(s: float, x: float = x, y: float = y, radius: float = radius) -> float:
            at = curve(s)[0]
            return float(np.hypot(at[0] - x, at[1] - y)) - radius

        outside = np.hypot(points[:, 0] - x, points[:, 1] - y) > radius
        crossings = np.flatnonzero(outside[1:] != outside[:-1])
        edges.extend(float(brentq(depth, arc[k], arc[k + 1])) for k in crossings)
    edges.sort()
    middles = curve([0.5 * (a + b) for a, b in pairwise(edges)])[:, 0]
    distance = np.hypot(middles[:, :1] - covers_mm[:, 0], middles[:, 1:] - covers_mm[:, 1])
    seen = np.all(distance > covers_mm[:, 2], axis=1)
    return [part for part, visible in zip(pairwise(edges), seen, strict=True) if visible]


class StripImage:
    """Draws a bare strip into frames of a camera.

    ``I(p) = int int (b(s, t) - B(x)) P(p - x) |dx/d(s, t)| ds dt`` over the strip, with x its point at distance s along
    and t across, b its brightness, B that of the background and P the point spread function averaged over a pixel, by
    Gauss-Legendre points in s and t.
    """

    def __init__(self, strip: BareStrip, camera: Camera, backdrop: Texture | None) -> None:
        self._strip, self._camera = strip, camera
        scale, sigma = camera.mm_per_px, camera.lens_blur_px
        self._surface, grid = strip.surface.table(float(strip.arc_mm[-1]), strip.width_mm)
        # across in px, along in mm
        self._surface_grid = (grid[0] / scale, grid[1] * scale, grid[2], grid[3])
        self._backdrop, self._backdrop_grid = self._behind(backdrop)
        half = 0.5 * strip.width_mm / scale
        at, weights = panels(-half, half, strip.surface.narrowest(sigma * scale) / scale)
        self._across = np.column_stack([at, weights])

    def _behind(self, backdrop: Texture | None) -> tuple[FloatArray, tuple[float, float, float, float]]:
        """Texture of the frame and of what blurs into it, and its grid in px."""
        if backdrop is None:
            return np.zeros((0, 0)), (0.0, 0.0, 0.0, 0.0)
        camera = self._camera
        step = backdrop.step_mm / camera.mm_per_px
        before = 0.5 + KERNELS.reach * camera.lens_blur_px + 3.0 * step
        rows, columns = (
            np.asarray(np.arange(ceil((side + 2.0 * before) / step) + 1) * step - before, dtype=np.float64)
            for side in (camera.height_px, camera.width_px)
        )
        values = backdrop.on_grid(*camera.to_mm(columns, rows))
        return values, (-before, 1.0 / step, -before, 1.0 / step)

    def add(self, image: FloatArray, points: Poses, covers: FloatArray, share: float) -> None:
        """Add `share` of the difference between strip and background to an image of the background.

        Parameters
        ----------
        points : Poses
            Of the strip's motion at one instant.
        covers : array, shape (m, 3)
            Circles x, y, radius in px that hide the strip.
        """
        camera, strip = self._camera, self._strip
        scale, sigma = camera.mm_per_px, camera.lens_blur_px
        curve = strip.curve(points)
        covers_mm = np.column_stack([*camera.to_mm(covers[:, 0], covers[:, 1]), scale * covers[:, 2]])
        for part in visible_parts(curve, covers_mm, scale):
            arc, weights = panels(*part, sigma * scale)
            at = strip.geometry(curve, arc)
            x, y = camera.to_px(at[:, 0], at[:, 1])
            length_px = share * weights * at[:, 5] / scale
            add_strip_points(
                image,
                np.column_stack([x, y, at[:, 2], -at[:, 3], at[:, 4] * scale, arc, length_px]),
                self._across,
                self._surface,
                self._surface_grid,
                self._backdrop,
                self._backdrop_grid,
                float(camera.background),
                sigma,
            )


# Gauss-Legendre points between two points of the line: exact to (h / wave length)^8
_ORDER = 4
# of a cantilever: cos(b) cosh(b) = -1
_CANTILEVER_ROOTS = (1.8751040687, 4.6940911330, 7.8547574382, 10.9955407349, 14.1371683910)


@dataclass(frozen=True, kw_only=True)
class BendingLine:
    """A centreline that turns but does not stretch: ``(x, y)(s) = origin + int_0^s (cos a, sin a) ds``.

    Attributes
    ----------
    arc_mm : array, shape (p,)
        Distances of the points from the clamp along the line, increasing from 0.
    angle : callable
        ``angle(time_s, arc_mm)``, the direction a of the line at times (k,) and distances (q,), shape (k, q), in rad
        counter-clockwise from the x axis; -pi/2 hangs down.
    origin_mm : tuple of float
        Place of the clamp.
    """

    arc_mm: FloatArray
    angle: Callable[[FloatArray, FloatArray], FloatArray]
    origin_mm: tuple[float, float] = (0.0, 0.0)

    def __call__(self, time_s: FloatArray) -> Poses:
        """Poses at `time_s`, (k,); the angles are the directions of the line."""
        time = np.asarray(time_s, dtype=np.float64)
        nodes, weights = np.polynomial.legendre.leggauss(_ORDER)
        step = np.diff(self.arc_mm)
        inside = (self.arc_mm[:-1] + 0.5 * step)[:, None] + 0.5 * step[:, None] * nodes
        angle = self.angle(time, inside.ravel()).reshape(time.size, step.size, _ORDER)
        x, y = (
            np.concatenate(
                [np.zeros((time.size, 1)), np.cumsum(0.5 * step * (part(angle) @ weights), axis=1)], axis=1
            )
            for part in (np.cos, np.sin)
        )
        return Poses(x + self.origin_mm[0], y + self.origin_mm[1], self.angle(time, self.arc_mm))


@dataclass(frozen=True, kw_only=True)
class DecayingMode:
    """A mode of a cantilever in free decay from time 0, at rest in its largest displacement before.

    The tip's displacement is ``amplitude exp(-zeta omega t) cos(omega_d t)`` for small rotation.
    """

    number: int
    amplitude_mm: float
    frequency_hz: float
    damping_ratio: float

    def at(self, time_s: FloatArray) -> FloatArray:
        """Displacement of the tip, in mm."""
        omega = 2.0 * np.pi * self.frequency_hz
        t = np.maximum(time_s, 0.0)
        damped = omega * np.sqrt(1.0 - self.damping_ratio**2)
        return np.asarray(self.amplitude_mm * np.exp(-self.damping_ratio * omega * t) * np.cos(damped * t))


def cantilever_slope(number: int, arc: FloatArray) -> FloatArray:
    """Slope of a uniform cantilever's mode 1 to 5, of length 1 and displacement 1 at the tip, at `arc` in 0 to 1."""
    root = _CANTILEVER_ROOTS[number - 1]
    ratio = (np.sinh(root) - np.sin(root)) / (np.cosh(root) + np.cos(root))
    z = root * np.asarray(arc)
    shape_at_tip = np.cosh(root) - np.cos(root) - ratio * (np.sinh(root) - np.sin(root))
    slope = np.sinh(z) + np.sin(z) - ratio * (np.cosh(z) - np.cos(z))
    return np.asarray(root * slope / shape_at_tip)


def decaying_cantilever(
    length_mm: float, modes: tuple[DecayingMode, ...], *, direction_rad: float = -0.5 * np.pi
) -> BendingLine:
    """Free decay of a clamped strip in some modes, from any direction, straight at rest."""

    def angle(time_s: FloatArray, arc_mm: FloatArray) -> FloatArray:
        turned = np.full((1, np.size(arc_mm)), direction_rad)
        for mode in modes:
            slope = cantilever_slope(mode.number, np.asarray(arc_mm) / length_mm) / length_mm
            turned = turned + mode.at(time_s)[:, None] * slope
        return np.broadcast_to(turned, (time_s.size, np.size(arc_mm)))

    return BendingLine(arc_mm=np.linspace(0.0, length_mm, 101), angle=angle)

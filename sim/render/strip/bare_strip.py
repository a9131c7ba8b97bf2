"""A bare beam seen edge-on: its centreline and its surface."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from math import ceil, sqrt

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from sim.render.motion import Motion, Poses
from sim.render.texture import Texture
from tracker import FloatArray

# samples that cubic interpolation needs beyond the strip
_MARGIN = 3
# samples of a stripe per standard deviation
_STRIPE_SAMPLES = 8


@dataclass(frozen=True, kw_only=True)
class Stripe:
    """A reflection along the strip: a Gaussian across of `width_mm` (standard deviation), `gray` counts high.

    `offset_mm` is the distance of its middle from the centreline, to the left of the direction of growing arc length.
    """

    gray: float
    width_mm: float
    offset_mm: float = 0.0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.width_mm) and self.width_mm > 0.0):
            msg = f"width_mm of a stripe must be finite and positive, got {self.width_mm}"
            raise ValueError(msg)


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
            fine.append(self.stripe.width_mm / _STRIPE_SAMPLES)
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
        if not (np.isfinite(self.width_mm) and self.width_mm > 0.0):
            msg = f"width_mm of a strip must be finite and positive, got {self.width_mm}"
            raise ValueError(msg)
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

"""Motion of an inextensible beam given by the angle of its centreline: any rest shape, any rotation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sim.render.motion import Poses
from tracker import FloatArray

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
    length_mm: float,
    modes: tuple[DecayingMode, ...],
    *,
    direction_rad: float = -0.5 * np.pi,
    rest_curvature_per_mm: float = 0.0,
    points: int = 101,
) -> BendingLine:
    """Free decay of a clamped strip in some modes, from any direction and constant curvature at rest."""

    def angle(time_s: FloatArray, arc_mm: FloatArray) -> FloatArray:
        turned = direction_rad + rest_curvature_per_mm * np.asarray(arc_mm)[None, :]
        for mode in modes:
            slope = cantilever_slope(mode.number, np.asarray(arc_mm) / length_mm) / length_mm
            turned = turned + mode.at(time_s)[:, None] * slope
        return np.broadcast_to(turned, (time_s.size, np.size(arc_mm)))

    return BendingLine(arc_mm=np.linspace(0.0, length_mm, points), angle=angle)

"""Centreline of an inextensible beam: a cubic spline over the distance from the clamp along the beam."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy  # its parts are loaded when they are used

from tracker.arrays import BoolArray, FloatArray
from tracker.line.kernel import Background
from tracker.line.light import Light
from tracker.line.stations import LineArrays


@dataclass(frozen=True)
class Tuning:
    """Splines of the centreline."""

    #: [splines] of the centreline, at least
    #: convention: one more than a single cubic has
    least_splines: int = 5
    #: [splines] of the centreline, at most
    #: convention: enough for the fifth mode of a cantilever, few enough to average the noise
    most_splines: int = 16
    #: [stations] for each spline of the centreline
    stations_per_spline: float = 2.5
    #: [splines] with which a profile is learned, at least
    #: convention: over several px of the line, errors that depend on the position within the pixel average out
    least_wide_splines: int = 7
    #: [splines] the same, at first
    #: convention: as above; where the line moves in shapes that they do not follow, there are more
    most_wide_splines: int = 10
    #: [stations] for each of them
    #: convention: as above
    stations_per_wide_spline: float = 7.0
    #: [1] factor to the next larger number of them
    #: convention: with too few for modes 3 to 5 profiles were too wide, and the fifth mode was lost; the number is
    #: chosen
    more_splines: float = 1.4
    #: [stations] for each of the narrowest ones
    stations_per_narrowest: float = 1.5
    #: [1] weight of the bending of the smooth line where stations are missing, relative to that of a typical station
    #: convention: far below that of any station
    stiffness: float = 1e-4


TUNING = Tuning()


@dataclass(frozen=True)
class CurveAt:
    """A curve at n places: points and unit tangents (n, 2), curvature (n,), and the norm of the derivative (n,)."""

    points: FloatArray
    tangents: FloatArray
    curvature: FloatArray
    speed: FloatArray

    @property
    def normals(self) -> FloatArray:
        """Unit normals (-t_y, t_x); shape (n, 2)."""
        return np.stack([-self.tangents[:, 1], self.tangents[:, 0]], axis=1)


class Centreline:
    """Splines over the arc length of a line, evaluated at its stations and between them.

    Parameters
    ----------
    length_px : float
        Length of the line.
    stations : int
        Equal parts of the line; a station is the middle of each.
    """

    def __init__(self, length_px: float, stations: int) -> None:
        self.length_px, self.stations = length_px, stations
        self.spacing_px = length_px / stations
        self._fine_px = np.linspace(0.0, length_px, 2 * stations + 1)
        self.arc_px = np.ascontiguousarray(self._fine_px[1::2])
        count = int(np.clip(stations / TUNING.stations_per_spline, TUNING.least_splines, TUNING.most_splines))
        splines = _splines(length_px, count)
        self._fine = np.stack([splines(self._fine_px, nu) for nu in range(3)])
        self._at_stations = np.ascontiguousarray(self._fine[:, 1::2])
        bending = self._fine[2].T @ self._fine[2]
        self._stiffness = TUNING.stiffness * stations / np.trace(bending) * bending
        self._project = np.linalg.pinv(self._fine[0])
        # Numbers of splines with which a profile may be learned, increasing.
        self.wide_counts = _wide_counts(stations)
        self._wide = {n: _splines(length_px, n)(self.arc_px) for n in self.wide_counts}
        # Where no station is missing, which is the rule, all frames have one and the same smoothing.
        self._smooth_all = {n: wide @ np.linalg.pinv(wide) for n, wide in self._wide.items()}

    def arrays(
        self,
        clamp_px: FloatArray,
        half_across_px: float,
        typical_chi2: FloatArray,
        camera: FloatArray,
        background: Background,
        light: Light,
    ) -> LineArrays:
        """The line for compiled code."""
        return LineArrays(
            self._fine,
            self._fine_px,
            self._project,
            self._stiffness,
            clamp_px,
            half_across_px,
            typical_chi2,
            camera,
            background,
            light,
        )

    def from_points(self, points_px: FloatArray) -> FloatArray:
        """Coefficients, shape (splines, 2), of the curve through points at the places of `fine_px`."""
        return np.asarray(self._project @ points_px)

    @property
    def fine_px(self) -> FloatArray:
        """Distances from the clamp of the stations, the middles between them, and both ends."""
        return self._fine_px

    def at_stations(self, coefs: FloatArray) -> CurveAt:
        """The curve at its stations."""
        return _curve(self._at_stations, coefs)

    def fine(self, coefs: FloatArray) -> CurveAt:
        """The curve at `fine_px`."""
        return _curve(self._fine, coefs)

    def smoothed(self, values: FloatArray, used: BoolArray) -> FloatArray:
        """Coefficients, shape (splines,), of the smooth function through the used values (m,) at the stations."""
        basis = self._fine[0, 1::2][used]
        return np.asarray(np.linalg.solve(basis.T @ basis + self._stiffness, basis.T @ values[used]))

    def off_smooth(self, values: FloatArray, used: BoolArray) -> FloatArray:
        """Difference of values (m,) at the stations from the smooth function through those used."""
        return np.asarray(values - self._at_stations[0] @ self.smoothed(values, used))

    def widely_smooth(self, points_px: FloatArray, count: int) -> FloatArray:
        """Points at the stations, (m, 2), replaced by those of a curve of `count` splines; NaN are filled."""
        known, wide = np.all(np.isfinite(points_px), axis=1), self._wide[count]
        if np.all(known):
            return np.asarray(self._smooth_all[count] @ points_px)
        if np.count_nonzero(known) < count:
            return np.full_like(points_px, np.nan)
        coefs, *_ = np.linalg.lstsq(wide[known], points_px[known], rcond=None)
        return np.asarray(wide @ coefs)


def _wide_counts(stations: int) -> tuple[int, ...]:
    few = int(
        np.clip(
            stations / TUNING.stations_per_wide_spline, TUNING.least_wide_splines, TUNING.most_wide_splines
        )
    )
    counts = [min(few, stations - 1)]
    while TUNING.more_splines * counts[-1] <= min(
        stations / TUNING.stations_per_narrowest, TUNING.most_splines + TUNING.least_wide_splines
    ):
        counts.append(int(np.ceil(TUNING.more_splines * counts[-1])))
    return tuple(counts)


def _splines(length_px: float, count: int) -> scipy.interpolate.BSpline:
    knots = np.concatenate([np.zeros(3), np.linspace(0.0, length_px, count - 2), np.full(3, length_px)])
    return scipy.interpolate.BSpline(knots, np.eye(count), 3)


def _curve(basis: FloatArray, coefs: FloatArray) -> CurveAt:
    first, second = basis[1] @ coefs, basis[2] @ coefs
    speed = np.maximum(np.hypot(first[:, 0], first[:, 1]), 1e-9)
    turn = (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / speed**3
    return CurveAt(basis[0] @ coefs, first / speed[:, None], turn, speed)


def smoothed(points_px: FloatArray, weights: FloatArray, splines: int) -> FloatArray:
    """Points at equal distances along a line, replaced by those of a smooth curve.

    Steps between points that are known to a px would add to the length of the line.
    """
    share = (np.arange(len(points_px)) + 0.5) / len(points_px)
    basis = _splines(1.0, max(min(splines, len(points_px) // 2), 4))(share)
    root = np.sqrt(weights)[:, None]
    return np.asarray(basis @ np.linalg.lstsq(root * basis, root * points_px)[0])


def resampled(points_px: FloatArray, count: int) -> tuple[FloatArray, float]:
    """Points at equal distances along a polyline, shape (count, 2), and its length."""
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points_px, axis=0), axis=1))])
    at = np.linspace(0.0, arc[-1], count)
    return np.stack([np.interp(at, arc, c) for c in points_px.T], axis=1), float(arc[-1])

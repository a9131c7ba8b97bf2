"""Slow changes of the image's scale over a record, from the spacing of the markers: zoom and focus breathing.

A change of the scale multiplies the displacement and so changes the apparent decay. Across the displacement, along the
beam, the markers move with the scale, with the camera, and with the beam, which shortens where it bends: by a
quadratic form of the displacement, whose part at twice the frequency of the vibration tells the slow part. Splines
describe the slow motion, with their errors beside vibration and noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, hstack
from scipy.special import fdtrc

from tracker.arrays import BoolArray, FloatArray, robust_sd
from tracker.position_errors import TUNING as POSITION
from tracker.vibration_direction import TUNING as DIRECTION
from tracker.vibration_direction import component, strongest_line_hz


@dataclass(frozen=True)
class Tuning:
    """Slow changes of the scale: what shows them, and when they matter."""

    #: [1] slow motion has frequencies up to this fraction of the vibration's, and up to `ceiling_hz` of the direction
    #: convention: as the baseline (`modal_id.data.baseline`)
    relative_bandwidth: float = 0.4
    #: [1] of the splines in a long record
    #: convention: as many as are solved in a second
    most_intervals: int = 200
    #: [frames] that are used
    #: convention: more tell nothing that matters, and their functions of time take memory
    most_frames: int = 200_000
    #: [frames] for each unknown
    frames_per_unknown: int = 3
    #: [1] share of the frames in which a marker must be seen
    least_seen: float = 0.7
    #: [1] probability with which noise causes such motion in a record
    #: statistics: one record of a million
    false_alarm: float = 1e-6
    #: [sd] motion is left where it can change no estimate by more
    #: statistics: a bias of that size raises an rms error by less than 5 %
    matters_sd: float = 0.3
    #: [1] ratio of the sd across and along the displacement of a marker that is used
    #: convention: one on a line of the image may slide along it
    most_anisotropy: float = 3.0
    #: [1] of the displacement whose products shorten the beam
    components: int = 3
    #: [1] multiple of the variance of noise that each of them has
    #: statistics: twice the standard deviation
    above_noise: float = 4.0
    #: [1] least share of the shortening that its fast part does not tell
    #: convention: terms beyond the quartic
    least_untold: float = 0.01
    #: [sd] beyond which a frame is left out
    #: statistics: noise alone never does
    outlier_sd: float = 6.0
    #: [px] error of a position that moves by a pixel or more across the displacement, for templates learned while it
    #: moved along it only; of less motion, in proportion
    #: measurement: 0.02 px to 0.03 px (rms) for codes in rendered films
    template_error: float = 0.03
    #: [1] of the scaled normal equations
    #: convention: a vibration near half the frame rate shortens the beam as slowly as the scale changes
    most_condition: float = 1e8


TUNING = Tuning()


@dataclass(frozen=True)
class SlowPart:
    """Coefficients of the splines of a quantity, shape (b,), their covariance, and degrees of freedom of its level."""

    coefficients: FloatArray
    covariance: FloatArray
    freedom: float

    @property
    def significant(self) -> bool:
        """Whether the quantity is not constant."""
        change, covariance = _changes(self.coefficients), _changes(_changes(self.covariance).T)
        statistic = float(change @ np.linalg.solve(covariance, change)) / change.size
        return bool(fdtrc(float(change.size), self.freedom, statistic) < TUNING.false_alarm)


@dataclass(frozen=True)
class MarkersInFrames:
    """Motion of m markers across and along their displacement in the n frames that show all of them.

    Attributes
    ----------
    time_s : array, shape (n,)
    rest, rest_sd : array, shape (m,)
        Usual positions across the displacement, and their standard deviations.
    across, along : array, shape (n, m)
    across_sd, along_sd : array, shape (m,)
        Typical standard deviations.
    knots, splines : array, shape (b + 4,), and sparse array, shape (n, b)
        Of slow functions of time over the whole record.
    turn_rad, frame_s : float
        Phase of the strongest vibration from one frame to the next, and the time between them.
    pixel : float
        Of the image in the unit of the motion, where markers are registered with templates; 0 otherwise.
    lossy : bool
        Whether frames are compressed with loss.
    """

    time_s: FloatArray
    rest: FloatArray
    rest_sd: FloatArray
    across: FloatArray
    across_sd: FloatArray
    along: FloatArray
    along_sd: FloatArray
    knots: FloatArray
    splines: csr_array
    turn_rad: float
    frame_s: float
    pixel: float
    lossy: bool

    @classmethod
    def of(
        cls,
        time_s: FloatArray,
        centred: FloatArray,
        variance: FloatArray,
        direction: FloatArray,
        rest: tuple[FloatArray, FloatArray],
        *,
        pixel: float,
        lossy: bool,
    ) -> MarkersInFrames | None:
        """Markers that move by (2, n, m), NaN where missing; None where too few show slow motion.

        With variances of x and y and covariance (3, n, m), the unit vector of the displacement (2,), and the usual
        positions with their errors, both (2, m). `pixel` and `lossy` as in the result.
        """
        turned = np.array([-direction[1], direction[0]])
        (along, along_sd), (across, across_sd) = (
            component(v, centred, variance) for v in (direction, turned)
        )
        seen = np.isfinite(along) & (along_sd > 0.0) & (across_sd > 0.0)
        chosen = [
            k
            for k, mask in enumerate(seen.T)
            if np.mean(mask) >= TUNING.least_seen
            and np.median(across_sd[mask, k]) <= TUNING.most_anisotropy * np.median(along_sd[mask, k])
        ]
        rows = np.all(seen[:, chosen], axis=1)
        if not chosen or np.count_nonzero(rows) < DIRECTION.least_frames:
            return None
        kept = _some_of_many(np.flatnonzero(rows))
        frame_s = float(np.median(np.diff(time_s)))
        line_hz = strongest_line_hz(along[:, chosen], frame_s)
        knots = _knots(time_s, min(TUNING.relative_bandwidth * line_hz, DIRECTION.ceiling_hz))
        shown = np.ix_(kept, np.array(chosen))
        return cls(
            time_s[kept],
            (turned @ rest[0])[chosen],
            np.hypot(*(turned[:, None] * rest[1]))[chosen],
            across[shown],
            np.median(across_sd[shown], axis=0),
            along[shown],
            np.median(along_sd[shown], axis=0),
            knots,
            spline_matrix(time_s[kept], knots),
            2.0 * np.pi * line_hz * frame_s,
            frame_s,
            pixel,
            lossy,
        )

    @cached_property
    def vibration(self) -> FloatArray:
        """Displacement less its slow part, shape (n, m)."""
        # Splines alone would follow a large vibration at the ends of the record.
        phase = self.turn_rad / self.frame_s * self.time_s
        waves = [self.splines.multiply(f(phase)[:, None]) for f in (np.cos, np.sin)]
        slow = smoothed(csr_array(hstack([self.splines, *waves])), self.along)[: self.splines.shape[1]]
        return np.asarray(self.along - self.splines @ slow)

    def slow_part(self, values: FloatArray, sd: float, others: FloatArray | None = None) -> SlowPart | None:
        """Slow part of a weighted sum of positions across the displacement, shape (n,), of standard deviation `sd`.

        ``others``, shape (n, k), are sums of unit variance that would not change slowly if the quantity were all that
        does; their own slow motion, with `k - 2` degrees of freedom in each spline, is an error of the quantity. None
        where noise and vibration leave it undetermined.
        """
        count, bent, shortened = self.splines.shape[1], *self._of_vibration()
        columns = np.column_stack([bent, shortened])
        if values.size < TUNING.frames_per_unknown * (count + columns.shape[1]):
            return None
        fit = _LeastSquares.of(self.splines, columns, np.ones(values.size, dtype=bool))
        if fit is not None:
            residual = np.abs(fit.residual(values))
            usual = max(sd, robust_sd(residual))
            fit = _LeastSquares.of(self.splines, columns, residual < TUNING.outlier_sd * usual)
        if fit is None:
            return None
        level, freedom = _level(fit.residual(values)[fit.used] / sd, count)
        noise = fit.inverse[:count, :count]
        if others is not None and others.shape[1] > 2:
            slow = _changes(fit.solve(others)[:count])
            power = float(np.sum(slow * np.linalg.solve(_changes(_changes(noise).T), slow)))
            level = max(level, math.sqrt(power / (slow.shape[0] * (others.shape[1] - 2))))
        # Errors of positions within the pixel do not average out where the position changes slowly.
        within = math.hypot(
            POSITION.lossy_share if self.lossy else POSITION.lossless_share, self._of_templates()
        )
        covariance = sd**2 * (level**2 * noise + within**2 * np.eye(count))
        # Of a frame that is exposed as long as possible the fast part of the shortening is smaller by this.
        untold = max(TUNING.least_untold, 1.0 - float(np.sinc(self.turn_rad / np.pi)))
        solution = fit.solve(values)
        error = untold * smoothed(self.splines, shortened @ solution[count + bent.shape[1] :])
        return SlowPart(solution[:count], covariance + np.outer(error, error), freedom)

    def _of_templates(self) -> float:
        """Sd of the errors within the pixel of templates, relative to that of a position in a frame."""
        slow = self.splines @ smoothed(self.splines, self.across)
        error = TUNING.template_error * np.minimum(np.ptp(slow, axis=0), self.pixel)
        return float(np.max(error / self.across_sd))

    def matters(self, relative: FloatArray) -> bool:
        """Whether a relative change of the displacement, coefficients (b,), may change what is estimated from it.

        By Cauchy and Schwarz the misfit in standard deviations of the samples bounds the change of any estimate in its
        own.
        """
        change = self.splines @ relative
        power = self.vibration**2 @ self.along_sd**-2.0
        change -= np.average(change, weights=power)
        return float(power @ change**2) > TUNING.matters_sd**2

    def _of_vibration(self) -> tuple[FloatArray, FloatArray]:
        """Functions of the vibration: components, shape (n, c), and what shortens the beam, shape (n, p).

        Components are those of a beam that is bent at rest, and of markers beside its centreline.
        """
        scaled = self.vibration / self.along_sd
        _, values, vectors = np.linalg.svd(scaled, full_matrices=False)
        kept = (values**2 > TUNING.above_noise * scaled.shape[0]) & (
            np.arange(values.size) < TUNING.components
        )
        parts = scaled @ vectors[kept].T
        products = [
            parts[:, a] * parts[:, b] for a, b in combinations_with_replacement(range(parts.shape[1]), 2)
        ]
        if parts.shape[1]:
            products.append(parts[:, 0] ** 4)
        return parts, np.column_stack(products) if products else np.zeros((scaled.shape[0], 0))


@dataclass(frozen=True)
class _LeastSquares:
    """Splines and other functions of time in all frames, and the inverse of their normal equations in those used."""

    splines: csr_array
    columns: FloatArray
    used: BoolArray
    inverse: FloatArray

    @classmethod
    def of(cls, splines: csr_array, columns: FloatArray, used: BoolArray) -> _LeastSquares | None:
        """None where the functions hardly differ."""
        seen, beside = splines[used], columns[used]
        cross = seen.T @ beside
        gram = np.block([[(seen.T @ seen).toarray(), cross], [cross.T, beside.T @ beside]])
        scale = 1.0 / np.sqrt(np.maximum(np.diag(gram), 1e-300))
        gram *= np.outer(scale, scale)
        if np.linalg.cond(gram) > TUNING.most_condition:
            return None
        return cls(splines, columns, used, np.linalg.inv(gram) * np.outer(scale, scale))

    def solve(self, values: FloatArray) -> FloatArray:
        """Coefficients of all functions for values in all frames, shape (n, ...)."""
        own = np.where(self.used if values.ndim == 1 else self.used[:, None], values, 0.0)
        return np.asarray(self.inverse @ np.concatenate([self.splines.T @ own, self.columns.T @ own]))

    def residual(self, values: FloatArray) -> FloatArray:
        """Values less the functions that are nearest to them, in all frames."""
        solution, count = self.solve(values), self.splines.shape[1]
        return np.asarray(values - self.splines @ solution[:count] - self.columns @ solution[count:])


def spline_matrix(time_s: FloatArray, knots: FloatArray) -> csr_array:
    """Cubic splines, which add up to 1, at times within the knots up to rounding; shape (n, b)."""
    # loads scipy.optimize, which results and reports need not
    from scipy.interpolate import BSpline  # noqa: PLC0415

    return csr_array(BSpline.design_matrix(np.clip(time_s, knots[0], knots[-1]), knots, 3))


def smoothed(functions: csr_array, values: FloatArray) -> FloatArray:
    """Coefficients of the functions of time, shape (n, b), that are nearest to values, shape (n, ...)."""
    # The least of those where a pause or a vibration near half the frame rate leaves them undetermined.
    return np.asarray(
        np.linalg.lstsq((functions.T @ functions).toarray(), functions.T @ values, rcond=None)[0]
    )


def _some_of_many(rows: NDArray[np.intp]) -> NDArray[np.intp]:
    """One row at random of each group of neighbours where there are too many, so that no vibration becomes slow."""
    size = -(-rows.size // TUNING.most_frames)
    if size < 2:
        return rows
    first = np.arange(0, rows.size - size + 1, size)
    return np.asarray(rows[first + np.random.default_rng(0).integers(size, size=first.size)])


def _knots(time_s: FloatArray, bandwidth_hz: float) -> FloatArray:
    start, end = float(time_s[0]), float(time_s[-1])
    intervals = int(np.clip(2.0 * bandwidth_hz * (end - start), 1, TUNING.most_intervals))
    inner = np.linspace(start, end, intervals + 1)
    return np.concatenate([np.full(3, start), inner, np.full(3, end)])


def _changes(coefficients: FloatArray) -> FloatArray:
    """Differences between neighbouring splines: those of a constant are 0, as splines add up to 1."""
    return np.asarray(np.diff(coefficients, axis=0))


def _level(residual: FloatArray, splines: int) -> tuple[float, float]:
    """Spectral level of a residual of unit sd beside that many splines, at least 1, and its degrees of freedom.

    From means of two stretches for each spline, of which the splines explain half.
    """
    stretches = np.array_split(residual, 2 * splines)
    means = np.array([np.sum(part) / np.sqrt(part.size) for part in stretches])
    near = float(np.sum(means**2)) / splines
    return math.sqrt(max(1.0, near, float(np.mean(residual**2)))), float(splines)


@dataclass(frozen=True)
class ScaleChange:
    """Scale relative to the first frame, a cubic spline over time, and its errors.

    Attributes
    ----------
    knots : array, shape (b + 4,)
        In the time of the series.
    coefficients : array, shape (b,)
        Of the scale.
    root : array, shape (b, b)
        Coefficients of functions whose independent standard normal multiples add up to the relative error.
    """

    knots: FloatArray
    coefficients: FloatArray
    root: FloatArray

    def scale(self, time_s: FloatArray) -> FloatArray:
        """Scale at times within the record, same shape."""
        return np.asarray(spline_matrix(time_s, self.knots) @ self.coefficients)

    @property
    def note(self) -> str:
        """What the user must know of a displacement that is corrected for it."""
        change = 100.0 * float(np.ptp(self.scale(np.linspace(self.knots[0], self.knots[-1], 1001))))
        return (
            f"The scale of the image changes by {change:.2g} % over the record (camera zoom or focus breathing): "
            "displacements are corrected by the spacing of the markers, and intervals include the error of that. Fix "
            "zoom and focus."
        )

    def rate_errors(self, time_s: FloatArray, power: FloatArray) -> FloatArray:
        """Errors in 1/s of a vibration's rate of growth, shape (b,), for unit multiples of the functions of `root`.

        ``power``, shape (n,), is its squared amplitude at times `time_s`, 0 where a sample is not used: with it, least
        squares weights the slope of the relative error.
        """
        lever = power * (time_s - np.average(time_s, weights=power))
        slope = spline_matrix(time_s, self.knots).T @ lever / float(lever @ time_s)
        return np.asarray(slope @ self.root)


def scale_change(seen: MarkersInFrames) -> ScaleChange | None:
    """Change of the scale that is significant and matters; None where there is none, or markers do not show it.

    Notes
    -----
    Least squares of the positions across the displacement in a frame on those at rest gives its scale. Splines of time
    are fitted to it together with the products of the components of the vibration, and with the components themselves,
    for a beam that is bent at rest. Errors include noise at its level near the slow band, slow motion of three and more
    markers that is no change of the scale, errors of positions within the pixel, and the part of the shortening that
    its fast part does not tell, because frames are averages over their exposure.
    """
    weight = seen.across_sd**-2.0
    lever = seen.rest - np.average(seen.rest, weights=weight)
    information = float(weight @ lever**2)
    # Markers beside each other, at the same place along the beam, are no measure of the scale.
    if not information > float(lever.size):
        return None
    relative = seen.across @ (weight * lever) / information
    left = seen.across - (seen.across @ weight / weight.sum())[:, None] - relative[:, None] * lever
    slow = seen.slow_part(relative, information**-0.5, left / seen.across_sd)
    if slow is None or not slow.significant or not seen.matters(slow.coefficients):
        return None
    # At the first frame the first spline is 1 and all others are 0.
    first = 1.0 + float(slow.coefficients[0])
    # Wrong distances make the whole change wrong by one factor.
    wrong = (slow.coefficients - slow.coefficients[0]) / information
    wrong *= float(np.linalg.norm(weight * lever * seen.rest_sd))
    values, vectors = np.linalg.eigh((slow.covariance + np.outer(wrong, wrong)) / first**2)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    return ScaleChange(seen.knots, (1.0 + slow.coefficients) / first, root)


def possible_zoom(seen: MarkersInFrames, distance: float) -> tuple[str, ...]:
    """A note where one marker moves slowly across its displacement: the camera moves, or the scale changes.

    Empty where a zoom about a point at this distance along the beam, in the unit of the motion, would not matter.
    """
    if seen.rest.size != 1:
        return ()
    slow = seen.slow_part(seen.across[:, 0] / distance, float(seen.across_sd[0]) / distance)
    if slow is None or not slow.significant or not seen.matters(slow.coefficients):
        return ()
    change = 100.0 * float(np.ptp(seen.splines @ slow.coefficients))
    note = (
        "The marker moves slowly along the beam: the camera moves, or its scale changes (zoom or focus breathing) and "
        f"with it the damping ratio. One marker does not show which: a zoom of {change:.2g} % about the middle of the "
        "image would move it as much. Fix camera, zoom and focus, or add a second marker along the beam."
    )
    return (note,)

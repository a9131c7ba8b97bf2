"""Likelihood of a decay for frames of a file that a converter of the frame rate may have chosen.

Frames are evenly spaced, or frame i shows the scene at ``floor(r i + phase)`` or, blended, between the two recorded
frames around ``r i + phase``; r is the number of recorded frames per frame of the file. Where r is an integer (every
second frame was left out), the frames are evenly spaced.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from modal_id.data import baseline_matrix
from modal_id.fit import ModalFit
from modal_id.modes.aliases import MOST_SAMPLES
from modal_id.modes.shapes import CLEAR_SD
from modal_id.posterior import LINE_BINS
from modal_id.solve import real_columns
from tracker import BoolArray, ComplexArray, FloatArray

Kind = Literal["moved", "blended", "inserted"]


@dataclass(frozen=True)
class Tuning:
    """The clock of converted frames."""

    #: [1] largest number of channels, those with most of the motion
    #: convention: Limits the computing time.
    most_channels: int = 24
    #: [1] largest number of components of the motion
    #: convention: Limits the computing time.
    most_components: int = 6
    #: [1] largest number of columns for the slow motion
    #: convention: It also follows a side band at a low frequency.
    most_slow: int = 64
    #: [1] number of stretches of the record that each have their own noise level
    #: measurement: With one, 4 of 200 random records with outliers and clicks were taken for converted ones.
    stretches: int = 8
    #: [samples] fewest rows for each column of the model; with fewer nothing is compared
    rows_per_column: int = 4
    #: [bins] least distance from the mode of the side bands that double images make
    #: measurement: Nearer ones were fitted to a frequency that changes and to the errors of a codec.
    separate_bins: float = 8.0
    #: [1] highest order of a side band that is removed from the modes
    highest_order: int = 8
    #: [1] least MAC of a side band with the strongest mode
    same_shape: float = 0.8
    #: [1] largest difference of its decay rate from the mode's beyond their errors, over the decay rate
    #: convention: Other side bands that are left bias the rate.
    same_rate: float = 0.2
    #: [steps] largest distance of a row from its place on an even grid
    #: physics: A displaced frame is off by a third of one (rms).
    even: float = 0.1


TUNING = Tuning()

# Powers of time in the envelopes of the strongest mode and of the others: a frequency that depends on the amplitude is
# no conversion, and the poles of a fit to evenly spaced frames are biased where the frames are not.
_ENVELOPE, _OTHER_ENVELOPES = (0, 1, 2, 3), (0, 1, 2)


class Waves(NamedTuple):
    """Each mode in each frame.

    Attributes
    ----------
    modes : complex array, shape (n, m)
    variance : array, shape (n,), or None
        Relative variance of the noise; None where it is the same in all frames.
    double : complex array, shape (n,), or None
        Shape of the error of the strongest mode's position in the double images of blended frames.
    """

    modes: ComplexArray
    variance: FloatArray | None = None
    double: ComplexArray | None = None


@dataclass(frozen=True)
class Clock:
    """A hypothesis: kind, recorded frames per frame of the file, and phase in recorded frames at the middle row."""

    kind: Kind
    ratio: float
    phase: float


@dataclass(frozen=True)
class ClockFit:
    """Minus twice the log-likelihood, residual in sd, amplitudes of the columns, number of parameters, modes fitted."""

    cost: float
    residual: FloatArray
    amplitudes: FloatArray
    parameters: int
    modes: BoolArray


@dataclass(frozen=True)
class DecayRecord:
    """Samples of a decay.

    Attributes
    ----------
    rows : int array, shape (n,)
        Numbers of the frames, from 0.
    values : array, shape (n, r)
        Combinations of channels with uncorrelated noise.
    poles : complex array, shape (m,)
        Of the modes, per frame.
    strongest : int
        Mode of the largest velocity.
    alike : bool array, shape (m,)
        Modes with its shape and decay rate.
    slow : array, shape (n, b)
        Orthonormal columns of slow motion, of which any amount is fitted beside the modes.
    steady_noise, predicted : bool
        Whether the variance of the noise tells which frames are means of two, and whether a codec predicted frames.
    """

    rows: NDArray[np.intp]
    values: FloatArray
    poles: ComplexArray
    strongest: int
    alike: BoolArray
    slow: FloatArray
    steady_noise: bool = True
    predicted: bool = False

    @property
    def length(self) -> int:
        """Frames from the first to the last."""
        return int(self.rows[-1]) + 1

    @cached_property
    def values_without_slow(self) -> FloatArray:
        """Values less their least squares of the slow motion, shape (n, r)."""
        return np.asarray(self.values - self.slow @ (self.slow.T @ self.values))

    @property
    def all_modes(self) -> BoolArray:
        """Mask of every mode; shape (m,)."""
        return np.ones(self.poles.size, dtype=bool)

    def only(self, kept: BoolArray) -> DecayRecord:
        """The record with these rows."""
        slow = np.linalg.qr(self.slow[kept])[0]
        return replace(self, rows=self.rows[kept], values=self.values[kept], slow=slow)

    def fit_clock(self, clock: Clock, *, exact: bool = True) -> ClockFit:
        """Least squares with the frames where the clock says, without the modes that it makes side bands.

        Either all at such places are, or those alone that look like the strongest mode; if `exact`, with the errors of
        double images or without: the best of all.
        """
        waves, near = self.waves(clock), self._near_side_bands(clock)
        alike = near & self.alike
        masks = [alike] if np.array_equal(alike, near) else [alike, near]
        fits = [self.fit(waves._replace(double=None), ~mask) for mask in masks]
        if exact and waves.double is not None:
            doubles = (self.fit(waves, ~mask) for mask in masks)
            fits += [fit for fit in doubles if _opposes_velocity(fit.amplitudes)]
        per_parameter = float(np.log(self.values.size))
        return min(fits, key=lambda one: one.cost + one.parameters * per_parameter)

    def _near_side_bands(self, clock: Clock) -> BoolArray:
        """Modes at a multiple of the clock's pattern from the strongest one; shape (m,)."""
        if clock.kind == "inserted":
            return self.alike
        cycles = self.poles.imag / (2.0 * np.pi)
        orders = np.arange(1, TUNING.highest_order + 1) * clock.ratio
        places = cycles[self.strongest] + np.concatenate([orders, -orders])
        beside = np.stack([cycles[:, None] - places, cycles[:, None] + places])
        near = np.any(np.abs(beside - np.rint(beside)) < LINE_BINS / self.length, axis=(0, 2))
        near[self.strongest] = False
        return np.asarray(near)

    def motion(self, even: ClockFit) -> tuple[FloatArray, FloatArray]:
        """Displacement and velocity per frame of the strongest mode, shape (n, r), in a fit of `evenly`."""
        # Its amplitudes come first.
        amplitudes = even.amplitudes[0] - 1j * even.amplitudes[1]
        motion = np.exp(self.rows * self.poles[self.strongest])[:, None] * amplitudes
        return motion.real, (self.poles[self.strongest] * motion).real

    def evenly(self) -> Waves:
        """Each mode in each frame of evenly spaced ones."""
        return Waves(np.exp(np.outer(self.rows, self.poles)))

    def waves(self, clock: Clock, share: float = 1.0) -> Waves:
        """Each mode in each frame, displaced from even spacing by this share of what the clock says.

        A marker in a blended frame is a double image. Its position is the mean of both to first order in their
        distance; for a symmetric marker, the error grows with its third power, and is odd about equal weights.
        """
        if clock.kind == "inserted":
            return Waves(np.exp(np.outer(np.arange(self.rows.size) / clock.ratio, self.poles)))
        _, part = self._recorded(clock, self.rows)
        if clock.kind == "moved":
            time = self.rows - share * part / clock.ratio
            return Waves(np.exp(np.multiply.outer(time, self.poles)))
        weight = np.clip(part, 0.0, 1.0)
        poles = self.poles / clock.ratio
        mean = (1.0 - weight)[:, None] + weight[:, None] * np.exp(poles)
        waves = np.exp(np.outer(self.rows, self.poles) - np.multiply.outer(weight, poles)) * mean
        strongest = self.poles[self.strongest]
        variance = weight**2 + (1.0 - weight) ** 2 if self.steady_noise else None
        if self._bins_beside(clock) < TUNING.separate_bins:
            return Waves(waves, variance)
        error = weight * (1.0 - weight) * (1.0 - 2.0 * weight)
        double = waves[:, self.strongest] * np.exp(2.0 * strongest.real * self.rows) * error
        return Waves(waves, variance, double)

    def mixing(self, clock: Clock) -> FloatArray:
        """Correlation of the noise of blended frames at lags of 1, 2 ... rows, which show the same recorded frames."""
        if clock.kind != "blended":
            return np.zeros(0)
        frame, part = self._recorded(clock, np.arange(self.length))
        shares = np.stack([1.0 - part, part]) / np.hypot(1.0 - part, part)
        found = []
        for lag in range(1, int(2.0 / clock.ratio) + 1):
            apart, first, later = frame[lag:] - frame[:-lag], shares[:, :-lag], shares[:, lag:]
            both = (apart == 0.0) * np.sum(first * later, axis=0) + (apart == 1.0) * first[1] * later[0]
            found.append(np.mean(both))
        return np.array(found)

    def _recorded(self, clock: Clock, rows: NDArray[np.intp]) -> tuple[FloatArray, FloatArray]:
        """The recorded frame that each row shows, and how far the row is beyond it, in recorded frames."""
        place = clock.ratio * (rows - self.length // 2) + clock.phase
        frame = np.floor(place + 1e-9)
        return frame, place - frame

    def _bins_beside(self, clock: Clock) -> float:
        """Cycles per record from the first side bands to the mode, or from the pattern to alternate frames."""
        own = self.poles[self.strongest].imag / (2.0 * np.pi)
        beside = np.array([clock.ratio, clock.ratio + 2.0 * own, clock.ratio - 2.0 * own, clock.ratio - 0.5])
        return float(np.min(np.abs(beside - np.rint(beside)))) * self.length

    def fit(self, model: Waves, kept: BoolArray) -> ClockFit:
        """Least squares of the amplitudes of the modes that are kept."""
        waves, variance, double = model
        time = (self.rows / self.length)[:, None]
        others = np.flatnonzero(kept & (np.arange(kept.size) != self.strongest))
        envelopes = [waves[:, self.strongest, None] * time ** np.array(_ENVELOPE)]
        envelopes += [waves[:, others] * time**power for power in _OTHER_ENVELOPES]
        envelopes += [] if double is None else [double[:, None]]
        columns, values = real_columns(np.concatenate(envelopes, axis=1)), self.values_without_slow
        # Least squares of the slow motion, also where the rows do not count the same.
        mixed = self.slow.T @ columns
        if variance is None:
            gram = columns.T @ columns - mixed.T @ mixed
        else:
            columns = (columns - self.slow @ mixed) / np.sqrt(variance)[:, None]
            values = values / np.sqrt(variance)[:, None]
            gram = columns.T @ columns
        scale = 1.0 / np.sqrt(np.diag(gram) + 1e-300)
        gram = gram * np.outer(scale, scale) + 1e-12 * np.eye(scale.size)
        amplitudes = scale[:, None] * np.linalg.solve(gram, scale[:, None] * (columns.T @ values))
        residual = values - columns @ amplitudes
        if variance is None:
            residual += self.slow @ (mixed @ amplitudes)
        edges = np.linspace(0, self.rows.size, TUNING.stretches + 1).astype(np.intp)
        counts = np.diff(edges)
        power = np.add.reduceat(residual**2, edges[:-1], axis=0) / counts[:, None]
        power = np.maximum(power, 1e-300)
        cost = float(counts @ np.sum(np.log(power), axis=1))
        if variance is not None:
            cost += values.shape[1] * float(np.sum(np.log(variance)))
        # A complex amplitude in each component, and two of the pole, which are known to the power -3/2 of the rows and
        # count three times each (P. M. Djuric, IEEE Trans. Signal Process. 44, 1996, p. 1744).
        parameters = int(np.count_nonzero(kept)) * (6 + 2 * values.shape[1])
        parameters += 0 if double is None else 2 * values.shape[1]
        residual /= np.sqrt(np.repeat(power, counts, axis=0))
        return ClockFit(cost, residual, amplitudes, parameters, kept)


def _opposes_velocity(amplitudes: FloatArray) -> bool:
    """Whether the errors of double images are in phase with minus the velocity, as the third power of the distance is.

    A position is where a template fits best, which is nearer to the stronger image than the mean is.
    """
    strongest, double = (amplitudes[k] - 1j * amplitudes[k + 1] for k in (0, -2))
    ratio = np.vdot(strongest, double)
    return bool(-ratio.imag > abs(ratio.real))


def decay_record(model: ModalFit) -> DecayRecord | None:
    """Samples of the rows in which all channels that count have one; None where there are too few.

    None, too, where they are uneven in time or free of noise.
    """
    data, fit = model.data, model.fit
    number = (data.time_s - data.time_s[0]) / data.step_s
    rows = np.rint(number).astype(np.intp)
    if np.any(np.abs(number - rows) > TUNING.even) or np.any(np.diff(rows) < 1):
        return None
    energy = np.abs(fit.linear.amplitudes) ** 2 / fit.linear.noise_variance
    rate = np.maximum(-fit.poles.real, 1.0 / data.span_s)
    strongest = int(np.argmax(np.sum(energy, axis=1) * np.abs(fit.poles) ** 2 / rate))
    most = np.argsort(-energy[strongest])[: TUNING.most_channels]
    used = np.flatnonzero(np.all(data.weights[:, most] > 0.0, axis=1))[:MOST_SAMPLES]
    columns = 2 * (len(_OTHER_ENVELOPES) * fit.poles.size + len(_ENVELOPE))
    if used.size < TUNING.rows_per_column * columns:
        return None
    sd = np.sqrt(np.maximum(fit.linear.noise_variance[most], 1e-300))
    cells = np.ix_(used, most)
    values = (data.values - fit.linear.baseline)[cells] / sd
    time_s = data.time_s[used]
    slow = baseline_matrix(time_s, min(model.bandwidth_hz, 0.5 * TUNING.most_slow / (time_s[-1] - time_s[0])))
    slow = np.linalg.qr(slow)[0]
    values += slow @ (slow.T @ (fit.linear.baseline[cells] / sd))
    shapes = fit.linear.amplitudes[:, most] / sd
    product = np.abs(shapes @ shapes[strongest].conj()) ** 2
    size = np.sum(np.abs(shapes) ** 2, axis=1)
    rate_sd = np.hypot(fit.pole_sd[:, 0], fit.pole_sd[strongest, 0])
    alike = product > TUNING.same_shape * size * size[strongest]
    alike &= (
        np.abs(fit.poles.real - fit.poles[strongest].real)
        < CLEAR_SD * rate_sd + TUNING.same_rate * rate[strongest]
    )
    alike[strongest] = False
    values = _components(values, fit.linear.residual[cells] / sd)
    if not values.shape[1]:
        return None
    return DecayRecord(rows[used] - rows[used[0]], values, fit.poles * data.step_s, strongest, alike, slow)


def _components(values: FloatArray, residual: FloatArray) -> FloatArray:
    """Combinations of the channels with most of the motion and with uncorrelated noise of unit variance."""
    axes = np.linalg.svd(values, full_matrices=False)[2][: TUNING.most_components].T
    noise = residual @ axes
    variance, turn = np.linalg.eigh(noise.T @ noise / noise.shape[0])
    # A combination without noise of its own would count as certain.
    known = variance > 1e-3 * variance[-1]
    return np.asarray(values @ axes @ turn[:, known] / np.sqrt(np.maximum(variance[known], 1e-300)))

"""Errors of positions that repeat with the motion, and what they add to the poles' sd.

Those of a tracker are estimated with the modes, those of frames predicted from others with what the codec leaves out;
rounding to multiples of a step is simulated; an error of the image's scale is one of all decay rates.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve

from modal_id.data import Projection, row_blocks
from modal_id.fit.modal_fit import ModalFit
from modal_id.fit.model_order import refit
from modal_id.solve import pole_slopes
from tracker import ComplexArray, DisplacementSeries, FloatArray, PositionErrors, ScaleChange


@dataclass(frozen=True)
class Tuning:
    """What a codec leaves out, errors that repeat with the motion, and rounding."""

    #: [sd] amplitude, in sd of the shrinkage, below which it shrinks in proportion
    #: physics: No motion is reversed.
    least_amplitude: float = 4.0
    #: [1] share of the samples that may differ from each other where values are rounded coarsely
    #: convention: Finer steps are below the noise.
    most_different: float = 0.25
    #: [steps] distance of a value from a multiple of the step that is a rounding error of the number itself
    exact_step: float = 1e-3
    #: [1] factor by which noise reduces the errors that return, below which they are ignored
    #: convention: They are then below a tenth of the other half of the error, which is noise.
    least_returning: float = 0.1
    #: [1] number of simulated records whose values are rounded
    #: statistics: Their standard deviation is known to a fifth.
    rounded_records: int = 16
    #: [sd] amplitude below which the shrinkage by a codec hardly changes
    small: float = 5.0
    #: [1] correlation length of the shrinkage in asinh(amplitude), and spacing of its knots
    correlation: float = 0.6
    #: [1] number of groups below which the variance of a repeating error must be clear
    few: int = 4
    #: [1] multiple of the noise variance that so few groups must show
    #: statistics: Two markers exceed it by chance in 5 % of records.
    chance: float = 4.0


TUNING = Tuning()


@dataclass(frozen=True)
class Omissions:
    """Errors of the channels of a fit in frames predicted from others.

    ``channels``, shape (k,), are indices in the series of the channels of `model`; with `mixed`, of those that its
    components stand for.
    """

    model: ModalFit
    errors: PositionErrors
    channels: NDArray[np.intp]
    mixed: Projection | None = None

    def without_mean(self) -> ModalFit:
        """The fit to data less the mean error; unchanged where none is expected."""
        if not np.any(self.errors.shrinkage[self.channels] > 0.0):
            return self.model
        data = self.model.data
        values = data.values.copy()
        for rows in row_blocks(data.time_s.size, _BLOCK):
            values[rows] -= self.mean(rows)
        corrected = replace(data, values=np.where(data.weights > 0.0, values, data.values))
        return refit(self.model, self.model.fit.poles, corrected)

    def mean(self, rows: slice) -> FloatArray:
        """Mean error of each channel or component of the model; shape (rows, k)."""
        errors, own = self.errors, self.channels
        mean = (-errors.shrinkage[own] - 1j * errors.lag[own]) * self._waves(rows, of_mean=True)
        return np.real(self._of_components(mean))

    def sd(self, rows: slice) -> FloatArray:
        """Standard deviation of the error's amplitude, for each channel or component; shape (rows, k)."""
        errors, own = self.errors, self.channels
        # The error of all channels is one function of the amplitude.
        sd = np.hypot(errors.shrinkage_sd[own], errors.lag_sd[own]) * self._waves(rows, of_mean=False)
        return np.abs(self._of_components(sd))

    def _waves(self, rows: slice, *, of_mean: bool) -> ComplexArray:
        """Motion of each of the `channels` over its amplitude, times the share of the errors there; (rows, k).

        Of several modes each loses its part of the whole.
        """
        functions = np.ascontiguousarray(self.model.fit.linear.columns[rows]).view(np.complex128)
        amplitudes = self.model.fit.linear.amplitudes
        if self.mixed is not None:
            amplitudes = amplitudes @ self.mixed.to_channels.T
        size = np.sqrt(np.abs(functions) ** 2 @ np.abs(amplitudes) ** 2)
        steps = frame_steps(self.model, self.errors, functions, amplitudes)
        waves = (
            functions
            @ amplitudes
            / np.hypot(size, TUNING.least_amplitude * self.errors.shrinkage_sd[self.channels])
        )
        for k, channel in enumerate(self.channels.tolist()):
            waves[:, k] *= self.errors.omitted(channel, steps[:, k], of_mean=of_mean)
            waves[:, k] *= self.errors.growth(channel, size[:, k])
        return np.asarray(waves)

    def _of_components(self, of_channels: ComplexArray) -> ComplexArray:
        return of_channels if self.mixed is None else of_channels @ self.mixed.from_channels.T


def frame_steps(
    model: ModalFit, errors: PositionErrors, functions: ComplexArray, amplitudes: ComplexArray
) -> FloatArray:
    """Amplitude of the change from one frame to the next; shape (n, k), of `functions` (n, m), `amplitudes` (m, k)."""
    # Of a sampled sine, whether it is aliased or not.
    turn = np.exp(1j * model.fit.poles.imag * errors.frame_s) - 1.0
    return np.asarray(np.sqrt(np.abs(functions * turn) ** 2 @ np.abs(amplitudes) ** 2))


def with_scale_errors(model: ModalFit, change: ScaleChange, start_s: float) -> ModalFit:
    """The fit with the error of the scale in the covariance of its poles; `start_s` is its first time in the series.

    A relative error that changes slowly grows or decays all modes alike: the decay rate of each is wrong by the slope
    of the error where the mode is strong, its frequency is not.
    """
    poles, data = model.fit.poles, model.data
    used = np.any(data.weights > 0.0, axis=1)
    time_s, size = data.time_s[used], np.zeros((2 * poles.size, change.root.shape[1]))
    for index, pole in enumerate(poles):
        power = np.exp(2.0 * np.minimum(pole.real, 0.0) * time_s)
        size[2 * index] = change.rate_errors(start_s + time_s, power)
    return model.with_repeating(size @ size.T)


def with_rounding_errors(model: ModalFit, series: DisplacementSeries, channels: NDArray[np.intp]) -> ModalFit:
    """The fit with the errors that rounding causes in its poles, added to ``repeating``.

    The standard deviations are those of fits of the same motion, about other values, rounded to the same step.

    Parameters
    ----------
    series : DisplacementSeries
        Its values are examined.
    channels : int array, shape (k,)
        Index in the series of each channel of `model`.

    Notes
    -----
    Noise of standard deviation s reduces the part of the error that returns with the motion by the factor
    ``exp(-2 pi^2 s^2 / step^2)``. Widrow, Kollar & Liu, IEEE Trans. Instrum. Meas. 45 (1996) 353,
    doi:10.1109/19.492748.
    """
    linear, data = model.fit.linear, model.data
    steps = np.array([_step(series.values[:, channel]) for channel in channels])
    noise = np.sqrt(np.maximum(linear.noise_variance - steps**2 / 12.0, 0.0))
    # the same as exp(-2 pi^2 (noise / step)^2) > least_returning
    reach = float(np.sqrt(-np.log(TUNING.least_returning) / 2.0)) / np.pi
    coarse = np.flatnonzero((steps > 0.0) & (noise < reach * steps))
    if not coarse.size:
        return model
    rng = np.random.default_rng(0)
    fitted, shifts = data.values - linear.residual, []
    for _ in range(TUNING.rounded_records):
        values = fitted + noise * rng.standard_normal(fitted.shape)
        about = steps * rng.random(steps.size)
        rounded = values.copy()
        of_step = (values[:, coarse] + about[coarse]) / steps[coarse]
        rounded[:, coarse] = steps[coarse] * np.round(of_step) - about[coarse]
        shift = refit(model, model.fit.poles, replace(data, values=rounded)).fit.poles - model.fit.poles
        shifts.append(np.column_stack([shift.real, shift.imag]).ravel())
    return model.with_repeating(np.array(shifts).T @ np.array(shifts) / TUNING.rounded_records)


def _step(values: FloatArray) -> float:
    """Step of which all values are multiples, but for an offset; 0 where they are not rounded coarsely."""
    finite = values[np.isfinite(values)]
    different = np.unique(finite)
    if not 2 < different.size < TUNING.most_different * finite.size:
        return 0.0
    apart = np.diff(different)
    apart = apart[apart > 1e-9 * float(np.max(np.abs(different)))]
    step = float(np.min(apart, initial=np.inf))
    places = (different - different[0]) / step
    return step if np.all(np.abs(places - np.round(places)) < TUNING.exact_step) else 0.0


# Samples at a time: the functions of time are dozens for each channel, and would take most memory of a long record.
_BLOCK = 8192
# Most groups of neighbouring channels whose poles are compared.
_GROUPS = 8


def without_repeating_errors(
    model: ModalFit,
    errors: PositionErrors,
    channels: NDArray[np.intp],
    mixed: Projection | None = None,
    *,
    level: float = 1.0,
) -> ModalFit:
    """Fit of the modes with the errors of positions marginalised.

    Parameters
    ----------
    errors : PositionErrors
        Of all channels of the series.
    channels : int array, shape (k,)
        Index in the series of each channel of `model`; with `mixed`, of each channel that its components stand for.
    mixed : Projection or None
        Of the channels on the components of `model`.
    level : float
        Spectral level of the residual near the modes relative to white noise, as a factor on standard deviations.

    Returns
    -------
    ModalFit
        Fitted to data less the most probable errors. ``repeating`` is the covariance of (Re, Im) of each pole in turn
        due to the remaining uncertainty of the errors, to be added to that of noise.

    Notes
    -----
    Every error is a sum of known functions of time with normal coefficients of known variance: one linear
    least-squares step from the fit, jointly for poles, amplitudes, baselines and these coefficients. The periodic
    error of each marker has its own coefficients, which show in the harmonics of the motion; the shrinkage of motions
    by a codec is one function of the amplitude for all markers; if frames are predicted from others, it has a mean,
    which is subtracted first, and ends where the motion is fast.
    The errors add the marginal less the conditional covariance of the poles. The periodic errors of many channels
    average out in their components, those of the stations of a line in compressed frames only as far as their places in
    the block differ: they are not estimated, but the covariance that they cause is added. Where the poles of the
    channels of a line, or of markers in predicted frames, scatter by more than noise explains, that is added, too.
    Noise of a higher `level` determines the coefficients less: as white noise, the irregular errors of a codec would be
    taken for functions of the amplitude, and the poles would follow.
    """
    model = Omissions(model, errors, channels, mixed).without_mean()
    q, data, linear = 2 * model.fit.poles.size, model.data, model.fit.linear
    functions = _Functions.of(model, errors, channels, mixed)
    variance = level**2 * linear.noise_variance
    parts = _inner_products(functions)
    first = slice(0, q + functions.shared_count)
    information, gradient = np.zeros((first.stop,) * 2), np.zeros(first.stop)
    information[q:, q:] += np.eye(functions.shared_count)
    eliminated = []
    for k, part in enumerate(parts):
        gram, score = (product / variance[k] for product in (part.projected, part.score))
        cross = gram[first, first.stop :]
        own = gram[first.stop :, first.stop :] + np.eye(cross.shape[1])
        bound = np.linalg.solve(own, np.column_stack([cross.T, score[first.stop :]]))
        information += gram[first, first] - cross @ bound[:, :-1]
        gradient += score[first] - cross @ bound[:, -1]
        eliminated.append(bound)
    covariance = np.linalg.pinv(information, hermitian=True)
    solution = covariance @ gradient
    values = data.values.copy()
    for rows in functions.blocks():
        for k, (columns, bound) in enumerate(zip(functions.columns(rows), eliminated, strict=True)):
            known = np.concatenate([solution[q:], bound[:, -1] - bound[:, :-1] @ solution])
            values[rows, k] -= columns[:, q:] @ known
    corrected = replace(data, values=np.where(data.weights > 0.0, values, data.values))
    fitted = refit(model, model.fit.poles, corrected)
    repeating = _positive(covariance[:q, :q] - level**2 * model.fit.covariance)
    more = _scatter(functions, parts) if mixed is None else _of_periodic_errors(functions, parts, mixed)
    return replace(fitted, repeating=repeating + more)


@dataclass(frozen=True)
class _Functions:
    """Functions of time whose multiples change the fit, or are errors of positions, for some samples at a time.

    ``amplitudes``, shape (m, k), are those of the modes in each of the `channels`; ``strong`` the modes that a codec
    may shrink by more than they are, none without compression; ``knots`` and ``root`` those of the shrinkage.
    """

    model: ModalFit
    errors: PositionErrors
    channels: NDArray[np.intp]
    mixed: Projection | None
    amplitudes: ComplexArray
    strong: NDArray[np.intp]
    knots: FloatArray
    root: FloatArray

    @classmethod
    def of(
        cls, model: ModalFit, errors: PositionErrors, channels: NDArray[np.intp], mixed: Projection | None
    ) -> _Functions:
        """The functions of a fit; arguments as of `without_repeating_errors`."""
        sd, amplitudes, poles = errors.shrinkage_sd[channels], model.fit.linear.amplitudes, model.fit.poles
        if mixed is not None:
            amplitudes = amplitudes @ mixed.to_channels.T
        strong = np.flatnonzero((np.max(np.abs(amplitudes) - sd, axis=1) > 0.0) & np.any(sd > 0.0))
        knots = np.zeros(0)
        if strong.size:
            growth = max(1.0, float(np.max(np.exp(poles.real * model.data.span_s))))
            largest = growth * float(np.max(np.abs(amplitudes[strong]) / (TUNING.small * sd)))
            knots = np.arange(0.0, np.arcsinh(largest) + TUNING.correlation, TUNING.correlation)
        root = np.asarray(np.linalg.cholesky(_kernel(knots, knots) + 1e-6 * np.eye(knots.size)), dtype=float)
        return cls(model, errors, channels, mixed, amplitudes, strong, knots, root)

    @property
    def shared_count(self) -> int:
        """Number of functions whose multiples all channels share."""
        return (1 + self._lags) * self.strong.size * self.knots.size

    @property
    def _lags(self) -> bool:
        """Whether the codec causes errors out of phase."""
        return bool(np.any(self.errors.lag_sd[self.channels] > 0.0))

    def blocks(self) -> Iterator[slice]:
        """Rows of all samples, some at a time."""
        return row_blocks(self.model.data.time_s.size, _BLOCK)

    def columns(self, rows: slice) -> Iterator[FloatArray]:
        """For each channel of the model: slopes of the poles, the shared functions, its own; shape (rows, c)."""
        shared = self._shared(rows)
        if self.mixed is None:
            own = (self.periodic(rows, k) for k in range(self.channels.size))
            yield from (np.column_stack(parts) for parts in zip(self.slopes(rows), shared, own, strict=True))
            return
        rows_count, components = self.model.data.time_s[rows].size, self.mixed.from_channels.shape[0]
        total = np.zeros((components, rows_count, self.shared_count))
        for weight, functions in zip(self.mixed.from_channels.T, shared, strict=True):
            total += weight[:, None, None] * functions
        yield from (np.column_stack(parts) for parts in zip(self.slopes(rows), total, strict=True))

    def slopes(self, rows: slice) -> Iterator[FloatArray]:
        """For each channel of the model its change with (Re, Im) of each pole in turn; shape (rows, 2 m)."""
        slopes, weights = pole_slopes(self.model.data.time_s, self.model.fit.linear)
        yield from (slopes[rows] @ weight for weight in weights)

    def periodic(self, rows: slice, k: int) -> FloatArray:
        """Functions of the periodic error of one of the `channels`; shape (rows, p)."""
        linear = self.model.fit.linear
        motion = np.real(self._modes(rows) @ self.amplitudes[:, k])
        if self.mixed is None:
            motion = motion + linear.splines[rows] @ linear.slow[:, k]
        return self.errors.periodic(int(self.channels[k]), motion)

    def _modes(self, rows: slice) -> ComplexArray:
        return np.ascontiguousarray(self.model.fit.linear.columns[rows]).view(np.complex128)

    def _shared(self, rows: slice) -> Iterator[FloatArray]:
        """For each of the `channels` the errors in and out of phase with each strong mode; shape (rows, c)."""
        functions, errors = self._modes(rows), self.errors
        if not self.strong.size:
            yield from (np.zeros((functions.shape[0], 0)) for _ in self.channels)
            return
        steps = frame_steps(self.model, errors, functions, self.amplitudes)
        for k, channel in enumerate(self.channels.tolist()):
            sd, columns = errors.shrinkage_sd[channel], []
            omitted = errors.omitted(channel, steps[:, k])
            for mode in self.strong:
                motion = self.amplitudes[mode, k] * functions[:, mode]
                size = np.abs(motion)
                wave = motion / np.maximum(size, 1e-300)
                smooth = np.linalg.solve(
                    self.root, _kernel(self.knots, np.arcsinh(size / (TUNING.small * sd)))
                )
                smooth *= omitted * errors.growth(channel, size)
                columns.append((sd * wave.real * smooth).T)
                if self._lags:
                    columns.append((errors.lag_sd[channel] * wave.imag * smooth).T)
            yield np.column_stack(columns)


@dataclass(frozen=True)
class _Products:
    """Inner products of the functions of one channel: with each other and with the residual; their projection.

    ``projected`` is their Gram matrix with the mode functions and the baseline projected out; ``fast`` and ``slow``
    are the coefficients of these, shapes (2 m, c) and (b, c).
    """

    projected: FloatArray
    score: FloatArray
    fast: FloatArray
    slow: FloatArray


def _inner_products(functions: _Functions) -> list[_Products]:
    """Products of each channel of the model."""
    data, linear, problem = functions.model.data, functions.model.fit.linear, functions.model.problem
    sums: dict[int, list[FloatArray]] = {}
    for rows in functions.blocks():
        for k, columns in enumerate(functions.columns(rows)):
            weighted = data.weights[rows, k : k + 1] * columns
            products = [
                problem.sparse[rows].T @ weighted,
                linear.columns[rows].T @ weighted,
                weighted.T @ columns,
                weighted.T @ linear.residual[rows, k],
            ]
            sums[k] = [a + b for a, b in zip(sums[k], products, strict=True)] if k in sums else products
    group_of = {int(c): group for group, (members, _) in enumerate(data.groups) for c in members}
    found = []
    for k, (cross, inner, gram, score) in sums.items():
        part, own = problem.slow[group_of[k]], linear.factors[group_of[k]]
        both = inner - own.slow.T @ cross
        fast, bound = cho_solve(own.factor, both, check_finite=False), part.factor.solve(cross)
        projected = gram - cross.T @ bound - both.T @ fast
        found.append(_Products(projected, score, fast, bound - own.slow @ fast))
    return found


def _scatter(functions: _Functions, parts: list[_Products]) -> FloatArray:
    """Covariance of the poles, shape (2 m, 2 m), that groups of neighbouring channels show beyond that of noise.

    Where several markers or stations have the same codec, the jackknife over groups of correlated channels, in one
    step from the fit. MacKinnon & White, J. Econometrics 29 (1985) 305, doi:10.1016/0304-4076(85)90158-7.
    """
    model, count = functions.model, min(_GROUPS, len(parts))
    q, covariance = 2 * model.fit.poles.size, model.fit.covariance
    if count < 2 or not (functions.errors.alike or (functions.errors.predicted and functions.strong.size)):
        return np.zeros_like(covariance)
    variance = model.fit.linear.noise_variance
    information = np.array([part.projected[:q, :q] / v for part, v in zip(parts, variance, strict=True)])
    scores = np.array([part.score[:q] / v for part, v in zip(parts, variance, strict=True)])
    total, scatter = np.sum(information, axis=0), np.zeros((q, q))
    for group in np.array_split(np.arange(len(parts)), count):
        without = np.linalg.pinv(total - np.sum(information[group], axis=0), hermitian=True)
        step = without @ np.sum(scores[group], axis=0)
        scatter += (count - 1.0) / count * np.outer(step, step)
    if count < TUNING.few and np.all(np.diag(scatter) < TUNING.chance * np.diag(covariance)):
        return np.zeros_like(covariance)
    return _positive(scatter - covariance)


def _of_periodic_errors(functions: _Functions, parts: list[_Products], mixed: Projection) -> FloatArray:
    """Covariance of the poles, shape (2 m, 2 m), due to the periodic errors of the channels behind components."""
    model, q = functions.model, 2 * functions.model.fit.poles.size
    linear, weights = model.fit.linear, model.data.weights
    scores: dict[int, FloatArray] = {}
    for rows in functions.blocks():
        sensitivity = []
        for k, (slopes, part) in enumerate(zip(functions.slopes(rows), parts, strict=True)):
            left = slopes - linear.columns[rows] @ part.fast[:, :q]
            left -= model.problem.sparse[rows] @ part.slow[:, :q]
            sensitivity.append(weights[rows, k : k + 1] * left / linear.noise_variance[k])
        for channel, weight in enumerate(mixed.from_channels.T):
            own = sum(w * s for w, s in zip(weight, sensitivity, strict=True)).T
            scores[channel] = scores.get(channel, 0.0) + own @ functions.periodic(rows, channel)
    if functions.errors.alike:
        # One set of coefficients for all: stations at the same place in the block have the same error.
        total = np.sum(list(scores.values()), axis=0)
        score = total @ total.T
    else:
        score = sum(one @ one.T for one in scores.values())
    return np.asarray(model.fit.covariance @ score @ model.fit.covariance)


def _kernel(one: FloatArray, other: FloatArray) -> FloatArray:
    return np.asarray(np.exp(-0.5 * ((one[:, None] - other[None, :]) / TUNING.correlation) ** 2))


def _positive(covariance: FloatArray) -> FloatArray:
    """The nearest matrix without negative eigenvalues: rounding may leave small ones."""
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)

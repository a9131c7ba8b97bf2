"""Known input: what it must be, its values at any time and lag, its transform, and the linear columns of modes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numba import njit
from numpy.polynomial.legendre import legvander
from scipy.fft import irfft, rfft
from scipy.interpolate import BSpline, CubicSpline, make_interp_spline

from modal_id.data import runs
from modal_id.sentences import Reason, Refusal
from modal_id.solve import mode_functions
from tracker import BoolArray, ComplexArray, DisplacementSeries, FloatArray, KnownInput


@dataclass(frozen=True)
class Tuning:
    """Inputs that are refused, integration of one time step, interpolation of the input, slow columns."""

    #: [samples] shortest run at an extreme value that is clipped
    least_run: int = 3
    #: [1] resolutions between a clipped value and those beside the run
    #: physics: A parabola that is constant to one resolution over three samples falls by less than five to the next.
    steps: float = 5.0
    #: [1] share of missing samples of a channel whose whole spectrum is needed, above which a record is refused
    #: physics: A filled sample has at most the power of the motion: the density changes by up to twice the share, the
    #: same for all frequencies of a mode; frequency and damping ratio do not.
    most_missing: float = 0.1
    #: [1] share of the rows with an output, between the first and the last, below which the rates differ
    #: convention: Every second row; lost frames are fewer.
    least_outputs: float = 0.55
    #: [1] least number of changes of an input that is held between them
    #: statistics: Of values that are free to change, as many would not all be apart by two samples and more.
    least_changes: int = 20
    #: [1] largest |lambda| h at which the integrals of a step are summed as a series
    #: physics: The recursion that is used above it loses three digits here, and more below.
    series: float = 0.3
    #: [1] relative change of the time step above which its integrals are computed again
    #: physics: Time stamps are rounded to about nine digits.
    same_step: float = 1e-9
    #: [1] step of the derivative with respect to lambda, over |Re lambda| + 1 / span
    #: physics: Error of the central difference 1e-10, of rounding 1e-11.
    difference: float = 1e-5
    #: [1] degree of the spline between the samples
    #: physics: At 0.6 of the Nyquist frequency, the highest of the fit, it changes a sinusoid by 0.5 % at most.
    degree: int = 7
    #: [samples] by which it is continued beyond both ends of the input
    #: physics: What its ends change falls by 0.535 a sample, its largest root: to 3e-7 over as many.
    beyond: int = 24
    #: [1] degree of the polynomial of the drift
    #: physics: The transform leaks the steps of the drift's value and first derivatives between both ends.
    drift_degree: int = 3


TUNING = Tuning()
MOST_MISSING = TUNING.most_missing


def sparse_outputs(series: DisplacementSeries, known: KnownInput) -> Refusal | None:
    """Why the outputs do not belong to the rows of the input; None where they do, or where there are none at all."""
    recorded = np.any(np.isfinite(series.values), axis=1)
    rows = np.flatnonzero(recorded)
    if not rows.size:
        return None
    share = float(np.mean(recorded[rows[0] : rows[-1] + 1]))
    if share >= TUNING.least_outputs:
        return None
    return Reason.OUTPUTS_SPARSE(percent=100.0 * share, input=known.name)


def unusable(values: FloatArray, recorded: BoolArray, known: KnownInput) -> Refusal | None:
    """Why an input cannot be used; None where it can.

    Parameters
    ----------
    values : array, shape (n,)
        The input at the rows of the fit; NaN where missing.
    recorded : bool array, shape (n,)
        Rows with an output.
    known : KnownInput
    """
    seen = np.isfinite(values)
    missing = float(np.mean(~seen[recorded]))
    if missing > MOST_MISSING:
        percent, most = 100.0 * missing, 100.0 * MOST_MISSING
        return Reason.INPUT_MISSING(input=known.name, percent=percent, most_percent=most)
    values = values[seen]
    spread = float(np.std(values))
    if np.ptp(values) == 0.0 or spread < 2.0 * known.sd:
        return Reason.INPUT_STILL(input=known.name, sd=spread, unit=known.unit, noise=known.sd)
    apart = np.diff(np.flatnonzero(np.diff(values)))
    if apart.size >= TUNING.least_changes and np.min(apart) > 1:
        return Reason.INPUT_HELD(input=known.name, count=np.median(apart))
    if _is_clipped(values):
        return Reason.INPUT_CLIPPED(input=known.name)
    return None


def _is_clipped(values: FloatArray) -> bool:
    """Whether the input stays at an extreme value to which it came in larger steps than its resolution.

    A slow or coarsely quantised peak also repeats its extreme value, but leaves it by one or two steps.
    """
    steps = np.diff(np.unique(values))
    for turned in (values, -values):
        top = float(np.max(turned))
        for start, end in runs(turned == top):
            beside = np.append(turned[max(start - 1, 0) : start], turned[end : end + 1])
            if (
                end - start >= TUNING.least_run
                and beside.size
                and np.all(top - beside > TUNING.steps * np.min(steps))
            ):
                return True
    return False


_SERIES, _SAME_STEP = TUNING.series, TUNING.same_step


@dataclass(frozen=True)
class Drive:
    """An input between its samples: a cubic spline, of which the response is integrated exactly.

    Attributes
    ----------
    steps_s : array, shape (n - 1,)
        From each sample to the next; may differ.
    coefficients : array, shape (4, n - 1)
        Of the polynomial in the time from the sample before, highest power first.
    """

    steps_s: FloatArray
    coefficients: FloatArray

    def response(self, pole: complex) -> ComplexArray:
        """Solution z of ``z' = lambda z + u``, ``z = 0`` at the first sample, at the samples; shape (n,).

        Exact for the spline whatever the time step. The error is that of the spline: for an input at frequency f
        sampled at rate r about ``(2 pi f / r)^4 / 720``.
        """
        return _response(complex(pole), self.steps_s, self.coefficients)

    def at_samples(self) -> FloatArray:
        """The input at the samples, gaps filled; shape (n,)."""
        end = np.polyval(self.coefficients[:, -1], self.steps_s[-1])
        return np.append(self.coefficients[3], end)

    def curvature(self) -> FloatArray:
        """Second derivative of the input at the samples; shape (n,)."""
        end = 2.0 * self.coefficients[1, -1] + 6.0 * self.coefficients[0, -1] * self.steps_s[-1]
        return np.append(2.0 * self.coefficients[1], end)

    def derivative(self) -> Drive:
        """The first derivative of the input, itself an input."""
        a, b, c, _ = self.coefficients
        return Drive(self.steps_s, np.stack([np.zeros(a.size), 3.0 * a, 2.0 * b, c]))

    def slope(self, pole: complex) -> ComplexArray:
        """Derivative of the response with respect to lambda, of which it is an analytic function; shape (n,)."""
        step = TUNING.difference * (abs(pole.real) + 1.0 / float(np.sum(self.steps_s)))
        return (self.response(pole + step) - self.response(pole - step)) / (2.0 * step)


def drive(time_s: FloatArray, values: FloatArray) -> Drive:
    """The input between samples; `values`, shape (n,), are taken through a gap (NaN) by the spline of the others."""
    seen = np.isfinite(values)
    spline = CubicSpline(time_s[seen], values[seen])
    if not seen.all():
        spline = CubicSpline(time_s, spline(time_s))
    return Drive(np.diff(time_s), np.ascontiguousarray(spline.c))


@njit(cache=True, nogil=True, error_model="numpy")
def _response(pole: complex, steps_s: FloatArray, coefficients: FloatArray) -> ComplexArray:
    found = np.zeros(steps_s.size + 1, np.complex128)
    integrals = np.zeros(4, np.complex128)
    growth, step = 1.0 + 0.0j, -1.0
    for at in range(steps_s.size):
        if abs(steps_s[at] - step) > _SAME_STEP * step or step < 0.0:
            step = steps_s[at]
            growth = np.exp(pole * step)
            _integrals(pole, step, growth, integrals)
        total = growth * found[at]
        for power in range(4):
            total += coefficients[3 - power, at] * integrals[power]
        found[at + 1] = total
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def _integrals(pole: complex, step: float, growth: complex, into: ComplexArray) -> None:
    """Integrals of ``exp(lambda (h - s)) s^p`` over s from 0 to h, p = 0..3."""
    if abs(pole * step) > _SERIES:
        into[0] = (growth - 1.0) / pole
        for power in range(1, 4):
            into[power] = (power * into[power - 1] - step**power) / pole
        return
    for power in range(4):
        term = step ** (power + 1) / (power + 1) + 0.0j
        into[power] = term
        for k in range(1, 16):
            term *= pole * step / (k + power + 1)
            into[power] += term


@dataclass(frozen=True)
class Channel:
    """The input as a function of time.

    Attributes
    ----------
    spline : BSpline
        Through the samples, gaps filled.
    start_s, end_s : float
        First and last sample.
    """

    spline: BSpline
    start_s: float
    end_s: float

    @classmethod
    def through(cls, time_s: FloatArray, values: FloatArray) -> Channel:
        """Of samples, shape (n,), NaN where missing."""
        # Continued by its image in both end points: a spline that ends at a sample oscillates there, and what it adds
        # to all frequencies moves the lag (broad record 26 of benchmarks/known_input.py: 2 mm, 5 sd of the lag).
        longer_s, filled = (
            np.pad(one, TUNING.beyond, mode="reflect", reflect_type="odd")
            for one in (time_s, drive(time_s, values).at_samples())
        )
        spline = make_interp_spline(longer_s, filled, TUNING.degree)
        return cls(spline, float(time_s[0]), float(time_s[-1]))

    def at(self, time_s: FloatArray, lag_s: float) -> FloatArray:
        """The input of which the record at `time_s` is `lag_s` late; shape (n,).

        Before the first and after the last sample it is that sample.
        """
        return np.asarray(self.spline(np.clip(time_s + lag_s, self.start_s, self.end_s)), dtype=np.float64)


#: Columns beside those of the modes: the input, its second derivative (the modes above the band), the polynomial.
FIXED = 2 + TUNING.drift_degree + 1
#: Columns of a mode: real and imaginary parts of the response to the input and of the free decay.
PER_MODE = 4


@dataclass(frozen=True)
class Samples:
    """Outputs and input at the same times, compared in a band of the bins of a Fourier transform over the samples.

    The transform is orthogonal, and the columns are computed in time and transformed like the outputs: no window, no
    leakage, and no assumption of a periodic input. Uneven times only blur the frequency that belongs to a bin.

    Attributes
    ----------
    time_s : array, shape (n,)
    values : array, shape (n, k)
        Outputs; where they are missing, any value.
    given : bool array, shape (n, k)
    input : array, shape (n,)
    last : int
        Number of bins compared, from the first one on.
    channel : Channel or None
        Where the lag of the input is estimated, what gives the input at any lag.
    lag_s : float
        By which `input` was late.
    """

    time_s: FloatArray
    values: FloatArray
    given: BoolArray
    input: FloatArray
    last: int
    channel: Channel | None = None
    lag_s: float = 0.0

    @cached_property
    def drive(self) -> Drive:
        """The input between its samples."""
        return drive(self.time_s, self.input)

    @property
    def span_s(self) -> float:
        """From the first time to the last."""
        return float(self.time_s[-1] - self.time_s[0])

    @property
    def step_s(self) -> float:
        """Mean time step."""
        return self.span_s / (self.time_s.size - 1)

    @cached_property
    def frequency_hz(self) -> FloatArray:
        """Of the bins compared; shape (b,)."""
        n = self.time_s.size
        return np.arange(self.last) * (n - 1) / (n * self.span_s)

    @cached_property
    def share_given(self) -> FloatArray:
        """Share of the samples of each output that is not missing; shape (k,)."""
        return np.asarray(np.mean(self.given, axis=0))

    def bins(self, values: FloatArray) -> ComplexArray:
        """Transform of columns, shape (n, c), at the bins; the parts of white noise keep its variance."""
        found = rfft(values, axis=0)[: self.last]
        return np.asarray(found * np.sqrt(2.0 / values.shape[0]))

    def rows(self, values: FloatArray) -> FloatArray:
        """Real parts of the transform above imaginary parts; shape (2 b, c)."""
        found = self.bins(values)
        return np.concatenate([found.real, found.imag])

    @cached_property
    def outputs(self) -> FloatArray:
        """Outputs as `rows`, shape (2 b, k)."""
        return self.rows(self.values)

    @cached_property
    def input_bins(self) -> ComplexArray:
        """Transform of the input at the bins; shape (b,)."""
        return self.bins(self.drive.at_samples()[:, None])[:, 0]

    @cached_property
    def content_bins(self) -> ComplexArray:
        """Transform of the input less what the jump between its ends leaks to all frequencies; shape (b,).

        A line makes the value the same at both ends; slopes are too noisy to be made the same.
        """
        values = self.drive.at_samples()
        line = (values[-1] - values[0]) * (self.time_s - self.time_s[0]) / self.span_s
        return self.bins((values - line)[:, None])[:, 0]

    def to_time(self, bins: ComplexArray) -> FloatArray:
        """The series, shape (n,), whose transform is `bins` in the band and 0 elsewhere."""
        whole = np.zeros(self.time_s.size // 2 + 1, dtype=complex)
        whole[: self.last] = bins / np.sqrt(2.0 / self.time_s.size)
        return np.asarray(irfft(whole, self.time_s.size))

    def with_lag(self, lag_s: float) -> Samples:
        """The same with the input of another lag."""
        if self.channel is None:
            return self
        return replace(self, input=self.channel.at(self.time_s, lag_s), lag_s=lag_s)

    def late(self, channel: Channel, lag_s: float, reach_s: float = 0.0) -> Samples:
        """The rows at which the input of all lags within `reach_s` of one was recorded; without reach, of a fixed lag.

        Rows without an input at the ends would be filled by the fitted motion, of which what the first rounds leave is
        taken for strongly damped modes (seed 1009 of the broad records of benchmarks/known_input.py).
        """
        late_s = self.time_s + lag_s
        known = np.flatnonzero((late_s - reach_s >= channel.start_s) & (late_s + reach_s <= channel.end_s))
        return replace(
            self,
            time_s=self.time_s[known],
            values=self.values[known],
            given=self.given[known],
            input=channel.at(self.time_s[known], lag_s),
            last=self.last * known.size // self.time_s.size,
            channel=channel if reach_s > 0.0 else None,
            lag_s=lag_s,
        )

    def of_lag(self, poles: ComplexArray, coefficients: FloatArray) -> FloatArray:
        """Derivative of the motion that the input causes with respect to its lag, as `rows`; shape (2 b, k)."""
        slope = self.drive.derivative()
        columns = np.zeros((self.time_s.size, coefficients.shape[0]))
        columns[:, 0], columns[:, 1] = slope.at_samples(), slope.curvature()
        for index, pole in enumerate(poles):
            driven = slope.response(pole)
            columns[:, FIXED + PER_MODE * index] = driven.real
            columns[:, FIXED + PER_MODE * index + 1] = driven.imag
        return self.rows(columns @ coefficients)

    def in_time(self, poles: ComplexArray) -> FloatArray:
        """Columns of the fit, shape (n, FIXED + PER_MODE m): input, its second derivative, drift, four of each mode."""
        unit = 2.0 * (self.time_s - self.time_s[0]) / self.span_s - 1.0
        values = self.drive.at_samples()
        found = [values[:, None], self.drive.curvature()[:, None], legvander(unit, TUNING.drift_degree)]
        return np.column_stack([*found, *(self.of_mode(pole) for pole in poles)])

    def of_mode(self, pole: complex) -> FloatArray:
        """Columns of a mode: parts of the response to the input, and of the free decay; shape (n, PER_MODE)."""
        free = mode_functions(self.time_s - self.time_s[0], np.array([pole]))[:, 0]
        driven = self.drive.response(pole)
        return np.column_stack([driven.real, driven.imag, free.real, free.imag])

    def columns(self, poles: ComplexArray) -> FloatArray:
        """The same as `rows`."""
        return self.rows(self.in_time(poles))

    def slopes(self, poles: ComplexArray) -> FloatArray:
        """Derivatives of the modes' four columns with respect to Re lambda, as `rows`; shape (2 b, PER_MODE m)."""
        functions = mode_functions(self.time_s - self.time_s[0], poles)
        elapsed = self.time_s - self.time_s[0]
        found = [np.empty((elapsed.size, 0))]
        for index, pole in enumerate(poles):
            driven, free = self.drive.slope(pole), elapsed * functions[:, index]
            found.append(np.column_stack([driven.real, driven.imag, free.real, free.imag]))
        return self.rows(np.column_stack(found))


def amplitudes(coefficients: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    """Complex factors, shape (m, k), of the response to the input and of the free decay of each mode.

    From coefficients of shape (FIXED + PER_MODE m, k): output k moves as ``Re(factor function)``.
    """
    own = coefficients[FIXED:].reshape(-1, PER_MODE, coefficients.shape[1])
    return own[:, 0] - 1j * own[:, 1], own[:, 2] - 1j * own[:, 3]


def spline_gain(frequency_hz: FloatArray, step_s: float) -> FloatArray:
    """Share of a sinusoid that a cubic spline through its samples contains: ``1 - (w h)^4 / 720``, to lowest order.

    The cardinal spline of doi:10.1109/79.799930.
    """
    x = frequency_hz * step_s
    return np.asarray(np.sinc(x) ** 4 * 3.0 / (2.0 + np.cos(2.0 * np.pi * x)))


def transfer(
    frequency_hz: FloatArray, poles: ComplexArray, direct: FloatArray, driven: ComplexArray
) -> ComplexArray:
    """Frequency response ``g - w^2 h + sum of (c / (i w - lambda) + c* / (i w - lambda*)) / 2``; shape (b, k).

    `direct`, shape (2, k), is g and h; `driven`, shape (m, k), is c.
    """
    s = 2j * np.pi * frequency_hz[:, None]
    return np.asarray(
        direct[0]
        + s**2 * direct[1]
        + 0.5 * (1.0 / (s - poles)) @ driven
        + 0.5 * (1.0 / (s - np.conj(poles))) @ np.conj(driven)
    )

"""Where one motion ends and the next begins, to the sample: the motions of both sides are extrapolated until they meet.

Between them may lie samples that neither explains: a pluck, a hand that grips.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from modal_id.data import FitData, bandwidth_hz, baseline_splines, detrended
from modal_id.fit import ModalFit, find_modes
from modal_id.solve import Problem, fit_poles, frequency_hz
from tracker import ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Location of a change of motion."""

    #: [cycles] longest stretch of either side from which its motion is extrapolated
    side_cycles: float = 12.0
    #: [cycles] shortest stretch
    least_cycles: float = 1.5
    #: [samples] the same
    least_rows: int = 8
    #: [1] largest number of modes of either side
    modes: int = 4
    #: [cycles] how far beyond the rough limits the change is looked for
    reach_cycles: float = 1.0
    #: [1] largest number of times that the sides are fitted up to the change found
    rounds: int = 4
    #: [1] error of an extrapolated motion over its amplitude
    #: convention: Damping that depends on the amplitude.
    relative_error: float = 0.05
    #: [1] largest exponent of the growth of a wave beyond the samples it is fitted to
    #: physics: Backwards in time a strongly damped motion grows without limit.
    growth: float = 3.0
    #: [variances] least variance, over that of a side, of samples that neither side explains
    unexplained: float = 4.0


TUNING = Tuning()


@dataclass(frozen=True)
class Boundary:
    """The last time of the first motion, the first time of the second, and the posterior sd of the latter.

    The sd is at least that of a time within a step; NaN where the second motion is not known.
    """

    end_s: float
    start_s: float
    sd_s: float


@dataclass(frozen=True)
class Motion:
    """Damped waves about an offset: poles (m,), amplitudes (m, k), offset (k,) and noise variance (k,).

    The amplitudes are those at the first of the two times between which the waves were fitted, with a residual sum of
    squares `rss`, (k,), over `count` samples of each channel; `level` is the noise beside the strongest wave relative
    to white noise, at least 1, and `model` the fit, None of a motion without waves.
    """

    poles: ComplexArray
    amplitudes: ComplexArray
    span_s: tuple[float, float]
    offset: FloatArray
    variance: FloatArray
    rss: FloatArray
    count: FloatArray
    level: float = 1.0
    model: ModalFit | None = None

    @property
    def parameters(self) -> int:
        """Number of real parameters of the waves."""
        return int(2 * self.poles.size * (1 + self.variance.size))

    def at(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Values and root sum of squares of the waves' amplitudes, both of shape (n, k).

        Beyond the fitted span, no wave grows by more than the tuning says.
        """
        begin_s, end_s = self.span_s
        since = np.clip(time_s, begin_s, end_s)[:, None] - begin_s
        beyond = np.minimum((time_s[:, None] - begin_s - since) * self.poles.real, TUNING.growth)
        wave = np.exp(since * self.poles.real + beyond + 1j * (time_s[:, None] - begin_s) * self.poles.imag)
        size = np.sqrt(np.abs(wave) ** 2 @ np.abs(self.amplitudes) ** 2)
        return np.real(wave @ self.amplitudes) + self.offset, size


def locate_boundary(
    data: FitData,
    begin_s: float,
    limits_s: tuple[float, float],
    until_s: float,
    cycle_s: float,
    lowest_hz: float,
    sides: tuple[Motion | None, Motion | None] | None = None,
) -> Boundary | None:
    """Where the motion from `begin_s` on changes to that which lasts until `until_s`, roughly between two limits.

    None where neither side is long enough for a motion to be fitted. `cycle_s` is that of the dominant motion, `sides`
    are the motions beside the limits, where they are known.
    """
    found: Boundary | None = None
    low, high = limits_s
    reach = TUNING.reach_cycles * cycle_s
    zone = data.inside(max(begin_s, low - reach), min(until_s, high + reach))
    zone &= np.any(data.weights > 0.0, axis=1)
    if np.count_nonzero(zone) < 2:
        return None
    before, after = (None, None) if sides is None else sides
    for round_ in range(TUNING.rounds):
        if (round_ == 0 and sides is None) or (found is not None and found.end_s != low):
            low = limits_s[0] if found is None else found.end_s
            start_s = max(begin_s, low - TUNING.side_cycles * cycle_s)
            before = motion_beside(data, start_s, low, cycle_s, lowest_hz, last=True)
        if (round_ == 0 and sides is None) or (found is not None and found.start_s != high):
            high = limits_s[1] if found is None else found.start_s
            end_s = min(until_s, high + TUNING.side_cycles * cycle_s)
            after = motion_beside(data, high, end_s, cycle_s, lowest_hz, last=False)
        if before is None and after is None:
            break
        found = _meeting(data.rows(zone), before, after, limits_s)
        if (found.end_s, found.start_s) == (low, high):
            break
    return found


def motion_beside(
    data: FitData, start_s: float, end_s: float, cycle_s: float, lowest_hz: float, *, last: bool
) -> Motion | None:
    """Motion between two times; its offset is that of the last, or first, two cycles. None where they are too near."""
    rows = data.inside(start_s, end_s) & np.any(data.weights > 0.0, axis=1)
    if np.count_nonzero(rows) < TUNING.least_rows or end_s - start_s < TUNING.least_cycles * cycle_s:
        return None
    return fitted_motion(data.rows(rows), cycle_s, lowest_hz, last=last)


def fitted_motion(
    part: FitData, cycle_s: float, lowest_hz: float, *, last: bool, poles: ComplexArray | None = None
) -> Motion:
    """Motion of all samples, from given poles on or any; its offset is that of the last, or first, two cycles."""
    origin = float(part.time_s[0])
    own = part.from_time(origin)
    model = find_modes(own, TUNING.modes, lowest_hz) if poles is None else _from_poles(own, poles)
    return _motion(part, model, cycle_s, last=last)


def _from_poles(data: FitData, poles: ComplexArray) -> ModalFit:
    bandwidth = bandwidth_hz(float(np.min(frequency_hz(poles))))
    problem = Problem(data, baseline_splines(data.time_s, bandwidth))
    return ModalFit(problem, fit_poles(problem, poles), bandwidth)


def _motion(part: FitData, model: ModalFit | None, cycle_s: float, *, last: bool) -> Motion:
    origin = float(part.time_s[0])
    channels = part.values.shape[1]
    poles, amplitudes = np.zeros(0, dtype=complex), np.zeros((0, channels), dtype=complex)
    weights, own = part.weights, np.zeros(channels)
    rss, level = np.sum(part.weights * detrended(part) ** 2, axis=0), 1.0
    if model is not None:
        poles, weights, own = model.fit.poles, model.data.weights, model.fit.linear.noise_variance
        amplitudes, rss = np.asarray(model.fit.linear.amplitudes), model.fit.linear.rss
        level = max(level, model.spectrum.level_aside(float(frequency_hz(poles[model.strongest]))))
    none = np.zeros(channels)
    waves = Motion(
        poles, amplitudes, (origin, float(part.time_s[-1])), none, none, rss, part.counts, level, model
    )
    left = part.values - waves.at(part.time_s)[0]
    edge = float(part.time_s[-1]) if last else origin
    near = np.where(np.abs(part.time_s - edge)[:, None] < 2.0 * cycle_s, weights, 0.0)
    offset = np.sum(near * left, axis=0) / np.maximum(np.sum(near, axis=0), 1e-300)
    square = np.sum(near * (left - offset) ** 2, axis=0)
    freedom = np.maximum(np.count_nonzero(near, axis=0) - 1.0, 1.0)
    variance = np.maximum(np.maximum(square / freedom, own), 1e-300)
    return replace(waves, offset=offset, variance=variance)


def _meeting(
    zone: FitData, before: Motion | None, after: Motion | None, limits_s: tuple[float, float]
) -> Boundary:
    """The times of least cost: the first motion up to one, the second from the other on, anything between.

    The limit of a side without a motion stays.
    """
    sides = [side for side in (before, after) if side is not None]
    variance = np.max([side.variance for side in sides], axis=0)
    count = np.count_nonzero(zone.weights, axis=1)

    def cost(values: FloatArray, size: FloatArray | float = 0.0) -> FloatArray:
        # with weights that are at most 1, the error of the motion counts fully
        ratio = 1.0 + zone.weights * (TUNING.relative_error * size) ** 2 / variance
        square = zone.weights * (zone.values - values) ** 2 / variance
        return np.asarray(np.sum(square / ratio + np.where(zone.weights > 0.0, np.log(ratio), 0.0), axis=1))

    n = zone.time_s.size
    whole = np.sum(zone.weights * zone.values, axis=0) / np.maximum(np.sum(zone.weights, axis=0), 1e-300)
    free = cost(whole)
    ratio = max(float(np.sum(free)) / max(float(np.sum(count)), 1.0), TUNING.unexplained)
    unexplained = free / ratio + count * np.log(ratio)
    # cumulative costs of the rows before each of n + 1 edges
    left, right, between = (
        np.concatenate([[0.0], np.cumsum(c)])
        for c in (
            np.full(n, np.inf) if before is None else cost(*before.at(zone.time_s)),
            np.full(n, np.inf) if after is None else cost(*after.at(zone.time_s)),
            unexplained,
        )
    )
    first = left - between
    last = between + (
        right[-1] - right if after is not None else np.where(np.arange(n + 1) == n, 0.0, np.inf)
    )
    # least cost of each start of the second motion, with unexplained samples before it or without
    profile = np.minimum.accumulate(first) + last + 2.0 * np.log(n)
    start = int(np.argmin(profile))
    end = int(np.argmin(first[: start + 1]))
    if before is not None and after is not None:
        direct = left + right[-1] - right
        if np.min(direct) <= profile[start]:
            end = start = int(np.argmin(direct))
        profile = np.minimum(profile, direct)
    odds = np.exp(-0.5 * (profile - np.min(profile)))
    odds /= np.sum(odds)
    edges = np.concatenate([[zone.time_s[0]], 0.5 * (zone.time_s[1:] + zone.time_s[:-1]), [zone.time_s[-1]]])
    sd_s = (
        float(np.sqrt(odds @ (edges - odds @ edges) ** 2 + zone.step_s**2 / 12.0))
        if after is not None
        else np.nan
    )
    end_s = limits_s[0] if before is None else float(zone.time_s[max(end - 1, 0)])
    start_s = limits_s[1] if after is None else float(zone.time_s[min(start, n - 1)])
    return Boundary(end_s, max(start_s, end_s), sd_s)

"""Checks of a result: its residual against replicates, the effect of a vibration left in it, a delay of rows.

Posterior predictive checks (Gelman, Meng & Stern 1996): white noise at the used samples, passed through the same
projection as the data, gives the distribution of each statistic. The fitted parameters are projected out together with
their first derivatives, so that the draws of the posterior need no separate replicates. The phases of mode shapes along
the rows of an image show a rolling shutter that was not stated.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from modal_id.data import FitData, bandwidth_hz, baseline_splines, row_blocks
from modal_id.fit import LEAST_WINDOW
from modal_id.modes.shapes import in_phase
from modal_id.results import Check, Identification, IdentifiedMode
from modal_id.sentences import CHECKS, Note
from modal_id.solve import Beside, ModeColumns, Problem, TimesTime, motion, pole, solve_linear, without_fit
from tracker import BoolArray, ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Tests of the residual, the delay of rows."""

    #: [1] number of replicates
    #: statistics: p-values in steps of 1 / 400.
    replicates: int = 399
    #: [1] fewest replicates, for long records
    #: statistics: p-values in steps of 1 / 100.
    min_replicates: int = 99
    #: [1] largest number of values in all replicates together
    #: convention: Limits the memory.
    max_values: int = 6_000_000
    #: [1] upper end of the band in which drift is looked for, over that of the baseline
    #: convention: Drift is visible just above.
    low_band: float = 3.0
    #: [1] least signal over noise of the modes and channels used
    least_snr: float = 20.0
    #: [1] fewest such channels
    least_channels: int = 5
    #: [sd] least delay that is reported, and least difference between modes that disagree
    #: statistics: Noise exceeds it once in 5e8; eight groups know an sd to a quarter.
    clear_sd: float = 6.0
    #: [rad] least change of phase from the first to the last channel
    least_phase: float = 0.01
    #: [1] the same, over the damping ratio
    #: physics: Shapes with unevenly distributed damping are complex by about the damping ratio.
    least_ratios: float = 5.0
    #: [1] number of groups of neighbouring channels, each left out once
    #: convention: Their errors may be correlated.
    groups: int = 8
    #: [1] number of passes
    passes: int = 4


TUNING = Tuning()


# Values in each array at a time: a long record fills memory otherwise.
_BLOCK_VALUES = 1_000_000


def residual_checks(found: Identification) -> tuple[Check, ...]:
    """Checks of the channel that moves most; none where there is no mode or fewer than 64 samples.

    Random numbers are derived from the seed of the mode: the same identification gives the same values.
    """
    modes = found.fitted_modes
    if not modes:
        return ()
    strongest = max(modes, key=lambda m: (m.target, m.amplitude))
    size = np.where(found.channels_used, np.nan_to_num(np.abs(strongest.shape)), -1.0)
    channel = int(np.argmax(size))
    known = np.isfinite(found.series.values[:, channel] - found.fitted[:, channel])
    rows = np.flatnonzero(found.used[:, channel] & known)
    if rows.size < LEAST_WINDOW:
        return ()
    time_s = found.series.time_s[rows] - found.onset.fit_from_s
    residual = (found.series.values - found.fitted)[rows, channel]
    if not np.any(residual):
        return ()
    count = int(np.clip(TUNING.max_values // rows.size, TUNING.min_replicates, TUNING.replicates))
    poles = np.array([complex(pole(m.omega_n_rad_s, m.damping_ratio)) for m in modes])
    index = modes.index(strongest)
    lowest = bandwidth_hz(min(m.frequency_hz for m in modes))
    statistics = _Statistics(time_s, poles, index, strongest.shape[channel], lowest)
    seed = np.random.SeedSequence(strongest.posterior.seed, spawn_key=(7,))
    own = (residual / np.std(residual))[:, None]
    blocks = [statistics(own)]
    blocks += [statistics(block) for block in _replicates(np.random.default_rng(seed), rows.size, count)]
    checks = []
    for (name, cause, remedy), values in zip(CHECKS, np.concatenate(blocks, axis=1), strict=True):
        p_value = float(np.count_nonzero(values >= values[0]) / values.size)
        checks.append(Check(name, float(values[0]), float(np.median(values[1:])), p_value, cause, remedy))
    checks[0] = replace(checks[0], frequency_hz=statistics.line_hz(own))
    return tuple(checks)


def _replicates(rng: np.random.Generator, samples: int, count: int) -> Iterator[FloatArray]:
    """White noise, shape (samples, columns), in blocks of `count` columns altogether."""
    drawn = max(1, _BLOCK_VALUES // samples)
    for first in range(0, count, drawn):
        yield rng.standard_normal((samples, min(drawn, count - first)))


class _Statistics:
    """Statistics of residuals as columns, large for a wrong model; shape (5, columns)."""

    def __init__(
        self, time_s: FloatArray, poles: ComplexArray, index: int, amplitude: complex, bandwidth: float
    ) -> None:
        self._time_s, self._span = time_s, float(time_s[-1])
        self._low_hz = max(TUNING.low_band * bandwidth, 4.0 / self._span)
        steps = np.diff(time_s)
        self._neighbours = steps < 1.5 * float(np.median(steps))
        # Derivative of the decay by zeta1 in zeta(a) = zeta0 + zeta1 a, with all other parameters projected out.
        derivative = motion(time_s, poles[[index]], np.array([[amplitude]]))[:, 0]
        derivative *= -np.expm1(poles[index].real * time_s)
        waves = ModeColumns(time_s, poles)
        columns = Beside((waves, TimesTime(time_s / max(self._span, 1e-300), waves)))
        data = FitData(time_s, derivative[:, None], np.ones((time_s.size, 1)))
        self._problem = Problem(data, baseline_splines(time_s, bandwidth))
        self._linear = solve_linear(self._problem, columns)
        self._direction = self._linear.residual[:, 0]

    def __call__(self, columns: FloatArray) -> FloatArray:
        # The baseline, the modes and their first derivatives are projected out.
        left = without_fit(self._problem, self._linear, columns)
        left /= np.std(left, axis=0)
        power, frequency = _periodogram(self._time_s, left)
        mean = np.mean(power, axis=0)
        line = np.max(power, axis=0) / mean
        low = (frequency > 0.0) & (frequency < self._low_hz)
        drift = np.mean(power[low], axis=0) / mean
        lag = np.abs(np.mean((left[1:] * left[:-1])[self._neighbours], axis=0))
        score = np.abs(self._direction @ left) / max(float(np.linalg.norm(self._direction)), 1e-300)
        return np.stack([line, lag, drift, score, np.mean(left**4, axis=0)])

    def line_hz(self, column: FloatArray) -> float:
        """Frequency of the largest line of one residual, shape (n, 1)."""
        power, frequency = _periodogram(self._time_s, without_fit(self._problem, self._linear, column))
        return float(frequency[np.argmax(power[:, 0])])


def _periodogram(time_s: FloatArray, columns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Power and frequency of each column on a grid of the median step, with missing samples as zero."""
    step = float(np.median(np.diff(time_s)))
    place = np.rint((time_s - time_s[0]) / step).astype(np.intp)
    grid = np.zeros((int(place[-1]) + 1, columns.shape[1]))
    grid[place] = columns
    power = np.abs(np.fft.rfft(grid, axis=0)[1:]) ** 2
    return np.asarray(power), np.asarray(np.fft.rfftfreq(grid.shape[0], step)[1:])


# Columns of `_products`.
_WAVES, _SLOPES, _LINE, _OWN = slice(0, 2), slice(2, 4), slice(4, 6), 6


class LineEffect(NamedTuple):
    """Change of the frequency in Hz and of the damping ratio, each without a sign."""

    frequency_hz: float
    damping_ratio: float


def line_effect(found: Identification, mode: IdentifiedMode, line_hz: float) -> LineEffect:
    """Largest first-order change of a mode's values by a steady vibration at `line_hz` that its residual contains.

    Parameters
    ----------
    found : Identification
    mode : IdentifiedMode
        One of its modes.
    line_hz : float
        Frequency of the vibration. Its amplitude and phase in each channel are those that fit the residual best.

    Notes
    -----
    The linearised fit of Eq. 1, amplitudes free in each channel, applied to the vibration instead of the record. The
    residual holds what the fit left of the vibration: below a distance of about one bin, ``1 / span``, from the mode
    the change is underestimated. A vibration that decays changes the values less than a steady one.
    """
    normal, right = np.zeros((2, 2)), np.zeros((2, 2))
    residual = found.series.values - found.fitted
    for channel in np.flatnonzero(found.channels_used & np.isfinite(mode.shape)):
        rows = found.used[:, channel] & np.isfinite(residual[:, channel])
        if np.count_nonzero(rows) < 8:
            continue
        time_s = found.series.time_s[rows] - found.onset.fit_from_s
        own = residual[rows, channel]
        products = _products(mode, int(channel), line_hz, time_s, own)
        size = np.linalg.lstsq(products[_LINE, _LINE], products[_LINE, _OWN], rcond=None)[0]
        # In phase with the fitted vibration, and a quarter of a cycle later: all channels may move with either.
        line = np.array([[size[0], size[1]], [size[1], -size[0]]]).T
        absorbed = np.linalg.solve(products[_WAVES, _WAVES], products[_WAVES, :])
        left = products[_SLOPES, :] - products[_SLOPES, _WAVES] @ absorbed
        variance = max(float(np.var(own)), np.finfo(float).tiny)
        normal += left[:, _SLOPES] / variance
        right += left[:, _LINE] @ line / variance
    if np.linalg.matrix_rank(normal) < 2:
        return LineEffect(np.nan, np.nan)
    relative, damping = np.linalg.norm(np.linalg.solve(normal, right), axis=1)
    return LineEffect(float(relative) * mode.frequency_hz, float(damping))


def _products(
    mode: IdentifiedMode, channel: int, line_hz: float, time_s: FloatArray, own: FloatArray
) -> FloatArray:
    """Inner products of the columns of one channel: its waves, slopes and vibration, then `own`; shape (7, 7)."""
    total = np.zeros((_OWN + 1, _OWN + 1))
    for rows in row_blocks(time_s.size):
        t = time_s[rows]
        phase = 2.0 * np.pi * line_hz * t
        waves, slopes = _waves(mode, t), _slopes(mode, t, channel)
        columns = np.column_stack([waves, slopes, np.cos(phase), np.sin(phase), own[rows]])
        total += columns.T @ columns
    return total


def _waves(mode: IdentifiedMode, time_s: FloatArray) -> FloatArray:
    wave = np.exp(pole(mode.omega_n_rad_s, mode.damping_ratio) * time_s)
    return np.stack([wave.real, wave.imag], axis=1)


def _slopes(mode: IdentifiedMode, time_s: FloatArray, channel: int) -> FloatArray:
    """Derivatives of the channel's motion by log frequency and by the damping ratio; shape (n, 2)."""
    omega, zeta = mode.omega_n_rad_s, mode.damping_ratio
    own = complex(pole(omega, zeta))
    of_damping = -omega * complex(1.0, zeta / np.sqrt(1.0 - zeta**2))
    wave = mode.shape[channel] * time_s * np.exp(own * time_s)
    return np.stack([np.real(own * wave), np.real(of_damping * wave)], axis=1)


class RowDelay(NamedTuple):
    """Time from one row of the image to the next and its standard deviation, in s; negative from the bottom up."""

    per_row_s: float
    sd_s: float


def row_delay(found: Identification, rows_px: FloatArray) -> RowDelay | None:
    """Delay of the rows that explains the phases of the shapes; None where there is none to be seen.

    Parameters
    ----------
    found : Identification
    rows_px : array, shape (k,)
        Row of each channel at rest, y down; NaN where unknown.

    Notes
    -----
    A channel that is exposed later by the time t has a phase larger by omega t. The out-of-phase part of each shape is
    regressed on the in-phase part and on that times the row, weighted by their sd; the sd of the slope is that of the
    jackknife over groups of neighbouring channels. All modes must agree.
    """
    each = [(mode, _slope(mode, rows_px)) for mode in found.modes]
    known = [(mode, delay) for mode, delay in each if delay is not None]
    if not known:
        return None
    values, sd = np.array([delay for _, delay in known]).T
    weights = sd**-2 / np.sum(sd**-2)
    per_row, total_sd = float(weights @ values), float(np.sum(sd**-2) ** -0.5)
    clearest = known[int(np.argmin(sd))][0]
    span = float(np.ptp(rows_px[np.isfinite(rows_px) & np.isfinite(clearest.shape)]))
    phase = abs(per_row) * span * clearest.omega_n_rad_s
    if (
        abs(per_row) < TUNING.clear_sd * total_sd
        or phase < max(TUNING.least_phase, TUNING.least_ratios * clearest.damping_ratio)
        or np.any(np.abs(values - per_row) > TUNING.clear_sd * np.hypot(sd, total_sd))
    ):
        return None
    return RowDelay(per_row, total_sd)


def readout_note(found: Identification, rows_px: FloatArray, height_px: int) -> str:
    """Sentence on a rolling shutter that the shapes show, in an image of `height_px` rows; empty without one."""
    delay = row_delay(found, rows_px)
    if delay is None:
        return ""
    readout_s, sd_s = (height_px - 1) * np.array(delay)
    # No readout takes longer than a frame.
    if abs(readout_s) - TUNING.clear_sd * sd_s > float(np.median(np.diff(found.series.time_s))):
        return ""
    row_us, sd_us, grow = 1e6 * abs(delay.per_row_s), 1e6 * delay.sd_s, "grow" if readout_s > 0.0 else "fall"
    return Note.ROLLING_SHUTTER(grow=grow, row_us=row_us, sd_us=sd_us, readout_s=readout_s, sd_s=sd_s)


def _slope(mode: IdentifiedMode, rows_px: FloatArray) -> RowDelay | None:
    """Delay per row of one mode; None where too few channels tell."""
    good = np.isfinite(rows_px) & np.isfinite(mode.shape) & np.isfinite(mode.shape_sd) & (mode.shape_sd > 0.0)
    if np.count_nonzero(good) < TUNING.least_channels or not np.ptp(rows_px[good]) > 1.0:
        return None
    order = np.flatnonzero(good)[np.argsort(rows_px[good], kind="stable")]
    shape, sd, rows = mode.shape[order], mode.shape_sd[order], rows_px[order]
    if np.max(np.abs(shape) / sd) < TUNING.least_snr:
        return None
    everything = np.ones(order.size, dtype=bool)
    whole = _phase_slope(shape, sd, rows, everything)
    groups = np.array_split(np.arange(order.size), min(TUNING.groups, order.size))
    without = []
    for group in groups:
        kept = everything.copy()
        kept[group] = False
        without.append(_phase_slope(shape, sd, rows, kept)[0])
    jackknife = (len(groups) - 1.0) / len(groups) * np.sum((np.array(without) - whole[0]) ** 2)
    slope_sd = max(float(np.sqrt(jackknife)), whole[1])
    return RowDelay(whole[0] / mode.omega_n_rad_s, slope_sd / mode.omega_n_rad_s)


def _phase_slope(
    shape: ComplexArray, sd: FloatArray, rows: FloatArray, kept: BoolArray
) -> tuple[float, float]:
    """Change of the phase per row and its sd for white noise."""
    shape, weight, along = shape[kept], 1.0 / sd[kept], rows[kept] - np.mean(rows)
    shape = in_phase(shape)
    phase = np.zeros(2)
    for _ in range(TUNING.passes):
        turned = shape * np.exp(-1j * (phase[0] + phase[1] * along))
        design = (turned.real * weight)[:, None] * np.stack([np.ones_like(along), along], axis=1)
        covariance = np.linalg.pinv(design.T @ design, hermitian=True)
        phase = phase + covariance @ (design.T @ (turned.imag * weight))
    return float(phase[1]), float(np.sqrt(covariance[1, 1]))

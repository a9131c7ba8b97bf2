"""Checks of the residual: statistics of the residual against replicates under the fitted model.

Posterior predictive checks (Gelman, Meng & Stern 1996): white noise at the used samples, passed through the same
projection as the data, gives the distribution of each statistic. The fitted parameters are projected out together with
their first derivatives, so that the draws of the posterior need no separate replicates.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from modal_id.check import Check
from modal_id.data import FitData, bandwidth_hz, baseline_splines
from modal_id.results import Identification
from modal_id.solve import Beside, ModeColumns, Problem, TimesTime, motion, pole, solve_linear, without_fit
from tracker import ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Tests of the residual."""

    #: [1] number of replicates
    #: statistics: p-values in steps of 1 / 400.
    replicates: int = 399
    #: [1] fewest replicates, for long records
    #: statistics: p-values in steps of 1 / 100.
    min_replicates: int = 99
    #: [1] largest number of values in all replicates together
    #: convention: Limits the memory.
    max_values: int = 6_000_000
    #: [samples] fewest samples
    min_samples: int = 64
    #: [1] upper end of the band in which drift is looked for, over that of the baseline
    #: convention: Drift is visible just above.
    low_band: float = 3.0


TUNING = Tuning()

# Values in each array at a time: a long record fills memory otherwise.
_BLOCK_VALUES = 1_000_000


_TEXTS = (
    (
        "unmodelled vibration",
        "A vibration was not modelled: a weak mode, mains hum, or a harmonic of a strong mode.",
        "Where it changes the values by more than a standard deviation, remove its source and record again.",
    ),
    (
        "correlation of neighbouring residuals",
        "The noise is correlated in time, or contains fast motion.",
        "The intervals already include the noise level at the mode (noise factor); stabilise camera and lighting.",
    ),
    (
        "power just above the baseline's band",
        "A drift is faster than the baseline: camera motion, changing light, or a slow swing.",
        "Add a reference marker on a fixed point; keep camera and lighting steady.",
    ),
    (
        "score for damping that depends on amplitude",
        "The decay may not be exponential: damping that depends on the amplitude, or noise that is not white.",
        "The recording states whether a dependence is established; record smaller amplitudes, or longer.",
    ),
    (
        "kurtosis of the residual",
        "Single samples deviate strongly: lost or wrongly located markers, or shocks.",
        "Inspect the frames with the largest residuals; improve lighting and markers.",
    ),
)


def residual_checks(found: Identification) -> tuple[Check, ...]:
    """Checks of the channel that moves most; none where there is no mode or fewer than 64 samples.

    Random numbers are derived from the seed of the mode: the same identification gives the same values.
    """
    if not found.modes:
        return ()
    strongest = max(found.modes, key=lambda m: (m.target, m.amplitude))
    size = np.where(found.channels_used, np.nan_to_num(np.abs(strongest.shape)), -1.0)
    channel = int(np.argmax(size))
    known = np.isfinite(found.series.values[:, channel] - found.fitted[:, channel])
    rows = np.flatnonzero(found.used[:, channel] & known)
    if rows.size < TUNING.min_samples:
        return ()
    time_s = found.series.time_s[rows] - found.onset.fit_from_s
    residual = (found.series.values - found.fitted)[rows, channel]
    if not np.any(residual):
        return ()
    count = int(np.clip(TUNING.max_values // rows.size, TUNING.min_replicates, TUNING.replicates))
    poles = np.array([complex(pole(m.omega_n_rad_s, m.damping_ratio)) for m in found.modes])
    index = found.modes.index(strongest)
    lowest = bandwidth_hz(min(m.frequency_hz for m in found.modes))
    statistics = _Statistics(time_s, poles, index, strongest.shape[channel], lowest)
    seed = np.random.SeedSequence(strongest.posterior.seed, spawn_key=(7,))
    own = (residual / np.std(residual))[:, None]
    blocks = [statistics(own)]
    blocks += [statistics(block) for block in _replicates(np.random.default_rng(seed), rows.size, count)]
    checks = []
    for (name, cause, remedy), values in zip(_TEXTS, np.concatenate(blocks, axis=1), strict=True):
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

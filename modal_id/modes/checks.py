"""Does the fit hold? Statistics of the residual against replicates of what it would be if the model were true.

Posterior predictive checks (Gelman, Meng & Stern 1996): white noise at the samples used, passed through the same
projection as the data, gives the distribution of each statistic; parameters that the fit has determined are projected
out together with their first derivatives, so that the draws of the posterior need no separate replicates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modal_id.data.baseline import bandwidth_hz, baseline_matrix
from modal_id.fit.decay import pole
from modal_id.fit.linear import FitData, Problem, solve_linear
from modal_id.results import Identification
from tracker.arrays import ComplexArray, FloatArray

ALARM = 0.01
_REPLICATES = 399
_MIN_REPLICATES = 99
_MAX_VALUES = 6_000_000
_MIN_SAMPLES = 64
# Drift shows just above what the baseline follows.
_LOW_BAND = 3.0


@dataclass(frozen=True)
class Check:
    """One statistic of the residual.

    Attributes
    ----------
    name : str
    value : float
        Of the statistic.
    typical : float
        Median of the replicates.
    p_value : float
        Share of replicates that are at least as large, the record itself counted in.
    wrong, remedy : str
        What a small p-value means and what to try, each a sentence.
    """

    name: str
    value: float
    typical: float
    p_value: float
    wrong: str
    remedy: str

    @property
    def holds(self) -> bool:
        """Whether the record is not among the most extreme 1 %."""
        return self.p_value > ALARM


_TEXTS = (
    (
        "largest line of the residual spectrum",
        "A vibration is left that was not fitted: a neighbouring mode, a hum, or a multiple of a strong mode.",
        "Look for the line in the residual spectrum; raise max_modes, or record without what hums.",
    ),
    (
        "correlation of neighbouring residuals",
        "The noise has a memory, or a fast motion is left in it.",
        "The intervals are scaled by the noise at the mode (noise factor); steady the camera and the light.",
    ),
    (
        "power just above the baseline's band",
        "A drift is left that the baseline does not follow: a swaying camera, light that changes, a slow swing.",
        "Mark a point that does not move as reference; keep the camera and the light still.",
    ),
    (
        "score for damping that depends on amplitude",
        "The decay is not one exponential: damping changes with the amplitude.",
        "Read the values at small amplitude; record smaller swings, or longer.",
    ),
    (
        "kurtosis of the residual",
        "Single samples are far off: lost or mistaken markers, shocks.",
        "Look at the frames with the largest residuals; improve light and markers.",
    ),
)


def residual_checks(found: Identification) -> tuple[Check, ...]:
    """Checks of the channel that moves most.

    Parameters
    ----------
    found : Identification

    Returns
    -------
    tuple of Check
        Empty where there is no mode or fewer than 64 samples. Random numbers are spawned from the mode's own seed:
        the same result gives the same values.
    """
    if not found.modes:
        return ()
    strongest = max(found.modes, key=lambda m: (m.target, m.amplitude))
    size = np.where(found.channels_used, np.nan_to_num(np.abs(strongest.shape)), -1.0)
    channel = int(np.argmax(size))
    known = np.isfinite(found.series.values[:, channel] - found.fitted[:, channel])
    rows = np.flatnonzero(found.used[:, channel] & known)
    if rows.size < _MIN_SAMPLES:
        return ()
    time_s = found.series.time_s[rows] - found.onset.fit_from_s
    residual = (found.series.values - found.fitted)[rows, channel]
    if not np.any(residual):
        return ()
    count = int(np.clip(_MAX_VALUES // rows.size, _MIN_REPLICATES, _REPLICATES))
    rng = np.random.default_rng(np.random.SeedSequence(strongest.posterior.seed, spawn_key=(7,)))
    columns = np.column_stack([residual / np.std(residual), rng.standard_normal((rows.size, count))])
    poles = np.array([complex(pole(m.omega_n_rad_s, m.damping_ratio)) for m in found.modes])
    index = found.modes.index(strongest)
    lowest = bandwidth_hz(min(m.frequency_hz for m in found.modes))
    statistics = _statistics(time_s, columns, poles, index, strongest.shape[channel], lowest)
    checks = []
    for (name, wrong, remedy), values in zip(_TEXTS, statistics, strict=True):
        p_value = float(np.count_nonzero(values >= values[0]) / values.size)
        checks.append(Check(name, float(values[0]), float(np.median(values[1:])), p_value, wrong, remedy))
    return tuple(checks)


def _statistics(
    time_s: FloatArray,
    columns: FloatArray,
    poles: ComplexArray,
    index: int,
    amplitude: complex,
    bandwidth: float,
) -> tuple[FloatArray, ...]:
    """Statistics of every column, large when something is wrong; shape (columns,) each."""
    span = float(time_s[-1])
    wave = np.exp(time_s[:, None] * poles)
    functions = np.concatenate([wave, wave * (time_s / max(span, 1e-300))[:, None]], axis=1)
    problem = Problem(FitData(time_s, columns, np.ones(columns.shape)), baseline_matrix(time_s, bandwidth))
    left = solve_linear(problem, functions).residual
    left = left / np.std(left, axis=0)
    power, frequency = _periodogram(time_s, left)
    line = np.max(power, axis=0) / np.mean(power, axis=0)
    neighbours = np.diff(time_s) < 1.5 * float(np.median(np.diff(time_s)))
    lag = np.abs(np.mean((left[1:] * left[:-1])[neighbours], axis=0))
    low = (frequency > 0.0) & (frequency < max(_LOW_BAND * bandwidth, 4.0 / span))
    drift = np.mean(power[low], axis=0) / np.mean(power, axis=0)
    # The derivative of the decay by zeta1 in zeta(a) = zeta0 + zeta1 a, less what other parameters explain of it.
    bent = np.real(amplitude * wave[:, index] * (1.0 - np.exp(poles[index].real * time_s)))
    own = Problem(FitData(time_s, bent[:, None], np.ones((time_s.size, 1))), problem.baseline)
    direction = solve_linear(own, functions).residual[:, 0]
    norm = float(np.linalg.norm(direction))
    score = np.abs(direction @ left) / max(norm, 1e-300)
    return line, lag, drift, score, np.mean(left**4, axis=0)


def _periodogram(time_s: FloatArray, columns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Power of each column on a grid of the median step, samples that are missing as zero."""
    step = float(np.median(np.diff(time_s)))
    place = np.rint((time_s - time_s[0]) / step).astype(np.intp)
    grid = np.zeros((int(place[-1]) + 1, columns.shape[1]))
    grid[place] = columns
    power = np.abs(np.fft.rfft(grid, axis=0)[1:]) ** 2
    return np.asarray(power), np.asarray(np.fft.rfftfreq(grid.shape[0], step)[1:])

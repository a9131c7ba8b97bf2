"""All modes of a record, fitted together, with what the search for them knows; one of them by itself."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from modal_id.data import FitData
from modal_id.fit.spectrum import ResidualSpectrum, residual_spectrum
from modal_id.sentences import Refusal
from modal_id.solve import ModeColumns, PoleFit, Problem, frequency_hz, motion, solve_linear, thinning
from tracker import ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """The fit of one mode's own decay."""

    #: [1] factor on the averages per cycle that `thinning` chooses
    finer: float = 4.0 / 3.0
    #: [1] logarithm of the ratio of frequencies within which another mode is fitted beside it
    #: convention: The motion of the others is subtracted.
    close: float = 0.7


TUNING = Tuning()


# A line closer than this to a fitted mode is misfit of that mode (amplitude-dependent damping).
OWN_BAND = 0.03
# Lines are modes from this factor above the bandwidth of the baseline.
_BASELINE_GUARD = 1.3


@dataclass(frozen=True)
class ModalFit:
    """All modes that exceed the noise, fitted together.

    Attributes
    ----------
    problem : Problem
        Data with outliers at weight 0, and baseline.
    fit : PoleFit
        Poles in order of frequency.
    bandwidth_hz, least_bandwidth_hz : float
        Of the baseline, and what slow motion requires of it, as far as the lowest mode allows.
    unresolved : tuple of complex array, shape (1,) or (2,)
        Poles of pairs that explain the data better than one mode, too close to be resolved; of one of them where the
        other has less than a quarter of its amplitude.
    repeating : array, shape (2 m, 2 m), or None
        Covariance of (Re, Im) of each pole in turn due to errors of positions that return with the motion.
    added_hz : tuple of float
        Frequencies named by the user at which a mode was fitted that the search had not found.
    refused : tuple of (float, Refusal)
        Frequencies named by the user at which none was fitted, with the reason.
    """

    problem: Problem
    fit: PoleFit
    bandwidth_hz: float
    unresolved: tuple[ComplexArray, ...] = ()
    least_bandwidth_hz: float = 0.0
    repeating: FloatArray | None = None
    added_hz: tuple[float, ...] = ()
    refused: tuple[tuple[float, Refusal], ...] = ()

    @property
    def data(self) -> FitData:
        """Samples, with outliers at weight 0."""
        return self.problem.data

    @property
    def lowest_line_hz(self) -> float:
        """Frequency below which a line is taken for slow motion."""
        return _BASELINE_GUARD * self.bandwidth_hz

    @property
    def spare(self) -> float:
        """Number of values that were used less that of parameters."""
        columns, channels = self.fit.linear.slow.shape
        poles = self.fit.poles.size
        return float(np.sum(self.data.counts) - channels * (2 * poles + columns) - 2 * poles)

    def spare_energy(self, index: int) -> float:
        """Share of the energy of the mode with this index outside as many values, the largest, as it has parameters."""
        linear, pole = self.fit.linear, self.fit.poles[index]
        power = np.abs(linear.amplitudes[index]) ** 2 / linear.noise_variance * self.data.weights
        power = (np.exp(2.0 * pole.real * self.data.time_s)[:, None] * power).ravel()
        others = max(power.size - 2 - 2 * linear.noise_variance.size, 0)
        left = np.sum(np.partition(power, others)[:others]) if others else 0.0
        return float(left / max(float(np.sum(power)), 1e-300))

    @property
    def energy(self) -> FloatArray:
        """Energy of each mode in the record, channels weighted by their noise."""
        linear, poles = self.fit.linear, self.fit.poles
        power = np.sum(np.abs(linear.amplitudes) ** 2 / linear.noise_variance, axis=1)
        return np.asarray(power / np.maximum(np.abs(poles.real), 1.0 / max(self.data.span_s, 1e-300)))

    def amplitude_left(self, index: int) -> float:
        """Amplitude of the mode with this index at the end over that at the start, at most 1."""
        return min(float(np.exp(self.fit.poles[index].real * self.data.span_s)), 1.0)

    @property
    def strongest(self) -> int:
        """Index of the mode with most energy in the record."""
        return int(np.argmax(self.energy))

    def unresolved_near(self, index: int) -> ComplexArray | None:
        """Poles of the unresolved pair that the mode with this index represents; None where it is one mode."""
        own = float(frequency_hz(self.fit.poles)[index])
        near = [pair for pair in self.unresolved if np.min(np.abs(frequency_hz(pair) / own - 1.0)) < OWN_BAND]
        return near[-1] if near else None

    def with_repeating(self, more: FloatArray) -> ModalFit:
        """The fit with this covariance, shape (2 m, 2 m), added to ``repeating``."""
        return replace(self, repeating=more if self.repeating is None else self.repeating + more)

    @cached_property
    def spectrum(self) -> ResidualSpectrum:
        """Spectrum of the residual."""
        linear = self.fit.linear
        return residual_spectrum(self.data, linear.residual, linear.noise_variance)


def own_decay(model: ModalFit, mode: int) -> ModalFit:
    """The fit of the mode with this index, which comes first, and of those close to it, on fewer samples.

    At least sixteen averages a cycle of the mode lose 1.3 % of the information about it. The noise of a sample of
    weight 1 is that of these averages.
    """
    fit, data = model.fit, model.data
    hz = frequency_hz(fit.poles)
    close = np.abs(np.log(hz / hz[mode])) < TUNING.close
    close[mode] = False
    order = np.append(mode, np.flatnonzero(close))
    factor = max(thinning(data.time_s, fit.poles[[mode]] * TUNING.finer), 1)
    problem = Problem(replace(data, values=fit.linear.residual), model.problem.sparse)
    problem = problem.thinned(factor) if factor > 1 else problem
    # Each average of the motion is that of a whole block of even samples with equal weights, a constant factor on the
    # motion at its mean time: uneven ones would move it. The averages of what the fit leaves have the same factor.
    seen, poles = problem.data, fit.poles[order]
    offsets_s = data.step_s * (np.arange(factor) - 0.5 * (factor - 1))
    factors = np.mean(np.exp(np.outer(offsets_s, poles)), axis=0)
    moved = motion(seen.time_s, poles, factors[:, None] * fit.linear.amplitudes[order])
    problem = Problem(replace(seen, values=seen.values + moved), problem.sparse)
    linear = solve_linear(problem, ModeColumns(seen.time_s, poles))
    both = np.stack([2 * order, 2 * order + 1], axis=1).ravel()
    own = replace(fit, poles=poles, linear=linear, covariance=fit.covariance[np.ix_(both, both)])
    return replace(model, problem=problem, fit=own, repeating=None)

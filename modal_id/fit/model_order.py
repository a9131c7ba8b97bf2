"""Number of modes: the strongest line is fitted, all modes are refitted, until no line exceeds the noise (RELAX)."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from modal_id.data import (
    RELATIVE_BANDWIDTH,
    FitData,
    bandwidth_hz,
    baseline_splines,
    limited,
    reject_outliers,
    rough_variance,
    without_spikes,
)
from modal_id.fit.amplitude_dependence import split_mode
from modal_id.fit.damped import MAX_DAMPING, damped_starts, fit_damped, is_above_noise
from modal_id.fit.modal_fit import OWN_BAND, ModalFit
from modal_id.fit.spectrum import Band, Candidate, ResidualSpectrum, candidates, nyquist_hz
from modal_id.solve import (
    LinearSolution,
    ModeColumns,
    PoleFit,
    Problem,
    damping_ratio,
    fit_poles,
    frequency_hz,
    motion,
    no_columns,
    rough_poles,
    solve_linear,
)
from tracker import BoolArray, ComplexArray, FloatArray


@dataclass(frozen=True)
class Tuning:
    """Which lines become modes, what is slow motion, and lines removed before outliers are looked for."""

    #: [1] largest number of lines removed
    most_lines: int = 4
    #: [1] share of the noise level at a mode that slow motion may contribute
    leak: float = 0.02
    #: [cycles] number of cycles below which a motion may be a swing on soft supports or by hand
    few_cycles: float = 15.0
    #: [1] largest frequency of a swing over that of the lowest mode
    #: physics: A beam's first mode lies at a sixth of the second.
    far_below: float = 0.1
    #: [1] damping ratio from which a mode is strongly damped
    #: convention: That of a beam is weakly damped.
    strongly_damped: float = 0.02
    #: [bins] change of a frequency beside a further mode up to which it is the same mode, where a bin is 1 / span
    #: measurement: The fit of a drift of 2.6 cycles alone is off by 0.2 to 0.3 (seed 14535 of `benchmarks.records`).
    moved_bins: float = 0.5
    #: [1] largest number of splines of the slow motion
    max_splines: int = 300
    #: [1] amplitude over the strongest mode's below which a line is no mode
    #: convention: Such lines are rounding errors or artefacts of an integrator.
    relative_floor: float = 1e-4
    #: [1] largest number of rounds of outlier rejection
    #: convention: Samples at the limit may alternate forever.
    max_cleanings: int = 2
    #: [1] probability that noise alone gives a further mode
    #: statistics: One record in a hundred.
    false_alarm: float = 0.01
    #: [1] least amplitude of a strongly damped mode beside others over the largest amplitude
    #: convention: What a release and errors of the other modes leave at the beginning is weaker.
    least_damped: float = 0.05
    #: [1] places at which a mode beside others is tried before the search for one ends
    places: int = 3
    #: [1] the highest overtone that is tried as the highest line of a wave whose tops are missing
    #: convention: Higher ones are weaker.
    highest_overtone: int = 5


TUNING = Tuning()
FALSE_ALARM, HIGHEST_OVERTONE, PLACES = TUNING.false_alarm, TUNING.highest_overtone, TUNING.places


def without_outliers(
    data: FitData, original_weights: FloatArray, linear: LinearSolution, lowest_hz: float, own: list[Band]
) -> FitData:
    """The data without outliers; `original_weights` are those before any rejection, `own` the bands of the modes.

    Many large residuals in the beginning are not rejected, since they may be a mode that the model lacks. A knock there
    hides such a mode, because it raises the spectrum at all frequencies. Therefore the strongest lines of the clipped
    residual are removed one by one, until some of what remains is rejected.
    """
    residual = linear.residual
    cleaned = reject_outliers(data, original_weights, residual)
    excluded = list(own)
    for _ in range(TUNING.most_lines):
        within = limited(original_weights, residual)
        if np.array_equal(within, residual) or not np.array_equal(cleaned.weights, data.weights):
            break
        found = candidates(data, within, linear.noise_variance, lowest_hz, tuple(excluded))
        if not found:
            break
        line = found[0]
        excluded.append(line.band)
        problem = Problem(replace(data, values=within), np.ones((data.time_s.size, 1)))
        pole = rough_poles(problem, start_pole(line))
        if not _is_plausible(complex(pole[0]), line, data):
            continue
        amplitudes = solve_linear(problem, ModeColumns(data.time_s, pole)).amplitudes
        residual = residual - motion(data.time_s, pole, amplitudes)
        cleaned = reject_outliers(data, original_weights, residual)
    return cleaned


def wider_baseline(
    problem: Problem, fit: PoleFit, bandwidth_hz: float, spectrum: ResidualSpectrum
) -> tuple[ComplexArray, float] | None:
    """Poles to keep and a wider bandwidth of the baseline, or None where the present bandwidth suffices.

    In a record of length T, motion left in the residual at a low frequency f leaks ``1 / (pi (f_n - f) T)^2`` of its
    power to a mode at f_n, on average half of that. Where this exceeds 2 % of the noise there, the baseline is extended
    to 0.4 of the lowest mode's frequency. `spectrum` is that of the residual.
    """
    span = problem.data.span_s
    swing = _swings(fit, span)
    kept = fit.poles[~swing]
    lowest = float(np.min(frequency_hz(kept)))
    cap = min(RELATIVE_BANDWIDTH * lowest, 0.5 * TUNING.max_splines / span)
    if 1.2 * bandwidth_hz > cap or _leak(spectrum, span, frequency_hz(kept)) < TUNING.leak:
        return None
    return kept, cap


def _swings(fit: PoleFit, span_s: float) -> BoolArray:
    """Mask of strongly damped motions of a few cycles, far below all other modes."""
    all_hz = frequency_hz(fit.poles)
    has_few_cycles = all_hz * span_s < TUNING.few_cycles
    if np.all(has_few_cycles):
        return np.zeros(all_hz.size, dtype=bool)
    low = all_hz < TUNING.far_below * float(np.min(all_hz[~has_few_cycles]))
    return np.asarray(has_few_cycles & low & (damping_ratio(fit.poles) > TUNING.strongly_damped))


def _leak(spectrum: ResidualSpectrum, span_s: float, modes_hz: FloatArray) -> float:
    """Largest share of the residual level at a mode that has leaked from far below it."""
    frequency, power = spectrum.frequency_hz, spectrum.power
    worst = 0.0
    for mode in modes_hz:
        below = frequency < RELATIVE_BANDWIDTH * mode
        distance = np.pi * (mode - frequency[below]) * span_s
        # Every second bin is independent.
        leaked = 0.5 * 0.5 * float(np.sum(power[below] / distance**2))
        worst = max(worst, leaked / max(spectrum.level(float(mode)), 1e-300))
    return worst


def find_modes(data: FitData, max_modes: int, lowest_hz: float = 0.0) -> ModalFit | None:
    """Fit every mode above `lowest_hz` that exceeds the noise around it; None when there is none.

    Notes
    -----
    RELAX: Li & Stoica (1996), doi:10.1109/78.485930. A line is accepted when it reduces the residual by
    more than the Bayesian information criterion asks for, with the noise level taken from the spectrum around it, so
    that coloured noise produces no modes.
    """
    # spikes that the modes explain return with the rejection of outliers
    current = _first_mode(without_spikes(data), lowest_hz)
    if current is None:
        return None
    search = _Search(data.weights, max_modes, lowest_hz)
    finished = False
    for _ in range(3 * max_modes):
        if finished:
            break
        current, finished = search.step(current)
    return _sorted(current)


@dataclass
class _Search:
    """Search for further modes: what is left out of it so far, and how often outliers were rejected."""

    original_weights: FloatArray
    max_modes: int
    lowest_hz: float
    excluded: list[Band] = field(default_factory=list)
    cleanings: int = 0

    def step(self, model: ModalFit) -> tuple[ModalFit, bool]:
        """The next model, and whether it is the last.

        A function, so that the models on the way to it are freed: each holds a dozen values for a sample.
        """
        full = model.fit.poles.size >= self.max_modes
        added = None if full else _add_strongest(model, self.lowest_hz, self.excluded)
        if isinstance(added, Band):
            self.excluded.append(added)
            return model, False
        if added is not None:
            return added, False
        wider = None
        if not full:
            wider = wider_baseline(model.problem, model.fit, model.bandwidth_hz, model.spectrum)
        if wider is not None:
            self.excluded.clear()
            return refit(
                replace(model, least_bandwidth_hz=wider[1]), wider[0], model.data, search=True
            ), False
        split = _split_close(model, self.max_modes)
        if split.fit is not model.fit:
            return split, True
        damped = None if full else _add_damped(split, self.lowest_hz)
        if damped is not None:
            return damped, False
        # Outliers are rejected last: in a long record, the misfit of a pair by one mode lies in its beginning and
        # resembles outliers.
        cleaned = _clean(split, self.original_weights, self.lowest_hz)
        self.cleanings += 1
        if cleaned is split or self.cleanings > TUNING.max_cleanings:
            return split, True
        return cleaned, False


def refit(model: ModalFit, poles: NDArray[np.complex128], data: FitData, *, search: bool = False) -> ModalFit:
    """Fit again from other poles or weights, with the baseline adapted to the lowest frequency."""
    lowest = float(np.min(frequency_hz(poles)))
    bandwidth = max(bandwidth_hz(lowest), min(model.least_bandwidth_hz, RELATIVE_BANDWIDTH * lowest))
    baseline = model.problem.baseline
    if abs(bandwidth / model.bandwidth_hz - 1.0) > 0.05:
        baseline = baseline_splines(data.time_s, bandwidth)
    else:
        bandwidth = model.bandwidth_hz
    same = data is model.data and baseline is model.problem.baseline
    problem = model.problem if same else Problem(data, baseline)
    fit = fit_poles(problem, poles, search=search)
    return replace(model, problem=problem, fit=fit, bandwidth_hz=bandwidth)


def _first_mode(data: FitData, lowest_hz: float) -> ModalFit | None:
    line = baseline_splines(data.time_s, 1e-12)
    variance = rough_variance(data)
    start = solve_linear(Problem(data, line), no_columns(data.time_s))
    excluded: list[Band] = []
    # Where samples are missing, such as the tops of a clipped wave, the highest line of a spectrum may be an overtone.
    overtones = range(0)
    if np.any(data.weights == 0.0):
        overtones = range(2, HIGHEST_OVERTONE + 1)
    for _ in range(6):
        found = candidates(data, start.residual, variance, lowest_hz, tuple(excluded))
        if not found:
            break
        for candidate in found:
            first = _alone(data, candidate)
            if first is not None:
                lower = [_alone(data, replace(candidate, frequency_hz=_hz(first) / n)) for n in overtones]
                waves = [w for w in lower if w is not None and _is_overtone(_hz(first) / _hz(w))]
                # beside the first one, the baseline would take a slow mode for drift
                slow = [_alone(data, one) for one in found if _is_slow_mode(one, first)]
                tried = [first, *waves, *(one for one in slow if one is not None)]
                return min(tried, key=lambda one: float(np.sum(one.fit.linear.rss / variance)))
        excluded += [candidate.band for candidate in found]
    damped = fit_damped(data, start.residual, lowest_hz)
    return None if damped is None else ModalFit(damped.problem, damped.fit, damped.bandwidth_hz)


def _is_slow_mode(candidate: Candidate, first: ModalFit) -> bool:
    """Whether a line below those that may be modes beside the first one has too many cycles for a drift."""
    hz = candidate.frequency_hz
    return hz < first.lowest_line_hz and hz * first.data.span_s > TUNING.few_cycles


def _alone(data: FitData, candidate: Candidate) -> ModalFit | None:
    """Fit of one line; None where it ends elsewhere."""
    bandwidth = bandwidth_hz(candidate.frequency_hz)
    problem = Problem(data, baseline_splines(data.time_s, bandwidth))
    fit = fit_poles(problem, start_pole(candidate), search=True)
    plausible = _is_plausible(complex(fit.poles[0]), candidate, data)
    return ModalFit(problem, fit, bandwidth) if plausible else None


def _hz(model: ModalFit) -> float:
    return float(frequency_hz(model.fit.poles)[0])


def _is_overtone(ratio: float) -> bool:
    return abs(ratio - round(ratio)) < OWN_BAND * round(ratio)  # round() is 0 where a fit ends far above


def _split_close(model: ModalFit, max_modes: int) -> ModalFit:
    """Split the first mode that is a resolved pair, and refit with all others; note the unresolved pairs before it.

    The model has the same fit where no mode is a resolved pair.
    """
    if model.fit.poles.size >= max_modes:
        return model
    for index in range(model.fit.poles.size):
        split = split_mode(model.problem, model.fit, index, model.spectrum)
        if split is None:
            continue
        if split.resolved:
            poles = np.concatenate([np.delete(model.fit.poles, index), split.poles])
            return refit(model, poles, model.data, search=True)
        if model.unresolved_near(index) is None:
            model = replace(model, unresolved=(*model.unresolved, split.strong))
    return model


def _add_strongest(model: ModalFit, lowest_hz: float, excluded: list[Band]) -> ModalFit | Band | None:
    data, fit = model.data, model.fit
    own = _own_bands(fit)
    lowest = max(lowest_hz, model.lowest_line_hz)
    residual, variance = fit.linear.residual, fit.linear.noise_variance
    found = candidates(data, residual, variance, lowest, tuple(own + excluded), model.spectrum)
    if not found:
        return None
    candidate = found[0]
    left = Problem(replace(data, values=residual), model.problem.baseline)
    alone = rough_poles(left, start_pole(candidate))
    if not _is_plausible(complex(alone[0]), candidate, data):
        return candidate.band
    joint = with_line(model, alone)
    if (
        joint is None
        or not is_significant(model, joint)
        or not _is_plausible(joint.fit.poles[-1], candidate, data)
    ):
        return candidate.band
    return joint


def with_line(model: ModalFit, line: ComplexArray) -> ModalFit | None:
    """The model with one more mode, its pole last; None where the others move, or it is a rounding error of theirs."""
    fit = model.fit
    joint = refit(model, np.concatenate([fit.poles, line]), model.data, search=True)
    if _moved(model, joint):
        return None
    strength = np.max(np.abs(joint.fit.linear.amplitudes), axis=1)
    return None if strength[-1] < TUNING.relative_floor * np.max(strength) else joint


def _moved(before: ModalFit, after: ModalFit) -> bool:
    """Whether a mode becomes another one beside a further mode: it moves by 3 %, and by more than `moved_bins`."""
    hz = frequency_hz(before.fit.poles)
    most_hz = np.maximum(OWN_BAND * hz, TUNING.moved_bins / before.data.span_s)
    return bool(np.any(np.abs(frequency_hz(after.fit.poles)[: hz.size] - hz) > most_hz))


def _add_damped(model: ModalFit, lowest_hz: float) -> ModalFit | None:
    """Add the strongly damped mode that the lines of the spectrum do not show; None without one."""
    data, fit = model.data, model.fit
    lowest = max(lowest_hz, model.lowest_line_hz)
    for start in damped_starts(model.problem, fit.linear, lowest)[:PLACES]:
        joint = refit(model, np.append(fit.poles, start), data, search=True)
        hz = frequency_hz(joint.fit.poles)
        pole, strength = complex(joint.fit.poles[-1]), np.max(np.abs(joint.fit.linear.amplitudes), axis=1)
        apart = np.abs(hz[:-1] / hz[-1] - 1.0) > OWN_BAND
        if (
            joint.fit.converged
            and np.all(apart)
            and not _moved(model, joint)
            and strength[-1] > TUNING.least_damped * np.max(strength)
            and TUNING.strongly_damped < float(damping_ratio(pole)) < MAX_DAMPING
            and lowest < hz[-1] < nyquist_hz(data.time_s)
            and is_significant(model, joint)
            and is_above_noise(data, fit.linear.residual, joint.fit.linear, pole)
        ):
            return joint
    return None


def _own_bands(fit: PoleFit) -> list[Band]:
    return [Band(float(f), OWN_BAND * float(f)) for f in frequency_hz(fit.poles)]


def is_significant(
    before: ModalFit, after: ModalFit, level: float = 1.0, level_dof: float = np.inf, tries: int = 1
) -> bool:
    """Whether a further mode removes more than it would of white noise, by chance in any of the lines tried.

    The threshold of a line holds for long records; in a few dozen samples, this many parameters fit noise. `level` is
    the noise about the line relative to that of the samples, from this many degrees of freedom; `tries` the number of
    decay rates tried.
    """
    linear, k = after.fit.linear, after.data.values.shape[1]
    drop = float(np.sum((before.fit.linear.rss - linear.rss) / linear.noise_variance)) / level
    splines = after.problem.baseline.shape[1]
    more = 2.0 + 2.0 * k + k * max(splines - before.problem.baseline.shape[1], 0)
    left = float(np.sum(after.data.counts)) - k * splines - (2.0 + 2.0 * k) * after.fit.poles.size
    chance = float(fdtrc(more, min(max(left, 1.0), level_dof), max(drop, 0.0) / more))
    return chance * after.data.time_s.size * tries < FALSE_ALARM


def start_pole(candidate: Candidate) -> NDArray[np.complex128]:
    """Pole from which the fit of a candidate starts, shape (1,)."""
    return np.array([-candidate.decay_per_s + 2j * np.pi * candidate.frequency_hz])


def _is_plausible(pole: complex, candidate: Candidate, data: FitData) -> bool:
    frequency, damping = float(frequency_hz(pole)), float(damping_ratio(pole))
    if not np.isfinite(frequency):
        return False
    reach = 0.05 * candidate.frequency_hz + 2.0 * candidate.decay_per_s
    near = abs(frequency - candidate.frequency_hz) < reach
    return near and abs(damping) < MAX_DAMPING and frequency < nyquist_hz(data.time_s)


def _clean(model: ModalFit, original: FloatArray, lowest_hz: float) -> ModalFit:
    lowest = max(lowest_hz, model.lowest_line_hz)
    data = without_outliers(model.data, original, model.fit.linear, lowest, _own_bands(model.fit))
    if np.array_equal(data.weights, model.data.weights):
        return model
    return refit(model, model.fit.poles, data, search=True)


def _sorted(model: ModalFit) -> ModalFit:
    return refit(model, model.fit.poles[np.argsort(frequency_hz(model.fit.poles))], model.data)

"""Comparison of one recorded decay with its simulation under each damping model (Fig. 2 to 4).

Every simulation starts from the state identified at the beginning of the fit, and the identified modes keep their
measured frequencies (the difference to those of the updated beam enters as modal mass): the comparison is one of
damping, not of a phase that drifts over hundreds of periods. Every sample has a predictive density; scores, errors and
coverage of each model follow from it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from modal_id import DisplacementSeries, FittedMode, Identification, IdentifiedMode
from sim.beam import AncfBeam, BeamProperties, BuckledBeamError, NoEquilibriumError
from sim.comparison.bands import Candidate, Simulated, shape_sd, simulate_candidates, start_draws
from sim.comparison.drag import AirDrag, DragDecay, DragLimit, identify_drag
from sim.comparison.problem import TUNING as MATCHING
from sim.comparison.problem import (
    DecaySetting,
    decay_setting,
    envelope_and_phase_error,
    match_modes,
    with_corrected_start,
)
from sim.comparison.results import DecayComparison, ModelDecay
from sim.comparison.scores import Prediction, Samples, crps, log_density, score_difference, score_sum
from sim.damping import AIR_DRAG
from sim.dynamics import fitted_modes
from tracker import INTERVAL_SD, Failure, FloatArray

FitDecay = Callable[[DisplacementSeries], tuple[FittedMode, ...] | Failure]


def compare_decay(
    properties: BeamProperties,
    identification: Identification,
    candidates: Mapping[str, Candidate],
    *,
    fit: FitDecay,
    air: AirDrag | None = None,
    beams: Sequence[BeamProperties] = (),
) -> DecayComparison | Failure:
    """Simulate a recorded decay with each candidate, from the fitted state at ``onset.fit_from_s``.

    Parameters
    ----------
    properties : BeamProperties
        Usually the updated ones.
    identification : Identification
        Of a series in mm whose channels have positions on the beam.
    candidates : mapping of str to Candidate
        The others are scored against the first.
    fit : callable
        Returns the modes of a simulated series (same times and channels, from the beginning of the fit).
    air : AirDrag or None
        Adds the model `AIR_DRAG`: generic damping with the quadratic drag of still air. Where the drag coefficient is
        identified from the recording, the model is added only if the recording shows drag.
    beams : sequence of BeamProperties
        Posterior draws of the updated beam, whose shapes widen the bands of every model.

    Returns
    -------
    DecayComparison or Failure
        The latter without a scale, positions or a mode of the beam, or if every simulation diverges; a single model
        that diverges is omitted with a note.

    Notes
    -----
    Each mode is projected on the markers by least squares; for large motion the start is corrected, and where drag is
    identified the start and the frequency are those of its fit. The predictive density of a sample is normal about the
    simulated curve. Its variance is the sum of those of the draws, of the noise, and of the beam's shape: the scatter
    of the drawn beams, or the misfit of the shape where that is larger, which does not depend on the damping model.
    """
    name = identification.series.name
    if not candidates:
        return Failure("no damping model could be built from the identified modes", name)
    count = _mode_count(identification, candidates)
    reason = obstacle(properties, identification, count)
    if reason:
        return Failure(reason, name)
    beam = AncfBeam(properties)
    try:
        modes = fitted_modes(beam, count)
        matched = match_modes(identification, modes)
        if isinstance(matched, Failure):
            return replace(matched, where=name)
        setting = decay_setting(beam, modes, identification, matched)
        setting = with_corrected_start(setting, next(iter(candidates.values())).model)
        drag: DragDecay | DragLimit | None = None
        if air is not None:
            noise_mm = np.nan_to_num(noise_sd_mm(setting, identification, {}), nan=1.0)
            drag = identify_drag(setting, air, noise_mm)
        if isinstance(drag, DragDecay):
            setting = drag.setting
        draws = max((len(candidate.draws) for candidate in candidates.values()), default=0)
        starts = start_draws(setting, identification, draws) if draws else []
        shapes = shape_sd(setting, identification, beams)
    except (BuckledBeamError, NoEquilibriumError) as error:
        return Failure(str(error), name)
    all_candidates = dict(candidates)
    if isinstance(drag, DragDecay):
        all_candidates[AIR_DRAG] = Candidate(drag.model)
    runs = simulate_candidates(setting, all_candidates, starts)
    good = {label: run for label, run in runs.items() if isinstance(run, Simulated)}
    lost = {
        label: f"{run.reason} {all_candidates[label].model.caution}".rstrip()
        for label, run in runs.items()
        if not isinstance(run, Simulated)
    }
    if not good:
        label, why = next(iter(lost.items()))
        return Failure(f"the simulation with {label} damping failed: {why}", name)
    if isinstance(drag, DragDecay) and AIR_DRAG in good:
        good[AIR_DRAG] = good[AIR_DRAG].with_sd(drag.curve_sd_mm)
    return _comparison(
        setting,
        identification,
        {label: run.with_shapes(setting, shapes) for label, run in good.items()},
        fit,
        drag,
        tuple(f"The simulation with {label} damping failed: {why}" for label, why in lost.items()),
    )


def _comparison(
    setting: DecaySetting,
    identification: Identification,
    runs: Mapping[str, Simulated],
    fit: FitDecay,
    drag: DragDecay | DragLimit | None,
    notes: tuple[str, ...],
) -> DecayComparison:
    matched, series = setting.matched, identification.series
    after = identification.decay_rows
    fitted = drag.fitted_mm if isinstance(drag, DragDecay) else None
    identified = {label: _identified(label, run, setting, identification, fit) for label, run in runs.items()}
    shift, shift_sd = frequency_shift(matched.target)
    return DecayComparison(
        recording=series.name,
        mode_number=matched.target_number,
        frequency_hz=matched.target.frequency_hz,
        damping_ratio=matched.target.damping_ratio,
        frequency_shift=shift,
        frequency_shift_sd=shift_sd,
        tip_amplitude_mm=1e3 * setting.tip_amplitude_m,
        channels=series.channels,
        positions_mm=series.positions_mm,
        unit=series.unit,
        time_s=series.time_s[after],
        measured=setting.measured_mm,
        used=identification.used[after],
        models=model_decays(setting, identification, runs, identified, fitted),
        drag=drag.fit if isinstance(drag, DragDecay) else drag,
        notes=(*matched.notes, *notes),
    )


def obstacle(properties: BeamProperties, identification: Identification, count: int) -> str:
    """Why this recording cannot be compared with a simulation; empty if it can."""
    series = identification.series
    if series.unit != "mm":
        return (
            f"the displacement is in {series.unit!r}, not in mm: a simulation needs the scale. "
            "Give camera.mm_per_px or markers.size_mm."
        )
    if not np.all(np.isfinite(series.positions_mm)):
        return "the distances of the markers from the clamp are unknown: give markers.positions_mm"
    if np.any((series.positions_mm < 0.0) | (series.positions_mm > 1e3 * properties.length_m)):
        return (
            f"markers are at {series.positions_mm.tolist()} mm, but the beam reaches from 0 to "
            f"{1e3 * properties.length_m:g} mm: check markers.positions_mm and beam.length_mm"
        )
    if not identification.fitted_modes or not np.any(identification.used):
        return "no mode was identified"
    if identification.target is None and any(mode.target for mode in identification.failed):
        return "the target mode of the recording was not identified"
    if count > 2 * properties.elements:
        return (
            f"{properties.elements} elements have {2 * properties.elements} bending modes, and {count} are needed: "
            "increase beam.elements"
        )
    return ""


def _mode_count(identification: Identification, candidates: Mapping[str, Candidate]) -> int:
    """Number of beam modes that the identified modes and the damping models need."""
    known = [mode.number for mode in identification.modes if mode.number is not None]
    return max([*known, *(candidate.model.least_beam_modes for candidate in candidates.values())])


def _identified(
    label: str, run: Simulated, setting: DecaySetting, identification: Identification, fit: FitDecay
) -> tuple[FittedMode | None, str]:
    """The target mode as identified from the simulated decay, or the reason why there is none."""
    series = identification.series
    after = identification.decay_rows
    found = fit(
        DisplacementSeries(
            name=f"{series.name} simulated with {label} damping",
            time_s=series.time_s[after],
            channels=series.channels,
            values=run.central,
            sd=np.full_like(run.central, np.nan),
            unit=series.unit,
            positions_mm=series.positions_mm,
            direction=series.direction,
        )
    )
    if isinstance(found, Failure):
        return None, f"nothing was identified from the simulated decay: {found.reason}"
    target_hz = setting.matched.target.frequency_hz
    near = [m for m in found if abs(m.frequency_hz / target_hz - 1.0) < MATCHING.near]
    if not near:
        nearest = min(found, key=lambda mode: abs(mode.frequency_hz - target_hz))
        return None, (
            f"the simulated decay shows no mode near {target_hz:.4g} Hz; the nearest is {nearest.frequency_hz:.4g} Hz"
        )
    # the largest, not the nearest: a weak component distorted by large motion may be nearer than the mode itself
    return max(near, key=lambda mode: mode.amplitude), ""


def noise_sd_mm(
    setting: DecaySetting, identification: Identification, models: Mapping[str, Simulated]
) -> FloatArray:
    """Standard deviation of every sample's noise, shape (n, k).

    The series gives the relative standard deviations of the samples of a channel, the residual its noise level: that
    of the identification's fit, or of a simulation where that is smaller, as for an amplitude-dependent damping ratio,
    which Eq. 1 does not describe.
    """
    after = identification.decay_rows
    given = identification.series.sd[after]
    relative = np.where(np.isfinite(given) & (given > 0.0), given, np.nan)
    valid = setting.used & np.isfinite(setting.measured_mm)
    left = [_rms(np.where(valid, setting.measured_mm - m.central, 0.0), valid) for m in models.values()]
    # ignores NaN
    level = np.fmin.reduce([identification.residual_sd, *left])
    typical = _rms(np.where(valid, np.nan_to_num(relative, nan=0.0), 0.0), valid & np.isfinite(relative))
    share = np.where(
        np.isfinite(relative) & (typical > 0.0), relative / np.where(typical > 0.0, typical, 1.0), 1.0
    )
    return np.asarray(level * share)


def model_decays(
    setting: DecaySetting,
    identification: Identification,
    runs: Mapping[str, Simulated],
    identified: Mapping[str, tuple[FittedMode | None, str]],
    fitted_mm: FloatArray | None = None,
) -> tuple[ModelDecay, ...]:
    """Every model's decay with its scores; gains are those of the first over each.

    `identified` holds the target mode identified from each simulated decay, or None and the reason. `fitted_mm` is the
    fit whose residual is the noise, that of the identification when absent.
    """
    noise = noise_sd_mm(setting, identification, runs)
    if fitted_mm is None:
        after = identification.decay_rows
        fitted_mm = np.nan_to_num((identification.fitted - identification.baseline)[after])
    samples = Samples(
        time_s=setting.time_s,
        values=setting.measured_mm,
        used=setting.used & np.isfinite(noise),
        fitted=fitted_mm,
        noise_sd=np.nan_to_num(noise, nan=1.0),
        period_s=2.0 * np.pi / float(setting.omega_rad_s[setting.at]),
    )
    predictions = _predictions(setting, runs, samples.noise_sd)
    valid = samples.used & np.isfinite(samples.values)
    measured = setting.coordinate_of(setting.measured_mm)
    first = next(iter(predictions.values()))
    decays = []
    for label, prediction in predictions.items():
        run, (mode, note) = runs[label], identified[label]
        missed = (prediction.mean - samples.values)[valid]
        envelope, phase = envelope_and_phase_error(
            setting.time_s, measured, setting.coordinate_of(prediction.mean), abs(setting.exponent)
        )
        decays.append(
            ModelDecay(
                model=label,
                simulated=run.central,
                nrmse=float(np.sqrt(np.mean(missed**2) / np.mean(samples.values[valid] ** 2))),
                frequency_hz=float("nan") if mode is None else mode.frequency_hz,
                damping_ratio=float("nan") if mode is None else mode.damping_ratio,
                frequency_shift=float("nan") if mode is None else mode.frequency_shift,
                envelope_error=envelope,
                phase_error_rad=phase,
                band_low=run.low,
                band_high=run.high,
                predictive_sd=np.where(np.isfinite(noise), prediction.sd, np.nan),
                log_density=score_sum(samples, log_density, prediction),
                crps=score_sum(samples, crps, prediction),
                log_density_gain=score_difference(samples, log_density, first, prediction),
                crps_gain=score_difference(samples, crps, first, prediction),
                coverage=float(np.mean(np.abs(missed) <= INTERVAL_SD * prediction.sd[valid])),
                note=" ".join(part for part in (note, run.note) if part),
            )
        )
    return tuple(decays)


def frequency_shift(mode: IdentifiedMode) -> tuple[float, float]:
    """Relative frequency shift at the initial amplitude, and its standard deviation."""
    amplitude_fit = mode.amplitude_dependence
    if amplitude_fit is None or not amplitude_fit.f0_hz > 0.0:
        return float("nan"), float("nan")
    return amplitude_fit.f2_hz / amplitude_fit.f0_hz, amplitude_fit.f2_sd_hz / amplitude_fit.f0_hz


def _predictions(
    setting: DecaySetting, runs: Mapping[str, Simulated], noise_mm: FloatArray
) -> dict[str, Prediction]:
    """Predictive density of each model: noise, draws, and the larger of scatter and misfit of the beam's shape."""
    # rms over a period of the misfit, which decays as measured
    decay = np.exp(setting.exponent.real * setting.time_s)
    misfit = np.outer(decay, np.abs(setting.matched.missed_mm)) / np.sqrt(2.0)
    return {
        label: Prediction(
            np.nan_to_num(run.central),
            np.sqrt(noise_mm**2 + run.sd**2 + np.maximum(misfit, run.shape_sd) ** 2),
        )
        for label, run in runs.items()
    }


def _rms(values: FloatArray, valid: NDArray[np.bool_]) -> FloatArray:
    """Rms of each channel; NaN without valid samples."""
    count = valid.sum(axis=0)
    total = (values**2).sum(axis=0)
    return np.asarray(np.sqrt(np.divide(total, count, out=np.full(count.shape, np.nan), where=count > 0)))

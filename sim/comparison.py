"""One recorded decay against the same decay simulated with each damping model (Fig. 2 to 4).

Every model starts from the state that identification found at the beginning of the fit, and the identified modes keep
their measured frequencies, whatever the updated beam makes of them (the difference goes into modal mass): what is
compared is damping, not a phase that drifts away over hundreds of periods.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

# the series type comes to this room through the results that hold it
from modal_id.results import (
    DisplacementSeries,
    FailedIdentification,
    Identification,
)
from sim.ancf import AncfBeam
from sim.beam import BeamProperties
from sim.damping import DampingModel, GenericDamping
from sim.dynamics import simulate
from sim.excitation import state_from_modes
from sim.matching import NEAR, MatchedModes, match_modes
from sim.modes import BeamModes, beam_modes
from sim.statics import BuckledBeamError, NoEquilibriumError
from sim.trajectory import FailedSimulation, State

FloatArray = NDArray[np.float64]

DEFAULT_STEP_S = 5e-4
# the fewest whose smallest and largest bound 90 %
DEFAULT_BAND_DRAWS = 19
# modes of the beam beside those that are measured, so that the residual damping has a place
_MODES = 8
# the most of a period of the highest identified mode that a step may take, as omega h
_LARGEST_PHASE = 0.35

Identify = Callable[[DisplacementSeries], Identification | FailedIdentification]


@dataclass(frozen=True)
class ModelDecay:
    """The decay that one damping model predicts.

    Attributes
    ----------
    model : str
    simulated : array, shape (n, k)
        In the unit of the comparison.
    nrmse : float
        rms(simulated - measured) / rms(measured) over the samples that identification used.
    frequency_hz, damping_ratio : float
        Of the recording's mode, identified from `simulated` as it was from the recording; NaN where that
        failed, `note` says why.
    band_low, band_high : array or None, shape (n, k)
        5 % and 95 % of simulations whose frequency and damping ratio are draws from the posterior of the
        recording's mode, started from the same fitted state; None where the model is not built from single modes.
    note : str
    """

    model: str
    simulated: FloatArray
    nrmse: float
    frequency_hz: float
    damping_ratio: float
    band_low: FloatArray | None = None
    band_high: FloatArray | None = None
    note: str = ""


@dataclass(frozen=True)
class DecayComparison:
    """A recorded decay and what each damping model makes of it.

    Attributes
    ----------
    recording : str
    mode_number : int
        Of the mode that the recording was made for.
    frequency_hz, damping_ratio : float
        Measured.
    channels : tuple of str, length k
    positions_mm : array, shape (k,)
    unit : str
    time_s : array, shape (n,)
        The recording's times from the beginning of the fit.
    measured : array, shape (n, k)
        Baseline removed; NaN where missing.
    used : bool array, shape (n, k)
    models : tuple of ModelDecay
    notes : tuple of str
    """

    recording: str
    mode_number: int
    frequency_hz: float
    damping_ratio: float
    channels: tuple[str, ...]
    positions_mm: FloatArray
    unit: str
    time_s: FloatArray
    measured: FloatArray
    used: NDArray[np.bool_]
    models: tuple[ModelDecay, ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class FailedComparison:
    """A recording whose decay could not be simulated: falsy, with the reason."""

    recording: str
    reason: str

    def __bool__(self) -> bool:
        return False


@dataclass(frozen=True)
class _Setting:
    """What all simulations of one recording share."""

    beam: AncfBeam
    modes: BeamModes
    state: State
    start_s: float
    time_s: FloatArray
    positions_m: FloatArray
    axis: tuple[float, float]
    omega_rad_s: FloatArray
    step_s: float


def compare_decay(
    properties: BeamProperties,
    identification: Identification,
    models: Mapping[str, DampingModel],
    *,
    identify: Identify,
    band_draws: int = DEFAULT_BAND_DRAWS,
    step_s: float = DEFAULT_STEP_S,
) -> DecayComparison | FailedComparison:
    """Simulate a recorded decay with each of `models`, from the fitted state at ``onset.fit_from_s``.

    Parameters
    ----------
    properties : BeamProperties
        Usually the updated ones.
    identification : Identification
        Of a series in mm whose channels have positions on the beam.
    models : mapping of str to DampingModel
    identify : callable
        Takes the simulated series (same times and channels, from the beginning of the fit) and gives its
        identification.
    band_draws : int
        Simulations for the band of each generic model; 0 for no band.
    step_s : float
        Largest step; it is made smaller for high modes.

    Returns
    -------
    DecayComparison or FailedComparison
        The latter without a scale, positions or a mode of the beam, or when a simulation diverges.

    Notes
    -----
    Modes are projected on the markers by least squares, each for itself. The band holds the fitted state: it
    shows what the uncertainty of frequency and damping ratio does over the decay, not the scatter of the samples.
    """
    name = identification.series.name
    count = _mode_count(identification, models)
    reason = _unfit(properties, identification, count)
    if reason:
        return FailedComparison(name, reason)
    beam = AncfBeam(properties)
    try:
        modes = beam_modes(beam, min(max(count, _MODES), 2 * properties.elements))
        numbered = match_modes(identification, modes)
        if isinstance(numbered, str):
            return FailedComparison(name, numbered)
        setting = _setting(beam, modes, identification, numbered, step_s)
    except (BuckledBeamError, NoEquilibriumError) as error:
        return FailedComparison(name, str(error))
    after = identification.series.time_s >= identification.onset.fit_from_s
    measured = (identification.series.values - identification.baseline)[after]
    used = identification.used[after]
    decays = []
    for label, model in models.items():
        simulated = _simulated(setting, model, setting.omega_rad_s)
        if isinstance(simulated, FailedSimulation):
            return FailedComparison(name, f"the simulation with {label} damping failed: {simulated.reason}")
        band = _band(setting, model, numbered, band_draws)
        if isinstance(band, FailedSimulation):
            return FailedComparison(
                name, f"a simulation for the band of {label} damping failed: {band.reason}"
            )
        decays.append(
            _model_decay(label, simulated, measured, used, band, identification, numbered, identify)
        )
    return DecayComparison(
        recording=name,
        mode_number=numbered.target_number,
        frequency_hz=numbered.target.frequency_hz,
        damping_ratio=numbered.target.damping_ratio,
        channels=identification.series.channels,
        positions_mm=identification.series.positions_mm,
        unit=identification.series.unit,
        time_s=setting.time_s,
        measured=measured,
        used=used,
        models=tuple(decays),
        notes=numbered.notes,
    )


def _unfit(properties: BeamProperties, identification: Identification, count: int) -> str:
    """Why this recording cannot be compared with a beam, or nothing."""
    series = identification.series
    if series.unit != "mm":
        return (
            f"the displacement is in {series.unit!r}, not in mm: a simulation needs the scale. "
            "Give camera.mm_per_px or markers.size_mm."
        )
    if not np.all(np.isfinite(series.positions_mm)):
        return "the markers' distances from the clamp are unknown: give markers.positions_mm"
    if np.any((series.positions_mm < 0.0) | (series.positions_mm > 1e3 * properties.length_m)):
        return (
            f"markers stand at {series.positions_mm.tolist()} mm, but the beam reaches from 0 to "
            f"{1e3 * properties.length_m:g} mm: check markers.positions_mm and beam.length_mm"
        )
    if not identification.modes or not np.any(identification.used):
        return "no mode was identified"
    if identification.target is None and any(mode.target for mode in identification.failed):
        return "the mode that the recording was made for was not identified"
    if count > 2 * properties.elements:
        return (
            f"{properties.elements} elements have {2 * properties.elements} bending modes, and {count} are needed: "
            "raise beam.elements"
        )
    return ""


def _mode_count(identification: Identification, models: Mapping[str, DampingModel]) -> int:
    """Modes of the beam that the identified ones and the damping models ask for."""
    known = [mode.number for mode in identification.modes if mode.number is not None]
    modal = [len(model.damping_ratio) for model in models.values() if isinstance(model, GenericDamping)]
    return max(1, *known, *(m + 1 for m in modal))


def _setting(
    beam: AncfBeam, modes: BeamModes, identification: Identification, numbered: MatchedModes, step_s: float
) -> _Setting:
    series = identification.series
    displacement, velocity = np.zeros(modes.count), np.zeros(modes.count)
    displacement[numbered.numbers - 1] = numbered.coordinate.real
    velocity[numbered.numbers - 1] = numbered.rate.real
    omega = modes.omega_rad_s.copy()
    omega[numbered.numbers - 1] = numbered.omega_rad_s
    return _Setting(
        beam=beam,
        modes=modes,
        state=state_from_modes(beam, modes, displacement, velocity),
        start_s=identification.onset.fit_from_s,
        time_s=series.time_s[series.time_s >= identification.onset.fit_from_s],
        positions_m=series.positions_mm * 1e-3,
        axis=numbered.axis,
        omega_rad_s=omega,
        step_s=min(step_s, _LARGEST_PHASE / float(numbered.omega_rad_s.max())),
    )


def _simulated(
    setting: _Setting, model: DampingModel, omega_rad_s: FloatArray
) -> FloatArray | FailedSimulation:
    """Displacement in mm along the axis of motion at the series' times, shape (n, k)."""
    steps = max(3, int(np.ceil((setting.time_s[-1] - setting.start_s) / setting.step_s)))
    run = simulate(
        setting.beam,
        model,
        state=setting.state,
        duration_s=steps * setting.step_s,
        step_s=setting.step_s,
        output_positions_m=setting.positions_m,
        modes=setting.modes,
        target_omega_rad_s=omega_rad_s,
    )
    if isinstance(run, FailedSimulation):
        return run
    rest_x, rest_y, _ = setting.beam.points(setting.positions_m, setting.modes.equilibrium)
    moved = (run.x_m - rest_x) * setting.axis[0] + (run.y_m - rest_y) * setting.axis[1]
    return np.asarray(1e3 * CubicSpline(run.time_s, moved)(setting.time_s - setting.start_s))


def _band(
    setting: _Setting, model: DampingModel, numbered: MatchedModes, draws: int
) -> tuple[FloatArray, FloatArray] | FailedSimulation | None:
    """5 % and 95 % over draws of the target's frequency and damping ratio, spread evenly over the chains."""
    at = numbered.target_number - 1
    if draws < 1 or not isinstance(model, GenericDamping) or at >= len(model.damping_ratio):
        return None
    posterior = numbered.target.posterior
    frequency, ratio = posterior.frequency_hz.ravel(), posterior.damping_ratio.ravel()
    # The band lies about the curve, which has the frequency of small amplitude.
    middle_hz = float(np.median(frequency))
    every = np.linspace(0, frequency.size - 1, draws).astype(np.int64)
    runs = np.empty((draws, setting.time_s.size, setting.positions_m.size))
    for row, i in enumerate(every):
        ratios = list(model.damping_ratio)
        ratios[at] = float(ratio[i])
        omega = setting.omega_rad_s.copy()
        omega[at] = setting.omega_rad_s[at] + 2.0 * np.pi * float(frequency[i] - middle_hz)
        drawn = _simulated(setting, replace(model, damping_ratio=tuple(ratios)), omega)
        if isinstance(drawn, FailedSimulation):
            return drawn
        runs[row] = drawn
    # Weibull's plotting positions: of few draws the extremes stand for the quantiles they are expected at.
    low, high = np.quantile(runs, [0.05, 0.95], axis=0, method="weibull")
    return low, high


def _model_decay(
    label: str,
    simulated: FloatArray,
    measured: FloatArray,
    used: NDArray[np.bool_],
    band: tuple[FloatArray, FloatArray] | None,
    identification: Identification,
    numbered: MatchedModes,
    identify: Identify,
) -> ModelDecay:
    series = identification.series
    after = series.time_s >= identification.onset.fit_from_s
    found = identify(
        DisplacementSeries(
            name=f"{series.name} simulated with {label} damping",
            time_s=series.time_s[after],
            channels=series.channels,
            values=simulated,
            sd=np.full_like(simulated, np.nan),
            unit=series.unit,
            positions_mm=series.positions_mm,
            direction=series.direction,
        )
    )
    frequency, ratio, note = float("nan"), float("nan"), ""
    if isinstance(found, FailedIdentification):
        note = f"nothing was identified from the simulated decay: {found.reason}"
    elif not found.modes:
        note = "no mode was identified from the simulated decay"
    else:
        target_hz = numbered.target.frequency_hz
        mode = min(found.modes, key=lambda mode: abs(mode.frequency_hz - target_hz))
        near = [m for m in found.modes if abs(m.frequency_hz / target_hz - 1.0) < NEAR]
        if near:
            # Nearest is not it: a weak part that large motion distorts may lie nearer than the mode itself.
            mode = max(near, key=lambda mode: float(np.nanmax(np.abs(mode.shape))))
            frequency, ratio = mode.frequency_hz, mode.damping_ratio
        else:
            note = (
                f"the simulated decay shows no mode near {numbered.target.frequency_hz:.4g} Hz; "
                f"the nearest is {mode.frequency_hz:.4g} Hz"
            )
    valid = used & np.isfinite(measured)
    error = float(np.sqrt(np.mean((simulated - measured)[valid] ** 2) / np.mean(measured[valid] ** 2)))
    return ModelDecay(
        model=label,
        simulated=simulated,
        nrmse=error,
        frequency_hz=frequency,
        damping_ratio=ratio,
        band_low=None if band is None else band[0],
        band_high=None if band is None else band[1],
        note=note,
    )

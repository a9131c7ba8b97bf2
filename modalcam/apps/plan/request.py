"""A plan: the beam, camera, markers and motions that it is computed from, and its results."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from modal_id import DAMPING, FREQUENCY
from modalcam.apps.film import rendered_markers
from modalcam.common import ConfigError, shown
from modalcam.config import BeamConfig, ExperimentConfig, PlanConfig, RecordingConfig, beam_properties
from sim import MEASURED_DAMPING_RATIO
from sim.beam import BeamProperties
from sim.render import Camera, Marker
from tracker import INTERVAL_SD, Failure, FloatArray, data_frame
from tracker.markers import AUTO_KIND, kind_of

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

_DEFAULT_KIND = "blob"
# Recordings never begin with a dot.
_NO_FILE = ".plan"
_PLACEHOLDER_PX = 16
# Keys that a plan takes from a recording, from [camera] or [markers], or from all other recordings if they agree.
_SHARED = ("fps", "fps_tolerance_ppm", "mm_per_px", "positions_mm", "size_mm", "size_px", "exposure_s")
_NEEDED = {
    "fps": "camera.fps (recorded frames per second)",
    "mm_per_px": "camera.mm_per_px (scale; nothing is filmed yet that it could be measured from)",
    "positions_mm": "markers.positions_mm (distances of the markers from the clamp)",
}


@dataclass(frozen=True)
class Tuning:
    """What is assumed where the configuration says nothing."""

    #: [mm] amplitude of the tip in mode 1; in mode n, over n squared
    #: convention: That of `modalcam demo`. Over n squared, every mode is bent about equally.
    tip_of_mode_1: float = 10.0
    #: [1] share of the amplitude down to which a decay is filmed
    #: statistics: What follows holds 3 % of the information on damping: exp(-2 x) (1 + 2 x + 2 x^2) at x = -ln 0.03.
    last_share: float = 0.03
    #: [s] a decay is filmed no longer
    #: convention: Longer ones are asked for by plan.decay_s.
    longest: float = 20.0
    #: [px] size of a marker
    #: convention: That of `modalcam demo`.
    marker: float = 12.0


TUNING = Tuning()


@dataclass(frozen=True)
class PlannedMode:
    """One planned recording: its mode, steady amplitude at the tip, camera and markers at positions from the clamp.

    `rate_sd_ppm` is the relative standard deviation of the frame rate.

    Without `decay_s` the decay is filmed down to 3 % of the amplitude, at most for 20 s. The frame size of the camera
    does not matter.
    """

    number: int
    tip_amplitude_mm: float
    damping_ratio: float
    decay_s: float | None
    fps: float
    camera: Camera
    positions_mm: tuple[float, ...]
    markers: tuple[Marker, ...]
    kind: str
    rate_sd_ppm: float = 0.0

    def decay_length_s(self, frequency_hz: float) -> float:
        """Length of the filmed decay of a mode with this natural frequency."""
        if self.decay_s is not None:
            return self.decay_s
        rate = 2.0 * np.pi * frequency_hz * self.damping_ratio
        return float(min(-np.log(TUNING.last_share) / rate, TUNING.longest))


@dataclass(frozen=True)
class PlanRequest:
    """Beam and planned recordings; `assumptions` states in sentences what the configuration does not give."""

    beam: BeamProperties
    modes: tuple[PlannedMode, ...]
    assumptions: tuple[str, ...] = ()


def plan_request(config: ExperimentConfig, source: str) -> PlanRequest:
    """Request from a configuration.

    A mode is planned with the rate, scale, exposure and markers of its own `[[recordings]]` entry, else with those of
    `[camera]` and `[markers]`, else with those of the other recordings where they agree. Without plan.modes, modes 1
    to 5 and those of the recordings are planned, as far as these settings are known for them. `source` names the
    configuration in error messages.

    Raises
    ------
    ConfigError
        If the beam is missing or incomplete, if camera.fps, camera.mm_per_px or markers.positions_mm is unknown for a
        mode, if a marker is beyond the tip or cannot be rendered, or if lists in `[plan]` do not match plan.modes.
    """
    beam = beam_properties(config.beam)
    if isinstance(beam, str):
        keys = (config.beam or BeamConfig()).missing()
        msg = f"{source}: a plan needs the beam; give {', '.join(f'beam.{key}' for key in keys)}"
        raise ConfigError(msg)
    if not beam.cantilever:
        msg = f"{source}: plans are made for a cantilever only; found beam.ends = {list(beam.ends)}"
        raise ConfigError(msg)
    plan = config.plan
    assumed: list[str] = []
    chosen = "modes" in plan.model_fields_set
    recorded = () if chosen else (r.mode for r in config.recordings if r.mode is not None)
    numbers = list(plan.modes) if chosen else sorted({*plan.modes, *recorded})
    # A mode may be planned twice, with two amplitudes.
    settings = [(number, _settings(config, number, assumed)) for number in numbers]
    complete = [(number, found) for number, found in settings if not _missing(found)]
    if complete and len(complete) < len(settings) and not chosen:
        settings = complete
        assumed.append(
            "Only modes with a [[recordings]] entry are planned: the frame rate, scale or marker positions of "
            "the others are unknown."
        )
    try:
        for number, found in settings:
            _require_complete(config, number, found)
        numbers = [number for number, _ in settings]
        amplitudes = _for_each_mode("tip_amplitude_mm", plan.tip_amplitude_mm, numbers)
        dampings = _for_each_mode("damping_ratio", plan.damping_ratio, numbers)
        modes = tuple(
            _planned(plan, found, number, amplitude, damping, assumed)
            for (number, found), amplitude, damping in zip(settings, amplitudes, dampings, strict=True)
        )
    except ConfigError as error:
        msg = f"{source}: {error}"
        raise ConfigError(msg) from None
    return PlanRequest(beam, modes, tuple(dict.fromkeys(assumed)))


def _settings(config: ExperimentConfig, number: int, assumed: list[str]) -> RecordingConfig:
    """Everything that is given for the recording of one mode."""
    entries = [r for r in config.recordings if r.mode == number]
    found = config.for_recording(entries[0].file if entries else _NO_FILE)
    if len({tuple(getattr(r, key) for key in _SHARED) for r in entries}) > 1:
        assumed.append(
            f"Mode {number}: of its {len(entries)} recordings, the settings of {shown(entries[0].file)} are used."
        )
    others = [config.for_recording(r.file) for r in config.recordings]
    agreed: dict[str, Any] = {}
    for key in _SHARED:
        values = {getattr(r, key) for r in others}
        if getattr(found, key) is None and len(values) == 1:
            agreed[key] = values.pop()
    return found.model_copy(update=agreed)


def _missing(settings: RecordingConfig) -> list[str]:
    return [key for key in _NEEDED if not getattr(settings, key)]


def _require_complete(config: ExperimentConfig, number: int, settings: RecordingConfig) -> None:
    missing = _missing(settings)
    if not missing:
        return
    msg = f"to plan mode {number}, give {', '.join(_NEEDED[key] for key in missing)}"
    differ = [key for key in missing if any(getattr(r, key) for r in config.recordings)]
    if differ:
        msg += f", or a [[recordings]] entry with mode = {number}: the other recordings differ in {', '.join(differ)}"
    raise ConfigError(msg)


def _planned(
    plan: PlanConfig,
    settings: RecordingConfig,
    number: int,
    amplitude_mm: float | None,
    damping_ratio: float | None,
    assumed: list[str],
) -> PlannedMode:
    fps, mm_per_px, positions = settings.fps, settings.mm_per_px, settings.positions_mm or ()
    assert fps is not None  # noqa: S101 - `_missing` was empty
    assert mm_per_px is not None  # noqa: S101
    size_mm = settings.size_mm
    if size_mm is None:
        size_mm = (settings.size_px or TUNING.marker) * mm_per_px
        assumed.append(f"Markers of {size_mm:g} mm: markers.size_mm is not given.")
    kind = settings.kind or "auto"
    if kind_of(kind) is AUTO_KIND:
        kind = _DEFAULT_KIND
        assumed.append("Round dots: markers.kind is not given.")
    markers = rendered_markers(settings.model_copy(update={"kind": kind, "size_mm": size_mm}))
    if isinstance(markers, Failure):
        msg = f"a plan renders the markers: {markers.reason}"
        raise ConfigError(msg)
    if settings.exposure_s is None:
        assumed.append("Instantaneous exposures: camera.exposure_s is not given.")
    camera = Camera(
        width_px=_PLACEHOLDER_PX,
        height_px=_PLACEHOLDER_PX,
        mm_per_px=mm_per_px,
        origin_px=(0.0, 0.0),
        exposure_s=settings.exposure_s or 0.0,
        lens_blur_px=plan.lens_blur_px,
        read_noise_sd=plan.read_noise_sd,
        noise_gain=plan.noise_gain,
        bit_depth=plan.bit_depth,
        background=200.0 * 2.0 ** (plan.bit_depth - 8),
    )
    if amplitude_mm is None:
        amplitude_mm = TUNING.tip_of_mode_1 / number**2
        assumed.append(
            f"Tip amplitudes of {TUNING.tip_of_mode_1:g} mm over the mode number squared: plan.tip_amplitude_mm is "
            "not given."
        )
    if damping_ratio is None:
        damping_ratio = MEASURED_DAMPING_RATIO[min(number, len(MEASURED_DAMPING_RATIO)) - 1]
        assumed.append(
            "Damping ratios as measured by Yoo, Lee and Kim (Table 2): plan.damping_ratio is not given."
        )
    return PlannedMode(
        number,
        amplitude_mm,
        damping_ratio,
        plan.decay_s,
        float(fps),
        camera,
        positions,
        markers,
        kind,
        # As in a run, a rate that is given is exact unless its tolerance is given too.
        settings.fps_tolerance_ppm or 0.0,
    )


def _for_each_mode(key: str, values: tuple[float, ...] | None, modes: list[int]) -> Sequence[float | None]:
    if values is None or len(values) == 1:
        return [None if values is None else values[0]] * len(modes)
    if len(values) != len(modes):
        numbers = ", ".join(map(str, modes))
        expected = f"expected 1 number or {len(modes)}, one for each of modes {numbers}"
        msg = f"plan.{key}: {expected}; found {len(values)}"
        raise ConfigError(msg)
    return values


@dataclass(frozen=True)
class Limit:
    """A cause of uncertainty, the factor by which it increases the standard deviation of damping, and a remedy."""

    cause: str
    factor: float
    advice: str


@dataclass(frozen=True)
class ModePlan:
    """Prediction for one planned recording.

    Attributes
    ----------
    planned : PlannedMode
    frequency_hz, seen_hz : float
        Of the beam's theory, and as it appears at the frame rate: different where the mode is aliased.
    decay_s : float
    amplitude_px : array, shape (m,)
        Of each marker at the start, attenuated by the exposure; signed by the shape.
    blur_px : float
        Longest motion during an exposure.
    frequency_sd_hz, damping_sd : float
        Predicted standard deviations, that of the frequency with the tolerance of the frame rate.
    limits : tuple of Limit
        Causes of these, the strongest first.
    softening : float
        Relative change of the frequency from small amplitude to the start of the decay.
    linear_tip_mm : float
        Largest tip amplitude at which that change stays within the noise; inf if the planned one is below it.
    template_factor : float
        Factor in `damping_sd` for noise in the template that the tracker learns.
    """

    planned: PlannedMode
    frequency_hz: float
    seen_hz: float
    decay_s: float
    amplitude_px: FloatArray
    blur_px: float
    frequency_sd_hz: float
    damping_sd: float
    limits: tuple[Limit, ...]
    softening: float
    template_factor: float
    linear_tip_mm: float

    @property
    def number(self) -> int:
        """Number of the mode."""
        return self.planned.number

    @property
    def damping_ratio(self) -> float:
        """Assumed damping ratio."""
        return self.planned.damping_ratio

    @property
    def nonlinear(self) -> bool:
        """Whether the shift of the frequency with amplitude exceeds the noise."""
        return bool(np.isfinite(self.linear_tip_mm))

    @property
    def largest_px(self) -> float:
        """Largest amplitude of a marker at the start."""
        return float(np.max(np.abs(self.amplitude_px)))


@dataclass(frozen=True)
class BetterPositions:
    """Marker positions for some of the planned modes, and the factors on their standard deviations."""

    modes: tuple[int, ...]
    positions_mm: tuple[float, ...]
    factors: tuple[float, ...]


@dataclass(frozen=True)
class FrameRate:
    """A frame rate for some of the planned modes, the apparent frequency of each, and whether one is aliased."""

    modes: tuple[int, ...]
    fps: float
    seen_hz: tuple[float, ...]
    aliased: bool


@dataclass(frozen=True)
class TrialSummary:
    """All rendered recordings of one mode: in how many it was identified, and the reasons of the failures, each once.

    A mode with a flag of a wrong value counts as not identified.

    ``damping_spread`` is the standard deviation of the damping ratio over the trials; NaN below three.
    """

    mode: int
    identified: int
    count: int
    damping_spread: float
    problems: tuple[str, ...]


@dataclass(frozen=True, repr=False)
class Plan:
    """Predicted intervals with suggestions and, where recordings were simulated, their scatter."""

    request: PlanRequest
    modes: tuple[ModePlan, ...]
    positions: tuple[BetterPositions, ...] = ()
    rates: tuple[FrameRate, ...] = ()
    trials: tuple[TrialSummary, ...] = ()

    def to_dataframe(self) -> pd.DataFrame:
        """Predictions, a row a mode; standard deviations, not half-widths of intervals."""
        trials = {t.mode: t for t in self.trials}
        rows = []
        for m in self.modes:
            row = {
                "mode": m.number,
                "frequency_hz": m.frequency_hz,
                "frequency_sd_hz": m.frequency_sd_hz,
                DAMPING[0].name: m.damping_ratio,
                DAMPING[1].name: m.damping_sd,
                "fps": m.planned.fps,
                "decay_s": m.decay_s,
                "tip_amplitude_mm": m.planned.tip_amplitude_mm,
                "largest_amplitude_px": m.largest_px,
                "limited_by": m.limits[0].cause,
                "limit_factor": m.limits[0].factor,
            }
            if m.number in trials:
                row["identified"] = trials[m.number].identified
                row["damping_ratio_spread"] = trials[m.number].damping_spread
            rows.append(row)
        units = {"fps": "1/s", "decay_s": "s", "tip_amplitude_mm": "mm", "largest_amplitude_px": "px"}
        return data_frame(rows, {one.name: one.unit for one in (*FREQUENCY, *DAMPING)} | units).set_index(
            "mode"
        )

    def plot(self, ax: Axes | None = None) -> Axes:
        """Assumed damping ratios with their predicted 90 % intervals over frequency."""
        if ax is None:
            import matplotlib.pyplot as plt  # noqa: PLC0415 - slow to load

            ax = plt.figure().subplots()
        frequency = [m.frequency_hz for m in self.modes]
        damping = [100.0 * m.damping_ratio for m in self.modes]
        half = [100.0 * INTERVAL_SD * m.damping_sd for m in self.modes]
        ax.errorbar(frequency, damping, half, fmt="o", capsize=3.0)
        ax.set_xlabel("natural frequency (Hz)")
        ax.set_ylabel("damping ratio (%), predicted 90 % interval")
        return ax

    def __repr__(self) -> str:
        relative = {m.number: 100.0 * m.damping_sd / m.damping_ratio for m in self.modes}
        parts = ", ".join(f"mode {number}: ± {percent:.2g} %" for number, percent in relative.items())
        return f"<Plan: predicted sd of the damping ratio, relative; {parts}>"

    def _repr_html_(self) -> str:
        return str(self.to_dataframe().to_html(float_format="{:.5g}".format))

"""Stage of the identification: modes of each recording, and those of the beam measured over all recordings.

Amplitudes are corrected for the exposure time; the standard deviation of each mode is divided by its sources, as the
GUM asks for.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from modal_id import FailedMode, Identification, IdentifiedMode, IdentifySettings
from modal_id.modes import Combined, LineAliases, combine, lines_of, mac, resolve_aliases
from modalcam.config import identify_settings
from modalcam.pipeline.results import RecordingResult
from modalcam.pipeline.stage import Context, Stage
from sim.beam import BeamModes
from sim.comparison import bands, draw_indices
from sim.updating import MeasuredShape
from tracker import DisplacementSeries, Failure, FloatArray, MarkerTracks
from tracker.geometry import exposure_attenuation, median_over_time, time_axis
from tracker.markers import AUTO_KIND, kind_of


@dataclass(frozen=True)
class Tuning:
    """Which correction is told, and which other mode counts."""

    #: [1] a correction for the exposure below this share of the amplitude gets no note, unless it exceeds its sd
    #: convention: Three digits of an amplitude are unchanged.
    worth_a_note: float = 1e-3
    #: [1] a mode that a recording was not made for counts from this MAC with the theory on
    #: convention: 0.9 is usual for the same shape; a wrong mode number would corrupt the combined modes.
    least_mac: float = 0.95
    #: [markers] fewer give no shape
    #: physics: With fewer a shape holds no information beyond its scale.
    least_markers: int = 3


TUNING = Tuning()
_Failed = TypeVar("_Failed", bound=Failure)


@dataclass(frozen=True)
class ImageRows:
    """Row of each channel at rest, shape (k,), y down, and the number of rows of the image."""

    at_rest_px: FloatArray
    height_px: int


def image_rows(tracks: MarkerTracks, channels: Sequence[str]) -> ImageRows:
    """Rows of the markers with these names."""
    rest_px = median_over_time(tracks.y_px)
    return ImageRows(rest_px[[tracks.markers.index(name) for name in channels]], tracks.decode.height_px)


def identify_series(
    series: DisplacementSeries,
    settings: IdentifySettings,
    exposure_s: float | None,
    detected: str = "",
    rows: ImageRows | None = None,
    cut_off: str = "",
) -> Identification | Failure:
    """Modes of one recording, their amplitudes corrected for the exposure time, and checks of the residual.

    `detected` says which markers were found where the user named no kind, `cut_off` that the file has fewer frames than
    it declares: a failure then may be theirs. `rows` are those of the channels, where the readout of the rows is not
    given.
    """
    # Workers only: the main process would hold the libraries of the fit beside all results.
    from modal_id import identify  # noqa: PLC0415
    from modal_id.modes import (  # noqa: PLC0415
        readout_note,
        residual_checks,
    )

    found = identify(series, settings)
    if isinstance(found, Identification):
        found = correct_amplitudes(found, exposure_s)
        if not found.has_decay:
            # The checks and the delay of the rows are those of a fitted decay.
            return found
        note = "" if rows is None else readout_note(found, rows.at_rest_px, rows.height_px)
        notes = (*found.notes, note) if note else found.notes
        failed = tuple(_because_cut(one, cut_off) if one.target else one for one in found.failed)
        return replace(found, checks=residual_checks(found), notes=notes, failed=failed)
    if cut_off:
        return _because_cut(found, cut_off)
    if not detected:
        return found
    hint = (
        f"{detected} were detected without a kind of marker being given: if none of them is on the vibrating part, set "
        "points or a line on it with `modalcam pick FILE`."
    )
    return replace(found, reason=f"{found.reason} {hint}")


def _because_cut(failed: _Failed, cut_off: str) -> _Failed:
    """The failure, with the cut of the file as its first cause and the length of a decay that can be identified."""
    if not cut_off:
        return failed
    from modal_id.modes import flag_rules  # noqa: PLC0415

    hz = failed.frequency_hz if isinstance(failed, FailedMode) else math.nan
    cycles = flag_rules.TUNING.least_cycles
    needed = f" at least {cycles / hz:.3g} s ({cycles:g} cycles at {hz:.4g} Hz)" if hz > 0.0 else ""
    record = f"the record needs{needed} of free decay" if needed else "the record needs a free decay"
    return replace(
        failed, reason=f"{cut_off}; {record}: copy or export the file again. In what is left, {failed.reason}"
    )


IDENTIFYING = Stage(
    "identifying",
    "modes",
    ("modal_id", "tracker", "modalcam.pipeline.identify"),
    identify_series,
    lambda name, reason: Failure(reason, name),
)


def identify_recordings(
    context: Context, recordings: Sequence[RecordingResult], modes: BeamModes | None
) -> list[RecordingResult]:
    """Identify the modes of each recording that has a displacement series; `modes` are those of the beam's theory."""

    def inputs(recording: RecordingResult) -> Mapping[str, Any] | None:
        if recording.series is None or recording.identification is not None:
            return None
        config = context.config.for_recording(recording.file)
        settings = identify_settings(
            config,
            seed=context.seed,
            sha256=recording.sha256,
            positions_mm=recording.series.positions_mm,
            modes=modes,
        )
        tracks = recording.tracks
        detected = ""
        if isinstance(tracks, MarkerTracks) and kind_of(config.kind) is AUTO_KIND:
            shown = kind_of(tracks.kind)
            # A code is hardly read into something else.
            detected = "" if shown.decodes_shape else f"{len(tracks.markers)} {shown.noun}s"
        cut_off = ""
        if isinstance(tracks, MarkerTracks):
            cut_off = tracks.decode.cut_off(tracks.time_axis.known_fps)
        rows = None
        if isinstance(tracks, MarkerTracks) and tracks.readout_s is None:
            rows = image_rows(tracks, recording.series.channels)
        return {
            "series": recording.series,
            "settings": settings,
            "exposure_s": config.exposure_s,
            "detected": detected,
            "rows": rows,
            "cut_off": cut_off,
        }

    return [_with_one_series(recording) for recording in IDENTIFYING.each(context, recordings, inputs)]


def _with_one_series(recording: RecordingResult) -> RecordingResult:
    """The recording without the copy of its series that came back from the worker."""
    found = recording.identified
    if found is None or recording.series is None:
        return recording
    return replace(recording, identification=replace(found, series=recording.series))


def correct_amplitudes(found: Identification, exposure_s: float | None) -> Identification:
    """Divide each mode's amplitude by the attenuation due to the exposure time.

    `IdentifiedMode.amplitude` is corrected; a note states the correction if it exceeds the amplitude's standard
    deviation or 0.1 %. The series, the fit and `IdentifiedMode.shape` stay uncorrected, since they are compared with
    the footage; the factor is the same for all channels, so mode shapes do not change.
    """
    if exposure_s is None or exposure_s <= 0.0:
        return found
    return replace(found, modes=tuple(_corrected(mode, exposure_s) for mode in found.modes))


def _corrected(mode: IdentifiedMode, exposure_s: float) -> IdentifiedMode:
    product = mode.frequency_hz * exposure_s
    if product > time_axis.TUNING.largest_product:
        note = (
            f"The exposure of {1e3 * exposure_s:g} ms lasts {product:.2g} periods of this mode: most of its motion is "
            "averaged out, so its amplitude is not that of the beam. Use a shorter exposure."
        )
        return replace(mode, notes=(*mode.notes, note))
    factor = 1.0 / exposure_attenuation(mode.frequency_hz, exposure_s)
    lost = factor - 1.0
    corrected = replace(mode, amplitude=factor * mode.amplitude)
    if lost < TUNING.worth_a_note and lost * mode.amplitude <= mode.amplitude_sd:
        return corrected
    note = (
        f"Each frame averages {1e3 * exposure_s:g} ms of the motion: the amplitude was corrected by "
        f"{100.0 * lost:.2g} % (uncorrected {mode.amplitude:.5g} {mode.amplitude_unit}). Curves are uncorrected."
    )
    return replace(corrected, notes=(*corrected.notes, note))


@dataclass(frozen=True)
class MeasuredMode:
    """One mode of the beam, combined over the recordings in which it was identified.

    Frequency and damping ratio are means weighted by the inverse variance; the standard deviations include the scatter
    between recordings beyond their own. A frequency that depends on the amplitude is that at small amplitude.
    `frequency` and `damping` hold the values of the recordings and how they agree, `small_damping` those of the damping
    ratio at small amplitude. Draws are of the posterior of the recording with the smallest standard deviation, spread
    evenly over its chains, shifted and scaled to the combined value and standard deviation.

    The error of the frame rate is common to recordings of one camera: `rate_sd` is its relative standard deviation, the
    largest of the recordings. `frequency` does not include it, `frequency_sd_hz` and the draws do.

    `shape` is that of the recording with the smallest relative standard deviation, among those with known marker
    positions; `least_mac` is the smallest modal assurance criterion between two recordings with the same marker
    positions, NaN if there are no two.
    """

    number: int
    frequency_hz: float
    frequency_sd_hz: float
    damping_ratio: float
    damping_ratio_sd: float
    shape: MeasuredShape | None
    recordings: tuple[str, ...]
    frequency: Combined
    damping: Combined
    small_damping: Combined
    frequency_draws_hz: tuple[float, ...]
    damping_draws: tuple[float, ...]
    least_mac: float = float("nan")
    rate_sd: float = 0.0


def measured_modes(recordings: Iterable[RecordingResult]) -> tuple[MeasuredMode, ...]:
    """Measured modes in order of number.

    A mode is taken from the recordings in which it was excited; only if there is none, from others in which it has a
    MAC of at least 0.95 with the theoretical shape and no flag of a wrong value.
    """
    by_number: dict[int, list[_Identified]] = {}
    for recording in recordings:
        if isinstance(recording.identification, Identification):
            for mode in recording.identification.modes:
                if mode.number is not None:
                    one = _Identified(recording.name, mode, _shape(recording.identification, mode))
                    by_number.setdefault(mode.number, []).append(one)
    combined = []
    for number, found in sorted(by_number.items()):
        targets = [one for one in found if one.mode.target]
        others = [one for one in found if one.mode.mac >= TUNING.least_mac and not one.mode.wrong_flags]
        usable = targets or others
        if usable:
            combined.append(_combine(number, usable))
    return tuple(combined)


@dataclass(frozen=True)
class _Identified:
    recording: str
    mode: IdentifiedMode
    shape: MeasuredShape | None


def _combine(number: int, found: list[_Identified]) -> MeasuredMode:
    small_hz = [one.mode.small_amplitude_frequency[0] for one in found]
    frequency = combine(small_hz, [_own_sd_hz(one.mode) for one in found])
    rate_sd = 1e-6 * max(one.mode.posterior.rate_sd_ppm for one in found)
    frequency_sd_hz = float(np.hypot(frequency.sd, rate_sd * frequency.value))
    damping = combine([one.mode.damping_ratio for one in found], [one.mode.damping_ratio_sd for one in found])

    def relative_sd(shape: MeasuredShape) -> float:
        return float(np.linalg.norm(shape.sd) / np.linalg.norm(shape.amplitude))

    shapes = [one.shape for one in found if one.shape is not None]
    most_precise = min(found, key=lambda one: one.mode.damping_ratio_sd).mode.posterior
    return MeasuredMode(
        number=number,
        frequency_hz=frequency.value,
        frequency_sd_hz=frequency_sd_hz,
        damping_ratio=damping.value,
        damping_ratio_sd=damping.sd,
        shape=min(shapes, key=relative_sd, default=None),
        recordings=tuple(one.recording for one in found),
        frequency=frequency,
        damping=damping,
        small_damping=combine(*zip(*(one.mode.small_amplitude_damping for one in found), strict=True)),
        frequency_draws_hz=_drawn(frequency.value, frequency_sd_hz, most_precise.frequency_hz),
        damping_draws=tuple(
            max(zeta, 0.0) for zeta in _drawn(damping.value, damping.sd, most_precise.damping_ratio)
        ),
        least_mac=_least_mac(shapes),
        rate_sd=rate_sd,
    )


def _own_sd_hz(mode: IdentifiedMode) -> float:
    """Standard deviation of the frequency at small amplitude without the error of the frame rate."""
    frequency_hz, sd_hz = mode.small_amplitude_frequency
    dependence, draws = mode.amplitude_dependence, mode.posterior
    if dependence is None or not dependence.significant:
        return float(np.hypot(np.std(draws.frequency_in_record_hz), draws.extrapolation_frequency_hz))
    rate_sd_hz = 1e-6 * draws.rate_sd_ppm * frequency_hz
    return float(np.sqrt(max(sd_hz**2 - rate_sd_hz**2, 0.0)))


def _drawn(value: float, sd: float, posterior: NDArray[np.float64]) -> tuple[float, ...]:
    draws = posterior.ravel()
    chosen = draws[draw_indices(draws.size, bands.TUNING.draws)]
    spread = float(np.std(draws))
    scores = (chosen - np.median(draws)) / spread if spread > 0.0 else np.zeros(chosen.size)
    return tuple(float(value + sd * score) for score in scores)


def _least_mac(shapes: list[MeasuredShape]) -> float:
    same = [
        mac(a.amplitude, b.amplitude)
        for a, b in combinations(shapes, 2)
        if a.positions_m.shape == b.positions_m.shape and np.allclose(a.positions_m, b.positions_m, atol=5e-4)
    ]
    return min(same, default=float("nan"))


def _shape(found: Identification, mode: IdentifiedMode) -> MeasuredShape | None:
    """In-phase part of the complex shape at the markers with known positions."""
    positions = found.series.positions_mm
    known = found.channels_used & np.isfinite(positions) & np.isfinite(mode.shape)
    if mode.number is None or np.count_nonzero(known) < TUNING.least_markers:
        return None
    shape = mode.shape[known]
    # The phase that minimises the out-of-phase part: half of that of the sum of squares.
    phase = 0.5 * np.angle(np.sum(shape**2))
    amplitude = np.asarray(np.real(shape * np.exp(-1j * phase)), dtype=np.float64)
    return MeasuredShape(mode.number, 1e-3 * positions[known], amplitude, mode.shape_sd[known])


def aliases(recordings: Iterable[RecordingResult]) -> tuple[LineAliases, ...]:
    """Lines of a run that may be aliases by themselves, or by what recordings at other rates show.

    All recordings are taken to be of one structure. Those without a recorded rate, whose frequencies are unknown, and
    further copies of one file are left out.
    """
    different = {recording.sha256 or recording.name: recording for recording in recordings}
    found = resolve_aliases(
        line
        for recording in different.values()
        if recording.identified is not None
        and not (isinstance(recording.tracks, MarkerTracks) and recording.tracks.time_axis.is_playback_guess)
        for line in lines_of(recording.name, recording.identified)
    )
    return tuple(one for one in found.lines if one.applies)


@dataclass(frozen=True)
class Budget:
    """Standard uncertainties of one mode, frequencies in Hz; their squares add up to that of the total.

    Attributes
    ----------
    recording : str
    mode : int or None
        Number of the mode.
    total_hz, total_damping : float
        Standard deviations of the posterior.
    noise_hz, noise_damping : float
        Noise of the samples at its level near the frequency of the mode, by Laplace's approximation. Errors of the
        template and of the light that vary from frame to frame are part of it.
    clock_hz : float
        Frame rate. A damping ratio does not depend on it.
    errors : mapping of str to (float, float)
        Of frequency and damping ratio by cause, as `modal_id.Posterior.errors`.
    rest_hz, rest_damping : float
        What the draws contain beyond these: shape of the posterior and error of the sampler. 0 where the parts explain
        the total.
    """

    recording: str
    mode: int | None
    frequency_hz: float
    total_hz: float
    noise_hz: float
    clock_hz: float
    rest_hz: float
    damping_ratio: float
    total_damping: float
    noise_damping: float
    rest_damping: float
    errors: Mapping[str, tuple[float, float]]


def budget(recording: str, mode: IdentifiedMode) -> Budget:
    """Sources of the standard deviations of one mode."""
    draws = mode.posterior
    noise_hz, noise_damping = (draws.noise_factor * sd for sd in draws.laplace_sd)
    clock_hz = 1e-6 * draws.rate_sd_ppm * mode.frequency_hz
    return Budget(
        recording,
        mode.number,
        mode.frequency_hz,
        mode.frequency_sd_hz,
        noise_hz,
        clock_hz,
        _rest(mode.frequency_sd_hz, (noise_hz, clock_hz, draws.systematic[0])),
        mode.damping_ratio,
        mode.damping_ratio_sd,
        noise_damping,
        _rest(mode.damping_ratio_sd, (noise_damping, draws.systematic[1])),
        draws.errors,
    )


def budgets(recordings: tuple[RecordingResult, ...]) -> list[Budget]:
    """Of every mode, in the order of the recordings."""
    return [
        budget(recording.name, mode)
        for recording in recordings
        if recording.identified is not None
        for mode in recording.identified.modes
    ]


def _rest(total: float, parts: tuple[float, ...]) -> float:
    return math.sqrt(max(total**2 - math.fsum(part**2 for part in parts), 0.0))

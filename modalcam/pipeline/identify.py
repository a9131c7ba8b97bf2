"""Stage of the identification: modes of each recording, their amplitudes corrected for the exposure time."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from modal_id import FailedIdentification, FailedMode, Identification, IdentifiedMode, IdentifySettings
from modalcam.config import identify_settings
from modalcam.pipeline.results import RecordingResult
from modalcam.pipeline.stage import Context, Stage
from sim.beam import BeamModes
from tracker import DisplacementSeries, FloatArray, MarkerTracks
from tracker.geometry import LARGEST_PRODUCT, exposure_attenuation, median_over_time
from tracker.markers import AUTO, noun_of

# A correction below this share of the amplitude gets no note, unless it exceeds the standard deviation.
WORTH_A_NOTE = 1e-3
_Failed = TypeVar("_Failed", FailedMode, FailedIdentification)


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
) -> Identification | FailedIdentification:
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
    from modal_id.modes import LEAST_CYCLES  # noqa: PLC0415

    hz = failed.frequency_hz if isinstance(failed, FailedMode) else math.nan
    needed = (
        f" at least {LEAST_CYCLES / hz:.3g} s ({LEAST_CYCLES:g} cycles at {hz:.4g} Hz)" if hz > 0.0 else ""
    )
    record = f"the record needs{needed} of free decay" if needed else "the record needs a free decay"
    return replace(
        failed, reason=f"{cut_off}; {record}: copy or export the file again. In what is left, {failed.reason}"
    )


IDENTIFYING = Stage(
    "identifying",
    "modes",
    ("modal_id", "tracker", "modalcam.pipeline.identify"),
    identify_series,
    FailedIdentification,
)


def identify_recordings(
    context: Context, recordings: Sequence[RecordingResult], modes: BeamModes | None
) -> list[RecordingResult]:
    """Identify the modes of each recording that has a displacement series; `modes` are those of the beam's theory."""

    def inputs(recording: RecordingResult) -> Mapping[str, Any] | None:
        if recording.series is None:
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
        if isinstance(tracks, MarkerTracks) and config.kind == AUTO and tracks.kind != "aruco":
            detected = f"{len(tracks.markers)} {noun_of(tracks.kind)}s"
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
    if product > LARGEST_PRODUCT:
        note = (
            f"The exposure of {1e3 * exposure_s:g} ms lasts {product:.2g} periods of this mode: most of its motion is "
            "averaged out, so its amplitude is not that of the beam. Use a shorter exposure."
        )
        return replace(mode, notes=(*mode.notes, note))
    factor = 1.0 / exposure_attenuation(mode.frequency_hz, exposure_s)
    lost = factor - 1.0
    corrected = replace(mode, amplitude=factor * mode.amplitude)
    if lost < WORTH_A_NOTE and lost * mode.amplitude <= mode.amplitude_sd:
        return corrected
    note = (
        f"Each frame averages {1e3 * exposure_s:g} ms of the motion: the amplitude was corrected by "
        f"{100.0 * lost:.2g} % (uncorrected {mode.amplitude:.5g} {mode.amplitude_unit}). Curves are uncorrected."
    )
    return replace(corrected, notes=(*corrected.notes, note))

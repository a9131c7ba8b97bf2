"""What this app adds to a run: frames kept of each recording, the simulated beam in them, and both in the report.

A plugin in the sense of `modalcam.plugins`; each process of a run loads this module, so that it imports little.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from modalcam.pipeline import AddedStage, InputFile, Stage, register_stage
from modalcam.report.sections import Section, register_section
from tracker import Failure

if TYPE_CHECKING:
    from modal_id import Identification
    from modalcam.apps.film.footage import KeptFrames, SimulatedFootage
    from modalcam.config import RecordingConfig
    from modalcam.pipeline import Cache, Context, RecordingResult, UpdatedBeam
    from sim.beam import BeamProperties
    from sim.damping import MeasuredDamping
    from tracker import MarkerTracks


def keep_recorded(
    path: Path, tracks: MarkerTracks, found: Identification, size_mm: float | None
) -> KeptFrames | Failure:
    """As `modalcam.apps.film.footage.read_kept_frames`."""
    from modalcam.apps.film.footage import read_kept_frames  # noqa: PLC0415 - workers only

    return read_kept_frames(path, tracks, found, size_mm)


def film_simulated(
    frames: KeptFrames,
    tracks: MarkerTracks,
    identification: Identification,
    properties: BeamProperties,
    damping: MeasuredDamping,
    recording: RecordingConfig,
    seed: tuple[int, ...],
) -> SimulatedFootage | Failure:
    """The kept frames as the camera would have seen the updated beam under generic damping."""
    import numpy as np  # noqa: PLC0415 - workers only, as all here

    from modalcam.apps.film.simulated import film_simulation  # noqa: PLC0415
    from modalcam.pipeline import generic_damping  # noqa: PLC0415

    return film_simulation(
        frames,
        tracks,
        identification,
        recording,
        properties,
        generic_damping(properties, damping),
        highest_mode=max(damping.numbers),
        rng=np.random.default_rng(seed),
    )


def _frames_to_keep(
    context: Context, recording: RecordingResult, _: UpdatedBeam | None
) -> Mapping[str, Any] | None:
    from modalcam.config import beam_properties  # noqa: PLC0415
    from tracker import MarkerTracks  # noqa: PLC0415

    # the frames are those of a decay, shown beside the simulated beam only
    if isinstance(beam_properties(context.config.beam), str):
        return None
    tracks, found = recording.tracks, recording.identified
    if recording.path is None or found is None or not found.modes or not isinstance(tracks, MarkerTracks):
        return None
    if not found.has_decay:
        return None
    source = InputFile(recording.path, recording.sha256)
    size_mm = context.config.for_recording(recording.file).size_mm
    return {"path": source, "tracks": tracks, "found": found, "size_mm": size_mm}


def _frames_to_film(
    context: Context, recording: RecordingResult, beam: UpdatedBeam | None
) -> Mapping[str, Any] | None:
    from modalcam.apps.film.footage import KeptFrames  # noqa: PLC0415
    from modalcam.config import random_words  # noqa: PLC0415
    from sim.comparison import obstacle  # noqa: PLC0415

    found, frames = recording.identified, recording.added.get("frames")
    if beam is None or found is None or not isinstance(frames, KeptFrames):
        return None
    if obstacle(beam.properties, found, max(beam.damping.numbers)):
        return None
    return {
        "frames": frames,
        "tracks": recording.tracks,
        "identification": found,
        "properties": beam.properties,
        "damping": beam.damping,
        "recording": context.config.for_recording(recording.file),
        "seed": (context.seed, *random_words(recording.sha256)),
    }


def _failed(_: str, reason: str) -> Failure:
    return Failure(reason)


def _film(recording: RecordingResult, cache: Cache | None) -> dict[str, Any] | None:
    from modalcam.apps.film.section import film_view  # noqa: PLC0415

    return film_view(recording, cache)


def _exaggerated(recording: RecordingResult, cache: Cache | None) -> dict[str, Any] | None:
    from modalcam.apps.film.section import exaggerated_view  # noqa: PLC0415

    return exaggerated_view(recording, cache)


def _notes(recording: RecordingResult) -> Iterator[str]:
    for result in (recording.added.get("frames"), recording.added.get("simulated")):
        if result is not None and not result:
            yield f"There is no film of the simulated beam: {result.reason}"


_CODE = ("tracker", "modalcam.apps.film")
KEEPING = Stage("keeping frames", "frames", _CODE, keep_recorded, _failed)
FILMING = Stage(
    "filming the simulation", "simulated", ("sim", *_CODE, "modalcam.pipeline.beam"), film_simulated, _failed
)
register_stage(AddedStage(KEEPING, "updating", _frames_to_keep))
register_stage(AddedStage(FILMING, "simulating", _frames_to_film))
register_section(Section("exaggerated", "modalcam.apps.film", _exaggerated))
register_section(
    Section(
        "footage",
        "modalcam.apps.film",
        _film,
        _notes,
        (
            "Footage",
            (
                "Frames of the recording, and simulated footage of the same instants: the updated beam with "
                "generic damping, simulated from the start of the fit and rendered with the recording’s scale, "
                "exposure, grey levels and noise. The simulated markers have the rest positions of the recorded "
                "ones; their motion is simulated. Amplitudes are to scale."
            ),
        ),
    )
)

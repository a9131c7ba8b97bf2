"""The stages of a run over all its recordings, in order; each takes what the one before gave."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

from modal_id.results import FailedIdentification, Identification
from modalcam.config.resolve import beam_properties, updating_settings
from modalcam.config.schema import ExperimentConfig
from modalcam.errors import ConfigError
from modalcam.execution.pool import TaskFailure, WorkerPool
from modalcam.execution.progress import Progress
from modalcam.pipeline import film as twin_stage
from modalcam.pipeline import stages
from modalcam.pipeline.beam import (
    TheoryTask,
    known_modes,
    measured_damping,
    theory,
)
from modalcam.pipeline.film import FootageTask, TwinTask
from modalcam.pipeline.measured import measured_modes
from modalcam.pipeline.results import BeamResult, RecordingResult
from modalcam.storage.output_folder import Workspace
from modalcam.video.results import KeptFrames, NoKeptFrames, NoSimulatedFootage
from sim.beam.modes import BeamModes
from sim.beam.properties import BeamProperties
from sim.comparison import BAND_DRAWS, DecayComparison
from sim.damping import MeasuredDamping, skipped_damping_models
from sim.updating import Updating
from tracker.results import FailedTracking, MarkerTracks

# A name that no recording has: theirs never begin with a dot
_BEAM = ".beam"

Task = TypeVar("Task")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Context:
    """What every stage of a run needs."""

    config: ExperimentConfig
    workspace: Workspace
    pool: WorkerPool
    progress: Progress
    seed: int
    force: bool


@dataclass(frozen=True)
class Theory:
    """The beam as configured and its modes, or the sentences that say why there are none."""

    properties: BeamProperties | None
    modes: BeamModes | None
    not_done: tuple[str, ...]


def beam_theory(config: ExperimentConfig, pool: WorkerPool) -> Theory:
    """Theory of the configured beam.

    Raises
    ------
    ConfigError
        If the beam's values cannot be those of a beam.
    """
    try:
        properties = beam_properties(config.beam)
    except ValueError as error:
        msg = f"[beam]: {error}"
        raise ConfigError(msg) from error
    if isinstance(properties, str):
        return Theory(None, None, (properties,))
    highest = max((r.mode for r in config.recordings if r.mode is not None), default=1)
    modes = pool.map(theory, [TheoryTask(properties, highest)])[0]
    if isinstance(modes, BeamModes):
        return Theory(properties, modes, ())
    return Theory(properties, None, (modes.reason if isinstance(modes, TaskFailure) else modes,))


def track_all(
    context: Context, recordings: Sequence[RecordingResult], paths: Sequence[Path]
) -> list[RecordingResult]:
    """Track each recording that has not failed yet."""
    todo = [i for i, recording in enumerate(recordings) if recording.tracks is None]
    tasks = [
        stages.TrackTask(
            recordings[i].name,
            recordings[i].file,
            paths[i],
            context.config.for_recording(recordings[i].file),
            context.workspace.state(recordings[i].name, "tracks"),
            context.force,
        )
        for i in todo
    ]
    names = [recordings[i].name for i in todo]
    results = dict(zip(todo, _map(context, "tracking", stages.track, tasks, names), strict=True))
    return [_tracked(recording, results.get(i)) for i, recording in enumerate(recordings)]


def _tracked(recording: RecordingResult, result: stages.Tracked | TaskFailure | None) -> RecordingResult:
    if result is None:
        return recording
    if isinstance(result, TaskFailure):
        return replace(recording, tracks=FailedTracking(recording.file, result.reason))
    return replace(recording, sha256=result.sha256, tracks=result.tracks)


def with_displacement(recording: RecordingResult) -> RecordingResult:
    """Add the displacement series of a tracked recording, or why there is none."""
    if recording.series is not None or not isinstance(recording.tracks, MarkerTracks):
        return recording
    series = stages.displacement(recording.tracks)
    if isinstance(series, FailedIdentification):
        return replace(recording, identification=series)
    return replace(recording, series=series)


def identify_all(
    context: Context, recordings: Sequence[RecordingResult], modes: BeamModes | None
) -> list[RecordingResult]:
    """Identify the modes of each recording that has a displacement series."""
    todo = {i: r.series for i, r in enumerate(recordings) if r.series is not None}
    tasks = [
        stages.IdentifyTask(
            series,
            recordings[i].sha256,
            context.config.for_recording(recordings[i].file),
            modes,
            context.seed,
            context.workspace.state(recordings[i].name, "modes"),
            context.force,
        )
        for i, series in todo.items()
    ]
    names = [recordings[i].name for i in todo]
    results = dict(zip(todo, _map(context, "identifying", stages.identify, tasks, names), strict=True))
    return [
        replace(recording, identification=_failed_or(results[i], recording.name))
        if i in results
        else recording
        for i, recording in enumerate(recordings)
    ]


def keep_footage(
    context: Context, recordings: Sequence[RecordingResult], paths: Sequence[Path]
) -> list[RecordingResult]:
    """Keep a few frames of each identified recording, to be shown beside those of the simulated beam."""
    todo = {
        i: (r.tracks, r.identification)
        for i, r in enumerate(recordings)
        if isinstance(r.tracks, MarkerTracks)
        and isinstance(r.identification, Identification)
        and r.identification.modes
    }
    tasks = [
        FootageTask(
            paths[i],
            recordings[i].sha256,
            tracks,
            found,
            context.config.for_recording(recordings[i].file),
            context.workspace.state(recordings[i].name, "footage"),
            context.force,
        )
        for i, (tracks, found) in todo.items()
    ]
    names = [recordings[i].name for i in todo]
    results = dict(
        zip(todo, _map(context, "keeping frames", twin_stage.keep_footage, tasks, names), strict=True)
    )
    kept = []
    for i, recording in enumerate(recordings):
        result = results.get(i)
        footage = NoKeptFrames(recording.name, result.reason) if isinstance(result, TaskFailure) else result
        kept.append(replace(recording, kept_frames=footage))
    return kept


def film_all(
    context: Context, recordings: Sequence[RecordingResult], beam: BeamResult | None
) -> list[RecordingResult]:
    """Film the simulated decay of each recording that has one, as its own frames were."""
    if beam is None or beam.updated is None:
        return list(recordings)
    damping = measured_damping(known_modes(measured_modes(recordings), beam.standard_modes))
    properties = beam.updated.properties
    tasks = {
        i: TwinTask(
            r.kept_frames,
            r.sha256,
            r.tracks,
            r.identification,
            properties,
            damping,
            context.config.for_recording(r.file),
            context.seed,
            context.workspace.state(r.name, "twin"),
            context.force,
        )
        for i, r in enumerate(recordings)
        if isinstance(r.kept_frames, KeptFrames)
        and isinstance(r.tracks, MarkerTracks)
        and isinstance(r.identification, Identification)
        and isinstance(r.comparison, DecayComparison)
    }
    names = [recordings[i].name for i in tasks]
    results = dict(
        zip(tasks, _map(context, "filming", twin_stage.film, list(tasks.values()), names), strict=True)
    )
    filmed = []
    for i, recording in enumerate(recordings):
        result = results.get(i)
        filmed.append(
            replace(
                recording,
                simulated_footage=NoSimulatedFootage(recording.name, result.reason)
                if isinstance(result, TaskFailure)
                else result,
            )
        )
    return filmed


def update_beam(
    context: Context, recordings: Sequence[RecordingResult], known: Theory
) -> tuple[BeamResult | None, tuple[str, ...]]:
    """Match the beam to all measured modes; sentences say what could not be done."""
    if known.properties is None or known.modes is None:
        return None, ()
    task = stages.UpdateTask(
        known.properties,
        known.modes,
        measured_modes(recordings),
        updating_settings(context.config.updating),
        context.seed,
        context.workspace.state(_BEAM, "updating"),
        context.force,
    )
    result = _map(context, "updating", stages.update_beam, [task], ["beam"])[0]
    if isinstance(result, TaskFailure):
        return None, (f"The beam was not updated: {result.reason}.",)
    return result, (result.note,) if result.note else ()


def compare_all(
    context: Context, recordings: Sequence[RecordingResult], beam: BeamResult | None
) -> tuple[list[RecordingResult], tuple[str, ...]]:
    """Simulate the decay of each identified recording with the updated beam and each damping model."""
    if beam is None or beam.updated is None:
        return list(recordings), ()
    measured = measured_damping(known_modes(measured_modes(recordings), beam.standard_modes))
    todo = {
        i: r.identification
        for i, r in enumerate(recordings)
        if isinstance(r.identification, Identification) and r.identification.modes
    }
    tasks = [
        _compare_task(context, recordings[i], found, beam.updated, measured) for i, found in todo.items()
    ]
    names = [recordings[i].name for i in todo]
    results = dict(zip(todo, _map(context, "simulating", stages.compare, tasks, names), strict=True))
    compared: list[RecordingResult] = []
    notes = list(skipped_damping_models(context.config.damping.models, len(measured.numbers)))
    for i, recording in enumerate(recordings):
        result = results.get(i)
        if isinstance(result, TaskFailure):
            notes.append(f"{recording.name} was not compared with a simulation: {result.reason}.")
            compared.append(recording)
        elif result is not None:
            compared.append(replace(recording, comparison=result))
        else:
            compared.append(recording)
    return compared, tuple(notes)


def _compare_task(
    context: Context,
    recording: RecordingResult,
    found: Identification,
    updated: Updating,
    damping: MeasuredDamping,
) -> stages.CompareTask:
    return stages.CompareTask(
        found,
        updated.properties,
        updated.bayesian.draws(min(BAND_DRAWS, len(updated.bayesian.log_factor_draws))),
        context.config.damping.models,
        damping,
        context.config.air,
        context.config.for_recording(recording.file),
        context.seed,
        context.workspace.state(recording.name, "comparison"),
        context.force,
    )


def _failed_or(
    result: Identification | FailedIdentification | TaskFailure, name: str
) -> Identification | FailedIdentification:
    return FailedIdentification(name, result.reason) if isinstance(result, TaskFailure) else result


def _map(
    context: Context,
    stage: str,
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    names: Sequence[str],
) -> list[Result | TaskFailure]:
    context.progress.begin(stage, len(tasks))
    return context.pool.map(function, tasks, done=lambda index: context.progress.advance(names[index]))

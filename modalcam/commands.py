"""What each command does: runs the stages it needs and writes their files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from fractions import Fraction
from pathlib import Path

from modal_id.results import FailedIdentification, Identification
from modalcam.config.schema import ExperimentConfig, RecordingConfig
from modalcam.config.toml import CONFIG_NAME, dump_config, load_config
from modalcam.errors import ExitCode, InputError
from modalcam.execution.dask import cluster_pool
from modalcam.execution.local import Limits
from modalcam.execution.pool import WorkerPool, worker_pool
from modalcam.execution.progress import Progress
from modalcam.export.base import Output
from modalcam.export.tables import write_tracks
from modalcam.export.writers import outputs, with_missing_formats
from modalcam.inputs.discover import discover
from modalcam.inputs.series import is_tracks, read_table, series_from_table, tracks_from_table
from modalcam.inputs.uff import ENDINGS, read_uff
from modalcam.names import recording_names, shown
from modalcam.pipeline.results import RecordingResult, RunResult
from modalcam.pipeline.whole import (
    Context,
    Theory,
    beam_theory,
    compare_all,
    film_all,
    identify_all,
    keep_footage,
    track_all,
    update_beam,
    with_displacement,
)
from modalcam.report.build import build_report
from modalcam.storage.atomic import write_text
from modalcam.storage.cache import load
from modalcam.storage.output_folder import RunRecord, Source, Workspace
from modalcam.storage.provenance import file_sha256, versions
from modalcam.video.results import KeptFrames, NoKeptFrames
from tracker.results import FailedTracking, MarkerTracks


@dataclass(frozen=True)
class Options:
    """Options common to the commands that compute."""

    out: Path
    config: Path | None = None
    fps: Fraction | None = None
    seed: int = 0
    jobs: int = 1
    force: bool = False
    follow_symlinks: bool = False
    limits: Limits = field(default_factory=Limits)
    scheduler: str | None = None

    def invocation(self, command: str) -> str:
        """The command with what its results depend on, and nothing of this machine: no paths, no processors."""
        rate = "" if self.fps is None else f" --fps {self.fps}"
        return f"modalcam {command} --seed {self.seed}{rate}"


def run(folder: Path, options: Options, progress: Progress) -> RunResult:
    """Take every recording of a folder through all stages and write OUT."""
    config, recordings, paths, notes = _find(folder, options)
    with _context(config, options, progress, inputs=folder) as context:
        recordings = track_all(context, recordings, paths)
        known = beam_theory(config, context.pool)
        recordings = identify_all(context, [with_displacement(r) for r in recordings], known.modes)
        if known.modes is not None:
            recordings = keep_footage(context, recordings, paths)
        record = _record("run", folder.resolve().name, recordings, config, options, notes)
        return _finish(context, recordings, known, record)


def track(target: Path, options: Options, progress: Progress) -> tuple[tuple[RecordingResult, ...], int]:
    """Track one file, or every recording of a folder, and write the tracks; also the number of internal errors."""
    single = target.is_file()
    folder = target.parent if single else target
    config, recordings, paths, notes = _find(folder, options, only=target.name if single else None)
    with _context(config, options, progress, inputs=folder) as context:
        recordings = track_all(context, recordings, paths)
        for recording in recordings:
            if isinstance(recording.tracks, MarkerTracks):
                write_tracks(context.workspace.tracks(recording.name), recording.tracks)
        context.workspace.write_record(
            _record("track", folder.resolve().name, recordings, config, options, notes)
        )
        return tuple(recordings), context.pool.internal_errors


def identify(
    csv: Path, options: Options, progress: Progress, *, unit: str, recording: RecordingConfig
) -> RunResult:
    """Identify the modes of a table of displacements, the tracker's or any other, or a universal file; write OUT.

    `recording` holds what the user says of it (target, onset, positions); it stands over the configuration file.
    """
    table = None if csv.suffix.lower() in ENDINGS else read_table(csv)
    config = load_config(options.config) if options.config is not None else ExperimentConfig()
    own = next((entry for entry in config.recordings if entry.file == recording.file), None)
    if own is not None:
        recording = RecordingConfig.model_validate(own.given() | recording.given())
    config = config.model_copy(update={"recordings": (recording,)})
    result = RecordingResult(csv.stem, csv.name, file_sha256(csv), recording.mode)
    if table is None:
        positions = config.for_recording(csv.name).positions_mm
        result = replace(result, series=read_uff(csv, name=csv.stem, unit=unit, positions_mm=positions))
    elif is_tracks(table):
        known_markers = config.for_recording(csv.name)
        tracks = tracks_from_table(
            table,
            name=csv.stem,
            positions_mm=known_markers.positions_mm,
            reference=known_markers.reference or (),
        )
        result = replace(result, tracks=tracks)
    else:
        positions = config.for_recording(csv.name).positions_mm
        series = series_from_table(table, name=csv.stem, unit=unit, positions_mm=positions)
        result = replace(result, series=series)
    with _context(config, options, progress, inputs=None) as context:
        known = beam_theory(config, context.pool)
        recordings = identify_all(context, [with_displacement(result)], known.modes)
        record = _record("identify", csv.name, recordings, config, options, ())
        return _finish(context, recordings, known, record)


@dataclass(frozen=True)
class OpenRun:
    """A finished run, taken up again: its recordings with what was saved of them, and the theory of its beam."""

    context: Context
    record: RunRecord
    recordings: tuple[RecordingResult, ...]
    known: Theory


@contextmanager
def opened(options: Options, progress: Progress) -> Iterator[OpenRun]:
    """Take up the run in OUT.

    A configuration given in `options` replaces the one of the run: other beam properties, say.
    """
    workspace = Workspace(options.out)
    record = workspace.read_record()
    config = record.config if options.config is None else load_config(options.config)
    record = replace(record, config=config, seed=options.seed)
    with _context(config, options, progress, inputs=None) as context:
        recordings = tuple(_saved(workspace, source) for source in record.sources)
        yield OpenRun(context, record, recordings, beam_theory(config, context.pool))


def simulate(options: Options, progress: Progress) -> RunResult:
    """Update the beam and compare again from the identification saved in OUT.

    A configuration given in `options` replaces the one of the run: other beam properties, say.
    """
    with opened(options, progress) as taken:
        return _finish(taken.context, taken.recordings, taken.known, taken.record)


def report(options: Options, progress: Progress) -> RunResult:
    """Write every file of OUT again from its saved results; nothing is computed anew that was saved."""
    record = Workspace(options.out).read_record()
    options = replace(options, config=None, seed=record.seed, force=False)
    return simulate(options, progress)


def exit_code(recordings: Sequence[RecordingResult], internal_errors: int) -> ExitCode:
    """What the process tells its caller after a run over `recordings`."""
    failed = [recording for recording in recordings if recording.failure]
    if internal_errors:
        return ExitCode.INTERNAL
    if recordings and len(failed) == len(recordings):
        return ExitCode.NO_INPUT
    incomplete = failed or any(recording.target_failure for recording in recordings)
    return ExitCode.PARTIAL if incomplete else ExitCode.OK


def _find(
    folder: Path, options: Options, only: str | None = None
) -> tuple[ExperimentConfig, list[RecordingResult], list[Path], tuple[str, ...]]:
    found = discover(folder, exclude=options.out, follow_symlinks=options.follow_symlinks)
    path = options.config if options.config is not None else folder / CONFIG_NAME
    wanted = options.config is not None or path.exists()
    config = load_config(path) if wanted else ExperimentConfig()
    notes = list(found.notes)
    if not wanted:
        notes.append(f"There is no {CONFIG_NAME} in the folder: only what the recordings tell was used.")
    if options.fps is not None:
        config = config.with_fps(options.fps)
    files = [f for f in found.recordings if only is None or f.file == only]
    if not files:
        msg = f"{shown(only or '')}: not a recording that can be read; see `modalcam probe`"
        raise InputError(msg)
    results = [RecordingResult(f.name, f.file, "", config.for_recording(f.file).mode) for f in files]
    paths = [f.path for f in files]
    present = {f.file for f in found.recordings}
    absent = [r for r in config.recordings if r.file not in present and only is None]
    taken = [r.name for r in results]
    for entry, name in zip(
        absent, recording_names([*taken, *(r.file for r in absent)])[len(taken) :], strict=True
    ):
        failure = FailedTracking(entry.file, "it is listed in the configuration but is not in the folder")
        results.append(RecordingResult(name, entry.file, "", entry.mode, tracks=failure))
        paths.append(folder / entry.file)
    return config, results, paths, tuple(notes)


@contextmanager
def _context(
    config: ExperimentConfig, options: Options, progress: Progress, *, inputs: Path | None
) -> Iterator[Context]:
    # Workers on other machines have other working folders.
    workspace = Workspace(options.out if options.scheduler is None else options.out.absolute())
    workspace.prepare(inputs=inputs, force=options.force)
    with workspace.locked(), _pool(options, workspace, inputs) as pool:
        yield Context(config, workspace, pool, progress, options.seed, options.force)


@contextmanager
def _pool(options: Options, workspace: Workspace, inputs: Path | None) -> Iterator[WorkerPool]:
    if options.scheduler is None:
        with worker_pool(options.jobs, options.limits) as pool:
            yield pool
        return
    folders = () if inputs is None else (inputs.absolute(),)
    with cluster_pool(options.scheduler, options.limits, out=workspace.out, folders=folders) as pool:
        yield pool


def _record(
    command: str,
    folder: str,
    recordings: Sequence[RecordingResult],
    config: ExperimentConfig,
    options: Options,
    notes: tuple[str, ...],
) -> RunRecord:
    sources = tuple(Source(r.name, r.file, r.sha256, r.mode) for r in recordings)
    invocation = options.invocation(f"{command} {shown(folder)}")
    return RunRecord(folder, sources, config, options.seed, invocation, notes)


def _saved(workspace: Workspace, source: Source) -> RecordingResult:
    tracks = load(workspace.state(source.name, "tracks"))
    found = load(workspace.state(source.name, "modes"))
    footage = load(workspace.state(source.name, "footage"))
    result = RecordingResult(
        source.name,
        source.file,
        source.sha256,
        source.mode,
        tracks=tracks,
        kept_frames=footage if isinstance(footage, KeptFrames | NoKeptFrames) else None,
    )
    if isinstance(found, Identification):
        return replace(result, series=found.series, identification=found)
    if isinstance(found, FailedIdentification):
        return replace(with_displacement(result), identification=found)
    if not isinstance(tracks, FailedTracking):
        msg = f"{workspace.out}: no saved identification of {source.name}; run again with `modalcam run`"
        raise InputError(msg)
    return result


def _finish(
    context: Context, recordings: Sequence[RecordingResult], known: Theory, record: RunRecord
) -> RunResult:
    beam, beam_notes = update_beam(context, recordings, known)
    compared, compare_notes = compare_all(context, recordings, beam)
    result = RunResult(
        folder=record.folder,
        recordings=tuple(film_all(context, compared, beam)),
        beam=beam,
        not_done=(*record.notes, *known.not_done, *beam_notes, *compare_notes),
        resolved_config=dump_config(context.config),
        versions=versions(),
        command_line=record.command_line,
        seed=record.seed,
        internal_errors=context.pool.internal_errors,
    )
    context.workspace.write_record(record)
    result = with_missing_formats(result)
    # Last: a report stands for a run that has finished.
    report = Output(context.workspace.report, result, lambda path: write_text(path, build_report(result)))
    for output in (*outputs(context.workspace, result, context.config), report):
        output.write(output.path)
    return result
